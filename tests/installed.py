"""Fresh virtual environments with built wheels, beside the dependencies that are installed here."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import venv
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import Distribution
from pathlib import Path

ROOT = Path(__file__).parents[1]

_LOCAL = ("--quiet", "--no-deps", "--no-index")  # nothing is downloaded


@dataclass(frozen=True)
class Environment:
    """A virtual environment that does not see this source tree, and a folder to work in."""

    folder: Path
    working_folder: Path

    def run(self, *words: str, folder: Path | None = None) -> str:
        """Run a program of the environment, which has to succeed; return what it prints."""
        program, *arguments = words
        done = subprocess.run(
            [str(self.folder / "bin" / program), *arguments],
            cwd=folder or self.working_folder,
            env=self.variables(),
            capture_output=True,
            text=True,
            timeout=500,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def variables(self) -> dict[str, str]:
        """Return the environment variables of its programs."""
        return {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}

    def check_tests_pass(self, *arguments: str, folder: Path | None = None) -> None:
        """Check that no test fails, and that none is skipped but because this computer paused."""
        command = ("python", "-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider", *arguments)
        shown = self.run(*command, folder=folder)
        assert re.search(r"^\d+ passed(, \d+ skipped)? in", shown, re.MULTILINE), shown
        skipped = [line for line in shown.splitlines() if line.startswith("SKIPPED")]
        assert all("this computer is too busy" in line for line in skipped), shown

    @property
    def site(self) -> Path:
        """Where packages are installed."""
        return next(self.folder.glob("lib/python*/site-packages"))

    def install(self, *projects: Path) -> None:
        """Install wheels, or projects of which wheels are built first."""
        python = str(self.folder / "bin" / "python")
        _pip("--python", python, "install", *_LOCAL, "--no-build-isolation", *map(str, projects))

    def copy_kernels(self) -> None:
        """Copy the compiled kernels of this source tree, which are valid by their content."""
        for folder, _, files in os.walk(ROOT / "cairn", followlinks=True):
            for file in files:
                if file.endswith((".nbi", ".nbc")):
                    source = Path(folder, file)
                    target = self.site / source.relative_to(ROOT)
                    target.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy2(source, target)


def build_source(folder: Path) -> Path:
    """Build the source distribution of Cairn into a folder."""
    build = [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(folder)]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, timeout=500, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    (source,) = folder.glob("*.tar.gz")
    return source


def build_wheels(folder: Path, *projects: Path) -> list[Path]:
    """Build the wheels of projects into a folder."""
    _pip("wheel", *_LOCAL, "--no-build-isolation", "-w", str(folder), *map(str, projects))
    return sorted(folder.glob("*.whl"))


def fresh_environment(folder: Path, packages: Iterable[Distribution] | None = None) -> Environment:
    """Create an environment that finds what is installed here, but not Cairn and its plugins.

    It finds only the given `packages`; all, if none are given.
    """
    entries = None if packages is None else {name for one in packages for name in _entries(one)}
    venv.create(folder, symlinks=True)
    working_folder = folder / "work"
    working_folder.mkdir()
    environment = Environment(folder, working_folder)
    for here in (Path(entry) for entry in sys.path if entry.endswith("site-packages")):
        for installed in here.iterdir():
            link = environment.site / installed.name
            ours = "cairn" in installed.name.lower()
            wanted = entries is None or installed.name in entries
            if wanted and not ours and installed.suffix != ".pth" and not link.exists():
                link.symlink_to(installed)
    return environment


def _entries(package: Distribution) -> set[str]:
    """Return what a package has in the folder of packages."""
    return {file.parts[0] for file in package.files or ()} - {".."}


def _pip(*words: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "pip", *words],
        capture_output=True,
        text=True,
        timeout=500,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
