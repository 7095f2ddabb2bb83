"""The log file of a process that runs robots: limited in size, and it survives a full disk."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from logging.handlers import RotatingFileHandler
from pathlib import Path
from typing import Any

from cairn.errors import CairnError
from cairn.runtime.child_spec import Storage
from cairn.runtime.log_output import LOG_FORMAT
from cairn.system.clock import SECOND
from cairn.system.files import TAKES_NO_DATA
from cairn.terminal.output import note


@contextmanager
def log_file(file: Path, now: Callable[[], int], storage: Storage | None = None) -> Iterator[None]:
    """Write what the components of this process log to a file; `now` returns the time [ns].

    The file has the limits of `storage`, if that is given. Raises `CairnError` if it cannot be
    created, unless the disk is full: that is reported once, and the run continues.
    """
    handler = _LogFile(file, storage)
    try:
        handler.open()
    except OSError as error:
        if error.errno not in TAKES_NO_DATA:
            raise CairnError(
                f"the log file {file} cannot be created: {error.strerror}; name another folder "
                "with --report"
            ) from error
        handler.report(error)
    handler.setFormatter(_Formatter(now))
    logger = logging.getLogger("cairn")
    logger.setLevel(logging.INFO)
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        handler.close()


class _LogFile(RotatingFileHandler):
    def __init__(self, file: Path, storage: Storage | None) -> None:
        size, count = (storage.max_log_size, storage.old_logs) if storage else (0, 0)
        super().__init__(file, maxBytes=size, backupCount=count, encoding="utf-8", delay=True)
        self._reported = False

    def open(self) -> None:
        """Begin an empty file; raises `OSError`."""
        Path(self.baseFilename).open("w").close()
        self.stream = self._open()

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802
        """Report a full disk; anything else is a defect, which `logging` prints."""
        error = sys.exception()
        if isinstance(error, OSError):
            self.report(error)
        else:
            super().handleError(record)

    def report(self, error: OSError) -> None:
        """Report once that the file cannot be written."""
        if not self._reported:
            self._reported = True
            reason = f"cairn: {self.baseFilename} cannot be written: {error.strerror}"
            note(f"{reason}; the log is incomplete")

    def close(self) -> None:
        """Close the file; what did not fit on the disk is lost, which has been reported."""
        try:
            super().close()
        except OSError as error:
            self.report(error)


class _Formatter(logging.Formatter):
    def __init__(self, now: Callable[[], int]) -> None:
        super().__init__(LOG_FORMAT)
        self._now = now

    def formatTime(self, *_: Any) -> str:  # noqa: N802
        return f"{self._now() / SECOND:.6f}"
