"""Writes what an emulated device sends: for comparing with what a driver made of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from cairn.errors import CairnError


@contextmanager
def recording(path: Path | None) -> Iterator[Callable[[str], None]]:
    """A function that adds a line to a file, where it stands when that returns; None: to none.

    Raises `CairnError` if the file cannot be written, at first or later.
    """
    if path is None:
        yield lambda _: None
        return
    try:
        file = path.open("w", encoding="utf-8")
    except OSError as error:
        raise _unwritable(path, error) from error

    def write(line: str) -> None:
        try:
            file.write(line + "\n")
            file.flush()
        except OSError as error:
            raise _unwritable(path, error) from error

    with file:
        yield write


def _unwritable(path: Path, error: OSError) -> CairnError:
    return CairnError(f"--record {path} cannot be written: {error.strerror}")
