"""The files of a map that a command writes."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from cairn import CairnError


def map_files(out: Path, endings: Iterable[str], *, force: bool) -> dict[str, Path]:
    """Return the files of the map `out`, by their endings.

    `out` is the name of the map, or that of one of its files. Raises `CairnError` before anything
    is done if it is a folder, if its folder cannot be written, or if one of the files exists and
    `force` is not given.
    """
    if not out.name or out.is_dir():
        raise CairnError(
            f"{out} is a folder; give the name of the map's files in it, such as {out / 'map'}"
        )
    endings = tuple(endings)
    if out.suffix in endings:
        out = out.with_suffix("")
    _check_folder(out)
    files = {ending: out.with_name(out.name + ending) for ending in endings}
    existing = [file for file in files.values() if file.exists()]
    if existing and not force:
        raise CairnError(
            f"{existing[0]} exists already. Give another name, or --force to replace it."
        )
    return files


def _check_folder(out: Path) -> None:
    """Raise `CairnError` if the folder of a file cannot be made, or cannot be written."""
    try:
        there = next(folder for folder in out.absolute().parents if folder.exists())
    except OSError as error:  # of a folder that this user must not look into
        raise CairnError(f"{out} cannot be written: {error}; give another path") from error
    if not there.is_dir():
        raise CairnError(f"{out} cannot be written: {there} is not a folder; give another path")
    if not os.access(there, os.W_OK | os.X_OK):
        raise CairnError(
            f"{out} cannot be written: this user must not write to the folder {there}; give "
            "another path, or permission"
        )
