"""The log file of the components that run in `cairn up`'s own process."""

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from cairn.clock import SECOND
from cairn.errors import CairnError
from cairn.placement.process import LOG_FORMAT


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
