"""What commands that run robots share: report folder, log file, seeds, worker processes."""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path

from cairn.clock import SECOND
from cairn.errors import CairnError
from cairn.placement.component_process import LOG_FORMAT
from cairn.supervision.orphan_cleanup import set_parent_death_signal


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


@contextmanager
def log_file(file: Path, now: Callable[[], int]) -> Iterator[None]:
    """Keep what the components of this process log in a file, with the time [ns] given by `now`.

    Raises `CairnError` if it cannot be made. When the disk is full, that is told once, and the run
    goes on.
    """
    try:
        handler = _LogFile(file, mode="w", encoding="utf-8")
    except OSError as error:
        raise CairnError(
            f"the log file {file} cannot be made: {error.strerror}; name another folder with "
            "--report"
        ) from error
    handler.setFormatter(_Formatter(now))
    logger = logging.getLogger("cairn")
    logger.setLevel(logging.INFO)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        handler.close()


class _LogFile(logging.FileHandler):
    _told = False

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802
        """Tell of a full disk once; anything else is a defect and shown as `logging` does."""
        error = sys.exception()
        if not isinstance(error, OSError):
            super().handleError(record)
        elif not self._told:
            self._told = True
            reason = f"cairn: {self.baseFilename} cannot be written: {error.strerror}"
            print(f"{reason}; the log is incomplete", file=sys.stderr)  # noqa: T201

    def close(self) -> None:
        """Close the file; what the disk had no room for is lost, and has been told."""
        try:
            super().close()
        except OSError as error:
            if not self._told:
                reason = f"cairn: {self.baseFilename} cannot be written: {error.strerror}"
                print(reason, file=sys.stderr)  # noqa: T201


class _Formatter(logging.Formatter):
    def __init__(self, now: Callable[[], int]) -> None:
        super().__init__(LOG_FORMAT)
        self._now = now

    def formatTime(self, record: logging.LogRecord, datefmt: str | None = None) -> str:  # noqa: ARG002, N802
        return f"{self._now() / SECOND:.6f}"


def seeds_of(text: str) -> range:
    """The seeds that `--seeds A..B`, or one number, names; `CairnError` if it names none."""
    first, dots, last = text.partition("..")
    try:
        begin = int(first)
        end = int(last) if dots else begin
    except ValueError:
        raise CairnError(f"--seeds {text}: write it as A..B, such as 0..19") from None
    if not 0 <= begin <= end:
        raise CairnError(f"--seeds {text}: A must not be negative nor larger than B")
    return range(begin, end + 1)


def worker_pool(count: int) -> ProcessPoolExecutor:
    """So many processes of their own memory, which end with this one, even if it is killed.

    To be used from the main thread: the kernel ends them with the thread that began them.
    """
    return ProcessPoolExecutor(
        count,
        mp_context=get_context("spawn"),
        initializer=_end_with,
        initargs=(os.getpid(),),
    )


def _end_with(parent: int) -> None:
    set_parent_death_signal(signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)
