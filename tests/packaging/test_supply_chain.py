"""The lock files fit pyproject.toml and hold hashes only; THIRD_PARTY.md names every package."""

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.packaging.third_party import (
    CAIRN,
    LIBRARIES,
    NOTICES,
    ROOT,
    libraries_of,
    license_of,
    locked_versions,
    run_time_packages,
)

PYTHONS = ("3.11", "3.12", "3.13", "3.14")
MACHINES = ("x86_64", "aarch64")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
LOCK_FILES = {
    "dev": ("dev", "interop"),
    "docs": ("docs",),
    "lock": ("lock",),
    "pip": ("pip",),
}
"""Each lock file with the dependency groups that it covers."""


@pytest.mark.parametrize("lock", LOCK_FILES)
def test_lock_file_satisfies_the_ranges_of_pyproject_on_each_python(lock: str) -> None:
    wanted = [
        Requirement(one)
        for group in LOCK_FILES[lock]
        for one in PROJECT["dependency-groups"][group]
    ]
    if lock == "dev":
        wanted += map(Requirement, PROJECT["project"]["dependencies"])
        for extra in PROJECT["project"]["optional-dependencies"].values():
            wanted += (one for one in map(Requirement, extra) if one.name != CAIRN)
    for environment in _environments():
        locked = _locked(_file(lock), environment)
        for requirement in wanted:
            if requirement.marker and not requirement.marker.evaluate(environment):
                continue
            name = canonicalize_name(requirement.name)
            version = locked.get(name, "none")
            assert requirement.specifier.contains(version, prereleases=True), (
                f"{lock}.txt: {name} {version} is outside of {requirement}; run `make lock`"
            )


def test_every_dependency_group_is_locked() -> None:
    covered = {group for groups in LOCK_FILES.values() for group in groups}

    assert covered == set(PROJECT["dependency-groups"])


@pytest.mark.parametrize("lock", LOCK_FILES)
def test_lock_file_consists_of_versions_and_hashes_without_hosts(lock: str) -> None:
    text = _file(lock).read_text(encoding="utf-8")

    entry = (
        r"[a-z0-9-]+(\[[a-z,]+\])?==[^\s;]+( ; [^\\\n]+)?( \\\n    --hash=sha256:[0-9a-f]{64})+\n"
    )
    assert re.fullmatch(f"({entry})+", text)


def test_packages_that_both_lock_files_hold_have_the_same_version() -> None:
    for environment in _environments():
        dev, docs = (_locked(_file(lock), environment) for lock in ("dev", "docs"))
        assert {name: dev[name] for name in docs if name in dev} == {
            name: docs[name] for name in docs if name in dev
        }


def test_all_packages_of_a_robot_are_locked_and_in_the_notices() -> None:
    versions, text = locked_versions(), NOTICES.read_text(encoding="utf-8")

    for name, package in run_time_packages().items():
        row = f"| {name} | {', '.join(versions[name])} | {license_of(package)} |"
        assert row in text, f"{NOTICES.name} lacks {row}; run `make lock`"
        for library in libraries_of(package).values():
            assert f"{library.project} ({library.license})" in text


def test_base_has_few_direct_dependencies() -> None:
    assert len(PROJECT["project"]["dependencies"]) <= 15


def test_lgpl_libraries_of_opencv_and_shapely_are_in_the_notices() -> None:
    lgpl = NOTICES.read_text(encoding="utf-8").partition("## Libraries under the LGPL")[2]

    assert "**shapely**: GEOS" in lgpl
    assert "**opencv-python-headless**: FFmpeg" in lgpl
    assert all(library.license for library in LIBRARIES.values())


def test_makefile_installs_nothing_without_hashes() -> None:
    text = (ROOT / "Makefile").read_text(encoding="utf-8").replace("\\\n", " ")
    installs = [line for line in text.splitlines() if "pip install" in line]

    assert installs == ["PIP = $(BIN)/python -m pip install --quiet --no-compile"]
    uses = [line.strip() for line in text.splitlines() if "$(PIP)" in line]
    assert uses == [
        "LOCKED = $(PIP) --require-hashes --requirement",
        "LOCAL = $(PIP) --no-deps --no-build-isolation --no-index --editable",
    ]


def _file(lock: str) -> Path:
    return ROOT / "requirements" / f"{lock}.txt"


def _environments() -> Iterator[dict[str, str]]:
    for python in PYTHONS:
        for machine in MACHINES:
            yield {
                "python_version": python,
                "python_full_version": f"{python}.9",
                "platform_machine": machine,
                "platform_python_implementation": "CPython",
                "implementation_name": "cpython",
                "platform_system": "Linux",
                "sys_platform": "linux",
                "os_name": "posix",
            }


def _locked(file: Path, environment: dict[str, str]) -> dict[str, str]:
    """Return the version of each package that is installed in an environment."""
    found: dict[str, str] = {}
    for line in file.read_text(encoding="utf-8").splitlines():
        if line.startswith(" "):
            continue
        requirement = Requirement(line.removesuffix(" \\"))
        if requirement.marker is None or requirement.marker.evaluate(environment):
            assert requirement.name not in found, f"{file.name}: two versions of {requirement.name}"
            found[requirement.name] = str(requirement.specifier).removeprefix("==")
    return found
