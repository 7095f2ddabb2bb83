"""The extras of Cairn's package: which libraries each installs, and which are missing.

The table of libraries is the one in `pyproject.toml`, read from the installed metadata.
"""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Mapping
from functools import cache
from importlib.metadata import requires
from typing import Final

PACKAGE: Final = "cairn-robotics"

_REQUIREMENT = re.compile(r"""(?P<name>[\w.-]+).*\bextra == ['"](?P<extra>[\w-]+)['"]""")
_ALL: Final = "all"
_IMPORTED_AS: Final = {"opencv-python-headless": "cv2", "pillow": "PIL"}
"""Import names that differ from the names of the packages."""


def extras() -> Mapping[str, tuple[str, ...]]:
    """Return the libraries of each extra, by the names under which they are imported."""
    return {extra: libraries for extra, libraries in _table().items() if extra != _ALL}


def robot_extras() -> list[str]:
    """Return the extras that `all` comprises: what a single robot uses."""
    libraries = set(_table()[_ALL])
    return [extra for extra, names in extras().items() if libraries.issuperset(names)]


def installed_extras() -> list[str]:
    """Return those of `robot_extras` whose libraries are all installed."""
    return [extra for extra in robot_extras() if not missing_libraries(extra)]


def missing_libraries(extra: str) -> list[str]:
    """Return the libraries of an extra that are not installed."""
    return [name for name in extras()[extra] if importlib.util.find_spec(name) is None]


def missing_library(error: BaseException) -> tuple[str, str] | None:
    """Return which library of an extra an import lacked, and the command that installs it.

    None if the error has another reason.
    """
    if not isinstance(error, ModuleNotFoundError) or error.name is None:
        return None
    library = error.name.partition(".")[0]
    extra = next((extra for extra, names in extras().items() if library in names), None)
    if extra is None:
        return None
    return library, install_command(extra)


def install_command(extra: str) -> str:
    """Return the command that installs an extra."""
    return f"pip install '{PACKAGE}[{extra}]'"


@cache
def _table() -> Mapping[str, tuple[str, ...]]:
    found: dict[str, list[str]] = {}
    for requirement in requires(PACKAGE) or ():
        if match := _REQUIREMENT.match(requirement):
            library = _IMPORTED_AS.get(match["name"], match["name"])
            found.setdefault(match["extra"], []).append(library)
    return {extra: tuple(libraries) for extra, libraries in found.items()}
