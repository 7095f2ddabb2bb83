"""A disk that is full, and who may open what is on it."""

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from stat import S_IMODE, S_IRWXO, S_IWGRP


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
