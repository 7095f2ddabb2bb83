"""Open files of users with limits: regular files only, and no more bytes than a reader expects.

A device such as /dev/zero never ends, and opening a FIFO waits for a writer, for ever if there is
none.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO, Final

STATE_BYTES: Final = 16 * 1024 * 1024
"""Largest file that Cairn wrote for itself and reads again: missions, poses, states [bytes]."""

_KINDS: Final = {
    stat.S_IFCHR: "it is a device",
    stat.S_IFBLK: "it is a device",
    stat.S_IFIFO: "it is a FIFO",
    stat.S_IFSOCK: "it is a socket",
}


class RefusedFileError(OSError):
    """A file is not regular, or larger than its reader allows; `remedy` says what to do."""

    def __init__(self, number: int, reason: str, path: Path, remedy: str) -> None:
        super().__init__(number, reason, str(path))
        self.remedy = remedy


def open_regular(path: Path) -> BinaryIO:
    """Open a regular file for reading, without waiting.

    Raises `RefusedFileError` for devices, FIFOs and sockets, other `OSError` as `open` does.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOCTTY)
    try:
        check_regular(path, os.fstat(descriptor))
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


def check_regular(path: Path, status: os.stat_result | None = None) -> None:
    """Raise `OSError` as `open_regular` unless there is a regular file; the file is not opened."""
    mode = stat.S_IFMT((status or path.stat()).st_mode)
    if mode == stat.S_IFDIR:
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if mode != stat.S_IFREG:
        kind = _KINDS.get(mode, "it is not a regular file")
        raise RefusedFileError(errno.EINVAL, kind, path, "give a regular file")


def read_bounded(path: Path, limit: int) -> bytes:
    """Return the content of a regular file of at most `limit` bytes.

    Raises `RefusedFileError` for a larger file and as `open_regular`.
    """
    with open_regular(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        # Files of /proc have size 0, and a file may grow meanwhile.
        data = b"" if size > limit else stream.read(limit + 1)
        if size > limit or len(data) > limit:
            raise too_large(path, max(size, len(data)), limit)
    return data


def read_text_bounded(path: Path, limit: int) -> str:
    """Return the UTF-8 text of a file; raise as `read_bounded`, or `UnicodeDecodeError`."""
    return read_bounded(path, limit).decode("utf-8")


def too_large(path: Path, size: int, limit: int) -> RefusedFileError:
    """Return the error for a file of `size` bytes."""
    return RefusedFileError(
        errno.EFBIG,
        f"it has {megabytes(size)} MB, more than the {megabytes(limit)} MB that are allowed",
        path,
        "give a smaller file",
    )


def megabytes(size: int) -> str:
    """Return a number of bytes in MB (10^6), with the digits that matter."""
    return f"{size / 1e6:,.0f}" if size >= 10_000_000 else f"{size / 1e6:.3g}"
