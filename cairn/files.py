"""Replaces files, at once or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def replace_file(path: Path, data: bytes, *, durable: bool = True) -> None:
    """Replace a file's content, or make the file; raises `OSError`, and then it is as it was.

    Whoever reads it finds the old content or the new, also if this process is killed meanwhile and,
    if `durable`, after a loss of power. That costs a wait for the disk.
    """
    with replacing(path, durable=durable) as part:
        part.write_bytes(data)


@contextmanager
def replacing(path: Path, *, durable: bool = True) -> Iterator[Path]:
    """A name in the same folder; what is written there replaces `path` as in `replace_file`."""
    part = path.with_name(path.name + ".part")
    part.unlink(missing_ok=True)  # of one that was killed
    try:
        yield part
        if durable:
            # Else the new name may reach the disk before the content does.
            with part.open("rb") as written:
                os.fsync(written.fileno())
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
