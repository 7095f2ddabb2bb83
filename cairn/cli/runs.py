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
def log_file(file: Path, now: Callable[[], int]) -> Iterator[None]:
    """Write what the components of this process log to a file; `now` returns the time [ns].

    Raises `CairnError` if the file cannot be created. If the disk becomes full, that is reported
    once, and the run continues.
    """
    try:
        handler = _LogFile(file, mode="w", encoding="utf-8")
    except OSError as error:
        raise CairnError(
            f"the log file {file} cannot be created: {error.strerror}; name another folder with "
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
    _reported = False

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802
        """Report a full disk once; anything else is a defect, which `logging` prints."""
        error = sys.exception()
        if not isinstance(error, OSError):
            super().handleError(record)
        elif not self._reported:
            self._reported = True
            reason = f"cairn: {self.baseFilename} cannot be written: {error.strerror}"
            print(f"{reason}; the log is incomplete", file=sys.stderr)  # noqa: T201

    def close(self) -> None:
        """Close the file; what did not fit on the disk is lost, which has been reported."""
        try:
            super().close()
        except OSError as error:
            if not self._reported:
                reason = f"cairn: {self.baseFilename} cannot be written: {error.strerror}"
                print(reason, file=sys.stderr)  # noqa: T201


class _Formatter(logging.Formatter):
    def __init__(self, now: Callable[[], int]) -> None:
        super().__init__(LOG_FORMAT)
        self._now = now

    def formatTime(self, record: logging.LogRecord, datefmt: str | None = None) -> str:  # noqa: ARG002, N802
        return f"{self._now() / SECOND:.6f}"


def seeds_of(text: str) -> range:
    """Return the seeds of `--seeds A..B`, or of one number; `CairnError` if it is invalid."""
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
    """Return a pool of `count` processes, which end with this one, even if it is killed.

    Call it on the main thread: the kernel kills them when the thread that started them ends.
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
