"""Writes definitions of ROS 2 types as an installation has them: an ament prefix."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from cairn.bus.type_hash import own_definition, type_description
from cairn.errors import CairnError
from cairn.schemas.definitions import KINDS
from cairn.schemas.interfaces import packages

_MARK: Final = "written by `cairn schema export`"
_MANIFEST: Final = """<?xml version="1.0"?>
<package format="3">
  <name>{package}</name>
  <version>0.0.0</version>
  <description>Interface definitions, {mark}</description>
  <maintainer email="none@example.org">none</maintainer>
  <license>{license}</license>
  <member_of_group>rosidl_interface_packages</member_of_group>
</package>
"""
_LICENSES: Final = {
    "geographic_msgs": "BSD-3-Clause",
    "map_msgs": "BSD-3-Clause",
    "tf2_msgs": "BSD-3-Clause",
    "unique_identifier_msgs": "BSD-3-Clause",
}
"""Of Cairn's packages; the others are under Apache-2.0: see schemas/SOURCES.md."""


def export_definitions(types: Mapping[str, type[Any]], folder: Path) -> int:
    """Write definitions and type descriptions into `folder/share`; return how many packages.

    What an export before has left there is removed. Raises `CairnError` if there are packages that
    something else has written, or the folder cannot be written.
    """
    share = folder / "share"
    names = sorted({name.partition("/")[0] for name in types})
    for package in names:
        if (share / package).exists() and not _is_ours(share / package):
            raise CairnError(
                f"{share / package} exists and was not written by `cairn schema export`; give an "
                "empty folder"
            )
    try:
        for package in names:
            own = {name: one for name, one in types.items() if name.startswith(f"{package}/")}
            _write(share, package, own)
    except OSError as error:
        raise CairnError(f"{folder} cannot be written: {error.strerror or error}") from error
    return len(names)


def _is_ours(folder: Path) -> bool:
    manifest = folder / "package.xml"
    return manifest.is_file() and _MARK in manifest.read_text(encoding="utf-8")


def _write(share: Path, package: str, types: Mapping[str, type[Any]]) -> None:
    folder = share / package
    for kind in KINDS:
        shutil.rmtree(folder / kind, ignore_errors=True)
    folder.mkdir(parents=True, exist_ok=True)
    source = packages().get(package)
    is_cairns = any(one.__module__.startswith("cairn.schemas.") for one in types.values())
    license_ = _LICENSES.get(package, "Apache-2.0") if is_cairns else "unknown"
    manifest = _MANIFEST.format(package=package, mark=_MARK, license=license_)
    (folder / "package.xml").write_text(manifest, encoding="utf-8")
    files = []
    for name, found in types.items():
        _, kind, last = name.split("/")
        (folder / kind).mkdir(exist_ok=True)
        file = folder / kind / f"{last}.{kind}"
        original = source / kind / file.name if source is not None else None
        if original is not None and original.is_file():
            shutil.copyfile(original, file)
        else:
            file.write_text(own_definition(found), encoding="utf-8")
        description = json.dumps(type_description(found), indent=2)
        file.with_suffix(".json").write_text(f"{description}\n", encoding="utf-8")
        files.append(f"{kind}/{file.name}\n")
    index = share / "ament_index" / "resource_index"
    for resource, text in (("packages", ""), ("rosidl_interfaces", "".join(files))):
        (index / resource).mkdir(parents=True, exist_ok=True)
        (index / resource / package).write_text(text, encoding="utf-8")
