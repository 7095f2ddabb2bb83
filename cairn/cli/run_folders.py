"""The folders with log and report of each run: one process uses one, and old ones are reduced."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Final

from cairn.errors import CairnError
from cairn.limits.files import megabytes
from cairn.runtime.child_spec import Storage
from cairn.system.runtime_folder import locked

EXPENDABLE: Final = ("logs", "record.jsonl", "world.jsonl")
"""What an old run folder loses: logs, the report's journal, the state of a simulated world.

A person may miss everything else: maps, missions, results, and what other components write.
"""


def check_report_option(folder: Path) -> None:
    """Raise `CairnError` if more than the last two folders of a path that was given do not exist.

    A path with a mistake would otherwise be created.
    """
    for missing in reversed(folder.parents[1:]):
        if not missing.exists():
            raise CairnError(
                f"--report {folder}: there is no folder {missing}; create it, or correct the path"
            )


@contextmanager
def writing_report(folder: Path, option: str = "--out") -> Iterator[None]:
    """Raise `CairnError` instead of `OSError` if the report cannot be written.

    `option` is the option by which the user names the folder.
    """
    try:
        yield
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        raise CairnError(
            f"the report's folder {folder} cannot be written: {where}{error.strerror or error}; "
            f"name another one with {option}, or free some space there"
        ) from error


@contextmanager
def used_folder(folder: Path) -> Iterator[Path]:
    """Create the folder of a run, without the logs of an earlier one; return that of its logs.

    No other run may use it within the context. Raises `CairnError` if one does, or if the folder
    cannot be created.
    """
    try:
        str(folder).encode()
    except UnicodeEncodeError as error:
        raise CairnError(f"the report's folder {str(folder)!r} is not UTF-8; rename it") from error
    logs = folder / "logs"
    with ExitStack() as held:
        with writing_report(folder, "--report"):
            folder.mkdir(parents=True, exist_ok=True)
        try:
            held.enter_context(locked(folder, wait=False))
        except BlockingIOError:
            raise CairnError(
                f"the report's folder {folder} is used by another run; name another one with "
                "--report, or stop that run"
            ) from None
        except OSError:  # a file system without locks
            pass
        with writing_report(folder, "--report"):
            logs.mkdir(exist_ok=True)
            for old in (*logs.glob("*.log"), *logs.glob("*.log.*")):
                old.unlink(missing_ok=True)
        yield logs


def reduce_old(runs: Path, storage: Storage, new: Path) -> list[str]:
    """Remove what is expendable from the oldest run folders; return what the user should know.

    The newest `storage.kept_runs` stay complete, fewer if all folders together are larger than
    `storage.max_runs_size`. Maps are never removed, and no file of the `new` run or another one
    that is under way.
    """
    try:
        folders = sorted(path for path in runs.iterdir() if path.is_dir() and not path.is_symlink())
    except OSError:  # there are none
        return []
    sizes = {folder: _size(folder) for folder in folders}
    total = sum(sizes.values())
    complete = [one for one in folders if any((one / name).exists() for name in EXPENDABLE)]
    complete = [one for one in complete if one != new]
    reduced = []
    while complete and (len(complete) >= storage.kept_runs or total > storage.max_runs_size):
        folder = complete.pop(0)
        with suppress(OSError), locked(folder, wait=False):  # otherwise its run is under way
            for name in EXPENDABLE:
                _remove(folder / name)
            total -= sizes[folder] - _size(folder)
            reduced.append(folder.name)
            with suppress(OSError):  # not empty
                folder.rmdir()
    notes = []
    if reduced:
        one = len(reduced) == 1
        names = reduced[0] if one else f"{reduced[0]} to {reduced[-1]}"
        notes.append(
            f"removed the logs of {len(reduced)} old {'run' if one else 'runs'} in {runs}: "
            f"{names}; maps, missions and results are kept"
        )
    if total > storage.max_runs_size:
        notes.append(
            f"the run folders in {runs} have {megabytes(total)} MB, more than the "
            f"{megabytes(storage.max_runs_size)} MB of storage.max_runs_size; remove those whose "
            "maps you do not need"
        )
    return notes


def _size(folder: Path) -> int:
    """Return the size of all files in a folder [bytes]."""
    size = 0
    for path in folder.rglob("*"):
        with suppress(OSError):  # removed meanwhile
            size += path.lstat().st_size
    return size


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink(missing_ok=True)
