"""The folder that a command writes its report into."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cairn.errors import CairnError


@contextmanager
def writing_report(folder: Path, option: str = "--out") -> Iterator[None]:
    """Tell what keeps a report from being written: `CairnError` instead of `OSError`.

    `option` is that by which the user names the folder.
    """
    try:
        yield
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        raise CairnError(
            f"the report's folder {folder} cannot be written: {where}{error.strerror or error}; "
            f"name another one with {option}, or make room there"
        ) from error
