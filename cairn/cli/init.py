"""`cairn init`: a package for your own robot, with a driver, a component, and their tests."""

from __future__ import annotations

import keyword
import re
import sys
from importlib.machinery import PathFinder
from pathlib import Path
from string import Template
from typing import Annotated

import typer

from cairn.deployment.shipped import FOLDER
from cairn.errors import CairnError
from cairn.terminal.output import line

_FIRST_MAP = "ground_floor"
_SKELETON = Path(__file__).parent / "skeleton"
_RENAMED = {"package": "{package}", "deployment.yaml": "{package}.yaml", "gitignore": ".gitignore"}
# Packages of these names would hide what the skeleton itself has.
_RESERVED = frozenset({"tests", "deploy"})


def init(
    folder: Annotated[
        Path,
        typer.Argument(
            help="Folder to create; its name is that of the Python package.", metavar="NAME"
        ),
    ],
) -> None:
    """Create a package for your own robot: component, driver, emulator, deployment, tests.

    Its tests pass as written. The README in the folder explains the next steps.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise CairnError(f"{folder} exists and is not an empty folder; give another name")
    package = _package_name(folder)
    names = {"package": package, "project": package.replace("_", "-")}
    try:
        count = _write(folder, names)
    except OSError as error:
        raise CairnError(f"{folder} cannot be written: {error.strerror or error}") from error
    line(f"{folder}: {count} files; next:")
    line(f"  cd {folder}")
    line("  python3 -m pip install --editable '.[test]'")
    line("  pytest")


def _package_name(folder: Path) -> str:
    name = folder.name
    if keyword.iskeyword(name):
        raise CairnError(f"{name} is a keyword of Python, not the name of a package; give another")
    if not re.fullmatch("[a-z][a-z0-9_]*", name):
        raise CairnError(
            f"{name!r} is not the name of a Python package; write lowercase letters, digits and "
            "underscores, as in my_robot"
        )
    # In its folder, `import` finds the package in place of an installed one of the same name.
    installed = PathFinder.find_spec(name)
    hides = installed is not None and installed.origin is not None
    if name in _RESERVED or name in sys.stdlib_module_names or hides:
        raise CairnError(f"a package {name} would hide another one; give another name")
    return name


def _write(folder: Path, names: dict[str, str]) -> int:
    """Write the skeleton with these names; return the number of files."""
    templates = sorted(_SKELETON.rglob("*.in"))
    for template in templates:
        parts = template.relative_to(_SKELETON).with_suffix("").parts
        file = folder.joinpath(*(_RENAMED.get(part, part).format(**names) for part in parts))
        file.parent.mkdir(parents=True, exist_ok=True)
        text = Template(template.read_text(encoding="utf-8")).substitute(names)
        file.write_text(text, encoding="utf-8")
    (folder / "deploy" / "robot.yaml").write_text(_robot(names["package"]), encoding="utf-8")
    return len(templates) + 1


def _robot(package: str) -> str:
    """Return the shipped deployment of a robot, with this name and a map that is not made yet."""
    text = (FOLDER / "robot.yaml").read_text(encoding="utf-8")
    text = text.replace("\n  name: robot\n", f"\n  name: {package}\n", 1)
    return text.replace("/maps/room.", f"/maps/{_FIRST_MAP}.")
