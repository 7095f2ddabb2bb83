"""The files of a map that a command writes: their names, and that they are replaced together."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from cairn import CairnError
from cairn.components.map_builder.cli import prepare
from cairn.system.files import explain_os_error


def map_files(out: Path, endings: Iterable[str], *, force: bool) -> dict[str, Path]:
    """Return the files of the map `out`, by their endings.

    Raises `CairnError` before anything is done if `out` is a folder or has one of the endings, if
    its folder cannot be written, or if one of the files exists and `force` is not given.
    """
    if not out.name or out.is_dir():
        raise CairnError(
            f"{out} is a folder; give the name of the map's files in it, such as {out / 'map'}"
        )
    endings = tuple(endings)
    if out.suffix in endings:
        raise CairnError(
            f"{out} has the ending {out.suffix}; give the name without it, "
            f"{out.with_suffix('')}: a map has several files"
        )
    _check_folder(out)
    files = {ending: out.with_name(out.name + ending) for ending in endings}
    existing = [file for file in files.values() if file.exists()]
    if existing and not force:
        raise CairnError(
            f"{existing[0]} exists already. Give another name, or --force to replace it."
        )
    return files


@contextmanager
def replacing_map(files: Mapping[str, Path]) -> Iterator[dict[str, Path]]:
    """Yield paths to write the files of a map to, by their endings; then they replace the map's.

    Files of the map before that were not written are removed. Raises `CairnError`, and leaves the
    map before as it was, if one cannot be written: a grid map belongs to its graph.
    """
    first = next(iter(files.values()))
    folder = first.parent
    part = folder / f".{first.name}.part"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(part, ignore_errors=True)  # left by a process that was killed
        part.mkdir()
        parts = {ending: part / file.name for ending, file in files.items()}
        try:
            yield parts
        except CairnError as error:
            # The user knows the files by the names that they get.
            raise CairnError(str(error).replace(str(part), str(folder))) from error
        for ending, file in files.items():
            prepare(file)
            if parts[ending].exists():
                parts[ending].replace(file)
            else:
                file.unlink(missing_ok=True)
    except OSError as error:
        raise CairnError(
            f"{folder}: the map cannot be written there: {explain_os_error(error)}"
        ) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


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
