"""The driver of docs/testing-drivers.md is tested as its author would: from wheels, elsewhere."""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import venv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.processes


ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "docs" / "driver-example"
PAGE = "docs/testing-drivers.md"


@dataclass(frozen=True)
class Environment:
    """A virtual environment that has Cairn and the driver, and a copy of the driver's own tests."""

    folder: Path

    def run(self, *words: str) -> str:
        """What a command of the environment prints, which has to succeed."""
        program, *arguments = words
        clean = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        done = subprocess.run(
            [str(self.folder / "bin" / program), *arguments],
            cwd=self.folder / "project",
            env=clean,
            capture_output=True,
            text=True,
            timeout=500,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Environment:
    """A fresh environment: wheels of Cairn and of the driver; what they depend on is linked."""
    folder = tmp_path_factory.mktemp("fresh") / "venv"
    venv.create(folder, symlinks=True)
    _link_dependencies(folder)
    project = folder / "project"
    shutil.copytree(EXAMPLE, project, ignore=shutil.ignore_patterns("__pycache__"))
    wheels = folder / "wheels"
    local = ["--quiet", "--no-deps", "--no-index"]
    _pip("wheel", *local, "--no-build-isolation", "-w", str(wheels), str(ROOT), str(project))
    python = str(folder / "bin" / "python")
    _pip("--python", python, "install", *local, *map(str, wheels.iterdir()))
    shutil.rmtree(project / "lantern_driver")  # only what was installed counts
    return Environment(folder)


@pytest.mark.realtime
@pytest.mark.timeout(600)
def test_the_drivers_tests_pass_where_only_wheels_are(installed: Environment) -> None:
    done = installed.run("python", "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests")

    assert re.search(r"^\d+ passed in", done, re.MULTILINE), done


@pytest.mark.realtime  # as the other, so that both share an environment
def test_the_driver_is_found_there_by_its_name(installed: Environment) -> None:
    assert "Measures ranges with a Lantern" in installed.run("cairn", "plugins", "lantern_scanner")
    assert "no problem: scanner" in installed.run("cairn", "check", "deploy/lantern.yaml")


def test_what_the_page_quotes_stands_in_the_files(page_blocks: Callable[[str], Any]) -> None:
    quoted = [block for block in page_blocks(PAGE) if block.title]

    assert len(quoted) >= 3
    for block in quoted:
        file = (EXAMPLE / block.title).read_text(encoding="utf-8")
        for part in re.split(r"^    \.\.\.$", block.text, flags=re.MULTILINE):
            assert part.strip("\n") in file, f"not in {block.title}:\n{part}"


def test_the_page_names_every_test_of_the_contracts() -> None:
    page = (ROOT / PAGE).read_text(encoding="utf-8")
    named = set(re.findall(r"`(test_\w+)`", page))

    kit = ROOT / "cairn" / "testing"
    sources = [file.read_text(encoding="utf-8") for file in kit.glob("*_contract.py")]
    tests = {name for source in sources for name in re.findall(r"def (test_\w+)", source)}
    assert named == tests


def _link_dependencies(folder: Path) -> None:
    """Have the environment find all that is installed here, but for Cairn and plugins of it."""
    here = Path(sysconfig.get_path("purelib"))
    there = next(folder.glob("lib/python*/site-packages"))
    for installed in here.iterdir():
        ours = "cairn" in installed.name.lower()
        if not ours and installed.suffix != ".pth" and not (there / installed.name).exists():
            (there / installed.name).symlink_to(installed)


def _pip(*words: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "pip", *words],
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
