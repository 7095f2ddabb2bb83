"""Replace files atomically.

Own code because the library for it, `atomicwrites`, was archived in 2022, and this takes 20 lines.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def replace_file(path: Path, data: bytes, *, durable: bool = True) -> None:
    """Replace the content of a file atomically, or create the file.

    A reader finds either the old or the new content, also if this process is killed meanwhile and,
    if `durable`, after a loss of power. Durability costs a wait for the disk.

    Raises `OSError`, and leaves the file unchanged, if the new content cannot be written.
    """
    with replacing(path, durable=durable) as part:
        part.write_bytes(data)


@contextmanager
def replacing(path: Path, *, durable: bool = True) -> Iterator[Path]:
    """Yield a temporary path in the folder of `path`; on success its file replaces `path`.

    Guarantees and errors are those of `replace_file`.
    """
    part = path.with_name(path.name + ".part")
    part.unlink(missing_ok=True)  # left by a process that was killed
    try:
        yield part
        if durable:
            # Otherwise the new name may reach the disk before the content does.
            with part.open("rb") as written:
                os.fsync(written.fileno())
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
