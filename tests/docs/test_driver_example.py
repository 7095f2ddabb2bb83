"""The driver of docs/how-to/test-a-driver.md is tested as its author would test it."""

import re
import shutil
from collections.abc import Callable
from importlib import import_module
from typing import Any

import pytest

from tests.installed import ROOT, Environment, build_wheels, fresh_environment

pytestmark = pytest.mark.processes


EXAMPLE = ROOT / "docs" / "driver-example"
PAGE = "docs/how-to/test-a-driver.md"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Environment:
    """A fresh environment with wheels of Cairn and of the driver, and the driver's own tests."""
    environment = fresh_environment(tmp_path_factory.mktemp("fresh") / "venv")
    project = environment.working_folder
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(EXAMPLE, project, ignore=ignored, dirs_exist_ok=True)
    environment.install(*build_wheels(environment.folder / "wheels", ROOT, project))
    environment.copy_kernels()
    shutil.rmtree(project / "lantern_driver")  # only what was installed counts
    return environment


@pytest.mark.accuracy
@pytest.mark.realtime
@pytest.mark.timeout(600)
def test_driver_tests_pass_with_installed_wheels_only(installed: Environment) -> None:
    installed.check_tests_pass("tests")


@pytest.mark.accuracy
@pytest.mark.realtime  # as the other, so that both share an environment
def test_installed_driver_is_found_by_its_name(installed: Environment) -> None:
    assert "Measures ranges with a Lantern" in installed.run("cairn", "plugins", "lantern_scanner")
    assert "no problem: robot_frames, scanner" in installed.run(
        "cairn", "check", "deploy/lantern.yaml"
    )


def test_quotes_on_the_page_equal_the_files(page_blocks: Callable[[str], Any]) -> None:
    quoted = [block for block in page_blocks(PAGE) if block.title]

    assert len(quoted) >= 3
    for block in quoted:
        file = (EXAMPLE / block.title).read_text(encoding="utf-8")
        for part in re.split(r"^    \.\.\.$", block.text, flags=re.MULTILINE):
            assert part.strip("\n") in file, f"not in {block.title}:\n{part}"


def test_names_on_the_page_exist_in_the_contracts() -> None:
    page = (ROOT / PAGE).read_text(encoding="utf-8")
    named = set(re.findall(r"`(test_\w+)", page))
    (settings,) = re.findall(r"\| setting \| meaning \|\n\|---\|---\|\n((?:\|.*\n)+)", page)
    named |= {name for row in settings.splitlines() for name in words(row.split("|")[1])}

    contracts = [
        getattr(import_module(f"cairn.testing.{module}"), name)
        for module, name in re.findall(r"^\| `(\w+_contract)\.(\w+)`", page, re.MULTILINE)
    ]
    members = {name for contract in contracts for name in (*dir(contract), *annotated(contract))}
    assert len(contracts) == 4
    assert named <= members


def words(cell: str) -> list[str]:
    """Return the names in backticks."""
    return re.findall(r"`(\w+)`", cell)


def annotated(cls: type[Any]) -> set[str]:
    """Return the names that a class and its bases declare without a value."""
    return {name for base in cls.__mro__ for name in vars(base).get("__annotations__", {})}
