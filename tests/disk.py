"""A disk that is full, and who may open what is on it."""

import ctypes
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from stat import S_IMODE, S_IRWXO, S_IWGRP

import pytest


@contextmanager
def room_for(size: int) -> Iterator[None]:
    """Limit every file to `size` [bytes], as a full disk would."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def open_to_others(folder: Path) -> list[str]:
    """Return the files and folders in a folder that other users may open, with their modes."""
    modes = {path: S_IMODE(path.lstat().st_mode) for path in (folder, *folder.rglob("*"))}
    return [f"{path} {mode:04o}" for path, mode in modes.items() if mode & (S_IRWXO | S_IWGRP)]


@contextmanager
def small_disk(folder: Path, size: int) -> Iterator[Path]:
    """Mount a file system of `size` [bytes] on a new folder; skip the test if that is forbidden."""
    folder.mkdir()
    libc = ctypes.CDLL(None, use_errno=True)
    options = f"size={size}".encode()
    if libc.mount(b"tmpfs", os.fsencode(folder), b"tmpfs", 0, options):
        pytest.skip(f"cannot mount a tmpfs: {os.strerror(ctypes.get_errno())}")
    try:
        yield folder
    finally:
        libc.umount2(os.fsencode(folder), 2)  # MNT_DETACH: files may still be open


def fill(folder: Path) -> Path:
    """Fill the disk of a folder with one file; removing it makes room again."""
    ballast = folder / "ballast"
    with ballast.open("ab", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(4096))
    return ballast
