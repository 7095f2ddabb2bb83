"""Keep files from other users, replace them atomically, and explain why they cannot be used.

Replacing is own code because the library for it, `atomicwrites`, was archived in 2022, and this
takes 20 lines.
"""

from __future__ import annotations

import errno
import os
import resource
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from cairn.errors import CairnError

MANY_FILES: Final = 1024
"""A process of Cairn may open so many files, if the system allows it."""

_LEAST_FILES: Final = 256
"""Zenoh ends the process if it cannot open its own; `cairn up` of a robot opens about 60."""

_UMASK: Final = 0o027
"""Others may not read what Cairn writes: where a robot is, where it goes, and maps of buildings."""


def allow_many_files() -> None:
    """Let this process, and those it starts, open `MANY_FILES`.

    Raises `CairnError` if the system allows fewer than Cairn needs.
    """
    soft, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    unlimited = resource.RLIM_INFINITY
    if soft != unlimited and soft < MANY_FILES:
        soft = MANY_FILES if most == unlimited else min(MANY_FILES, most)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, most))
    if soft != unlimited and soft < _LEAST_FILES:
        raise CairnError(
            f"a program may open {soft} files here, and Cairn needs {_LEAST_FILES}: raise the "
            f"limit (`ulimit -n {MANY_FILES}`; of a systemd unit, LimitNOFILE)"
        )


@contextmanager
def private_files() -> Iterator[None]:
    """Create files and folders that other users cannot open, in this process and those it starts.

    Their modes become 0640 and 0750 at most; a stricter umask of the user stays.
    """
    before = os.umask(_UMASK)
    os.umask(before | _UMASK)
    try:
        yield
    finally:
        os.umask(before)


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

    Guarantees and errors are those of `replace_file`. Only one file is replaced: a database must be
    closed, without a log beside it.
    """
    part = path.with_name(path.name + ".part")
    part.unlink(missing_ok=True)  # left by a process that was killed
    remove_side_files(part)
    try:
        yield part
        if durable:
            # Otherwise the new name may reach the disk before the content does.
            with part.open("rb") as written:
                os.fsync(written.fileno())
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        remove_side_files(part)
        raise


@contextmanager
def replacing_together(files: Mapping[str, Path]) -> Iterator[dict[str, Path]]:
    """Yield temporary paths of the files NAME.* of one folder, which then replace them together.

    Keys are chosen by the caller. Files that were not written there are removed. If this process is
    killed meanwhile, the files are those before; or those after, as soon as
    `complete_replacement` was called for one of them.

    Raises `CairnError`, and leaves all files as they were, if one cannot be written.
    """
    first = next(iter(files.values()))
    folder, written = first.parent, _replacement(first)
    part = written.with_suffix(".part")
    with explained(f"{first} cannot be written"):
        folder.mkdir(parents=True, exist_ok=True)
        complete_replacement(first)
        shutil.rmtree(part, ignore_errors=True)  # left by a process that was killed
        part.mkdir()
        parts = {key: part / file.name for key, file in files.items()}
        try:
            yield parts
            gone = [file.name for key, file in files.items() if not parts[key].exists()]
            (part / _REMOVED).write_text("\n".join(gone))
            part.rename(written)  # from here on, the new files are those that count
        except CairnError as error:
            # The user knows the files by the names that they get.
            raise CairnError(str(error).replace(str(part), str(folder))) from error
        finally:
            shutil.rmtree(part, ignore_errors=True)
        complete_replacement(first)


def complete_replacement(file: Path) -> None:
    """Complete what a killed process has started: the replacement of a file and others of its name.

    To be called before a file is read that `replacing_together` replaces. Raises `CairnError` if
    the disk refuses it.
    """
    written = _replacement(file)
    if not written.is_dir():
        return
    with explained(f"{file}: its replacement was interrupted, and cannot be completed"):
        removed = written / _REMOVED
        parts: list[Path] = []
        with suppress(FileNotFoundError):  # here and below: another process completes it, too
            parts = sorted(written.iterdir())
        names = removed.read_text(errors="replace").splitlines() if removed in parts else []
        for name in names:
            gone = Path(name)
            if gone.name == name and gone.stem == file.stem:  # of a file of this name, nothing else
                remove_side_files(file.with_name(name))
                file.with_name(name).unlink(missing_ok=True)
        for part in parts:
            if part != removed:
                remove_side_files(file.with_name(part.name))
                with suppress(FileNotFoundError):
                    part.replace(file.with_name(part.name))
        removed.unlink(missing_ok=True)
        with suppress(FileNotFoundError):
            written.rmdir()


_REMOVED: Final = ".removed"


def _replacement(file: Path) -> Path:
    """Return the folder with the files that replace those of a file's name."""
    return file.with_name(f".{file.stem}.new")


def side_files(path: Path) -> list[Path]:
    """Return the paths of the files that SQLite keeps beside an open one."""
    return [path.with_name(path.name + suffix) for suffix in ("-wal", "-shm", "-journal")]


def rename_database(old: Path, new: Path) -> None:
    """Rename a file and those that SQLite keeps beside it; what has the new names is replaced.

    What a process that was killed has written last is in the files beside.
    """
    remove_side_files(new)
    old.replace(new)
    for one, renamed in zip(side_files(old), side_files(new), strict=True):
        if one.exists():
            one.replace(renamed)


def remove_side_files(path: Path) -> None:
    """Remove the files that SQLite keeps beside one, and leaves there on a full disk."""
    for file in side_files(path):
        file.unlink(missing_ok=True)


TAKES_NO_DATA: Final = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS})
"""Errors of a disk that takes no data now: full, over quota, at a size limit, read-only."""

_FREE_SPACE: Final = "free some space on {disk}"
_PERMISSION: Final = "change its permissions, or give another path"
_REMEDIES: Final = {
    errno.ENOSPC: _FREE_SPACE,
    errno.EDQUOT: _FREE_SPACE,
    errno.EFBIG: "the limit on the size of a file is reached: raise it (`ulimit -f`)",
    errno.EACCES: _PERMISSION,
    errno.EPERM: _PERMISSION,
    errno.EROFS: "{disk} is read-only: give another path",
    errno.EISDIR: "it is a folder: give a file",
    errno.ENOTDIR: "a part of the path is a file, not a folder: correct it",
    errno.EEXIST: "something else has this name: give another path",
    errno.ENOENT: "correct the path",
    errno.EIO: "{disk} fails: read the system's log",
}


@contextmanager
def explained(what: str, failure: type[CairnError] = CairnError) -> Iterator[None]:
    """Turn an `OSError` into an error that says `what` has failed, the reason, and a remedy."""
    try:
        yield
    except OSError as error:
        raise failure(f"{what}: {explain_os_error(error)}") from error


def explain_os_error(error: OSError, path: Path | None = None) -> str:
    """Return the system's message of a failed operation on a file, and a remedy.

    It names the disk by where it is mounted, if the error or `path` says which file it was.
    """
    remedy = getattr(error, "remedy", None) or _REMEDIES.get(
        error.errno or 0, "correct the path, or the file there"
    )
    if "{disk}" in remedy:
        file = error.filename if isinstance(error.filename, str) else path
        remedy = remedy.replace("{disk}", "its disk" if file is None else _disk_of(file))
    return f"{error.strerror or error}; {remedy}"


def _disk_of(file: str | Path) -> str:
    with suppress(OSError):  # the current folder may be gone
        folder = os.path.realpath(file)
        while not os.path.ismount(folder):
            folder = os.path.dirname(folder)
        return f"the disk at {folder}"
    return "its disk"
