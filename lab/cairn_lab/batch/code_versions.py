"""What the result of a run depends on besides its task: the code that computes it."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from hashlib import blake2b
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Final

PACKAGE, DISTRIBUTION = "cairn", "cairn-robotics"
_LAB: Final = __name__.partition(".")[0]

ABSENT: Final = "not installed"

_COMPUTING: Final = (
    "numpy",
    "scipy",
    "numba",
    "llvmlite",
    "opencv-python-headless",
    "gtsam",
    "shapely",
    "pillow",
    "simplejpeg",
    "pydantic",
)
"""The distributions whose version may change the last digit of a result."""

_NAMED: Final = "package "
_SOURCES = re.compile(r"\.(py|so|msg|srv|action)$")


def code_versions(packages: Iterable[str]) -> dict[str, str]:
    """Return the versions of Python, Cairn, the lab, these packages, and libraries that compute.

    The version of a package has a digest of its source files, so that edited code is other code.
    """
    found = {"Python": f"{platform.python_version()} {platform.machine()}"}
    found[DISTRIBUTION] = f"{_version(DISTRIBUTION)} ({_source_digest(PACKAGE)})"
    for package in sorted({_LAB, *packages} - {PACKAGE}):
        found[f"{_NAMED}{package}"] = _source_digest(package)
    return found | {name: _version(name) for name in _COMPUTING}


def packages_in(versions: Mapping[str, str]) -> list[str]:
    """Return the packages, other than Cairn, that these versions are about."""
    return [name.removeprefix(_NAMED) for name in versions if name.startswith(_NAMED)]


def differences(here: Mapping[str, str], there: Mapping[str, str]) -> list[str]:
    """Return in words in which versions two computers differ; empty if they run the same code."""
    return [
        f"{name} {there.get(name, ABSENT)} instead of {here.get(name, ABSENT)}"
        for name in sorted(here.keys() | there.keys())
        if here.get(name, ABSENT) != there.get(name, ABSENT)
    ]


@cache  # a process computes with the code that it has read, also if the files change afterwards
def _source_digest(package: str) -> str:
    """Return a digest of the source files of a package or module; `ABSENT` if there is none."""
    try:
        spec = find_spec(package)
    except (ImportError, ValueError):
        spec = None
    if spec is None:
        return ABSENT
    digest = blake2b(digest_size=6)
    for name, file in sorted(_sources(spec.submodule_search_locations, spec.origin)):
        content = file.read_bytes()
        digest.update(f"{name} {len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()


def _sources(folders: Iterable[str] | None, origin: str | None) -> Iterator[tuple[str, Path]]:
    """Yield the source files, each with its path in the package."""
    if folders is None:
        if origin is not None and Path(origin).is_file():
            yield Path(origin).name, Path(origin)
        return
    for folder in folders:
        seen: set[str] = set()
        # With links: Cairn's folders beside the package are linked into it.
        for place, inner, names in os.walk(folder, followlinks=True):
            real = os.path.realpath(place)
            if real in seen:  # a link to a folder around it
                inner.clear()
                continue
            seen.add(real)
            for name in names:
                if _SOURCES.search(name):
                    path = Path(place, name)
                    yield str(path.relative_to(folder)), path


@cache
def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ABSENT
