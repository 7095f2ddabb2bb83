"""What bounds the logs of a component: their rate, the length of records, the size of its file."""

from __future__ import annotations

import logging
import os
import re
import stat
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

LOG_FORMAT: Final = "%(asctime)s %(levelname)-7s %(name)s: %(message)s"

BURST: Final = 100
"""Records that one statement may log at once."""
RATE_HZ: Final = 10.0
"""Records that one statement may log continually [1/s]."""
LONGEST_RECORD: Final = 10_000
"""Longest message of a record [characters]."""
_REPORT_S: Final = 10.0
"""Suppressed records are reported after this [s]."""
_LONGEST_EXAMPLE: Final = 200


_CONTROLS: Final = re.compile(
    "[\\x00-\\x08\\x0b-\\x1f\\x7f-\\x9f\\u200e\\u200f\\u202a-\\u202e\\u2066-\\u2069]"
)


def printable(text: str) -> str:
    """Return a text, perhaps of a peer, without what controls a terminal, but with line breaks."""
    return _CONTROLS.sub("\N{REPLACEMENT CHARACTER}", text)


class TokenBucket:
    """Allows `burst` events at once, and `rate_hz` [1/s] continually."""

    def __init__(self, burst: float, rate_hz: float, now_s: float) -> None:
        self._burst = self._tokens = burst
        self._rate_hz = rate_hz
        self._updated_s = now_s

    def take(self, now_s: float) -> bool:
        """Return whether one more event is allowed at this time [s]."""
        gained = (now_s - self._updated_s) * self._rate_hz
        self._tokens = min(self._burst, self._tokens + gained)
        self._updated_s = now_s
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True


@dataclass
class _Source:
    """A statement that logs: what it may still log, and how many records were suppressed."""

    allowed: TokenBucket
    suppressed: int = 0
    since_s: float = 0.0
    last: logging.LogRecord | None = None


class LogLimit(logging.Filter):
    """Limits what each statement of a component logs, and reports how much it suppressed.

    A peer can cause endless records of a statement, but does not suppress those of others, such as
    the error with which a component ends. `RateLimitedLog` counts as the statement that calls it.
    """

    def __init__(
        self, log: logging.Logger, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        """Limit a component's logger, from now on and until `close`."""
        super().__init__()
        self._log = log
        self._monotonic = monotonic
        self._sources: dict[tuple[str, int], _Source] = {}
        self._lock = threading.Lock()
        log.addFilter(self)

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether a record may be logged; cut one that is too long; make it printable."""
        key, now = (record.pathname, record.lineno), self._monotonic()
        with self._lock:
            source = self._sources.get(key)
            if source is None:
                source = self._sources[key] = _Source(TokenBucket(BURST, RATE_HZ, now))
            if not source.allowed.take(now):
                source.since_s = source.since_s if source.suppressed else now
                source.suppressed += 1
                source.last = record
                return False
        _cut(record, LONGEST_RECORD)
        return True

    def report(self, *, now: bool = False) -> None:
        """Log how many records were suppressed some seconds ago or, with `now`, up to now."""
        at_s = self._monotonic()
        with self._lock:
            due = [
                (source.suppressed, at_s - source.since_s, source.last)
                for source in self._sources.values()
                if source.suppressed and (now or at_s - source.since_s >= _REPORT_S)
            ]
            for source in self._sources.values():
                if now or at_s - source.since_s >= _REPORT_S:
                    source.suppressed, source.last = 0, None
        for count, seconds, last in due:
            assert last is not None
            _cut(last, _LONGEST_EXAMPLE)
            self._log.warning(
                "suppressed %d log records of %s:%d in %.0f s, the last one: %s",
                count, Path(last.pathname).name, last.lineno, seconds, last.getMessage(),
            )  # fmt: skip

    def close(self) -> None:
        """Report what was suppressed, and end the limit."""
        self.report(now=True)
        self._log.removeFilter(self)


class OutputHandler(logging.StreamHandler):  # type: ignore[type-arg]  # not generic at run time
    """Logs to standard error. While it cannot be written, records are counted, and then reported.

    Python keeps some of them in the buffer of the stream, so they may come nevertheless.
    """

    def __init__(self) -> None:
        super().__init__(sys.stderr)
        self.setFormatter(logging.Formatter(LOG_FORMAT))
        self._failed = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record."""
        failed = self._failed
        super().emit(record)
        if failed and self._failed == failed:
            self._failed = 0
            text = f"up to {failed} log records before this one are missing: not written"
            with suppress(OSError):
                self.stream.write(f"{text}{self.terminator}")
                self.flush()

    def handleError(self, record: logging.LogRecord) -> None:  # noqa: N802
        """Count a record that cannot be written; anything else is a defect, which is printed."""
        if isinstance(sys.exception(), OSError):
            self._failed += 1
        else:
            super().handleError(record)


class OutputFile:
    """The log file to which standard output and error of this process are appended.

    When it is long, the process itself renames it and its older ones and continues in a new file:
    whatever is written to the two streams, also by a library or as the process crashes, is in one
    of them. A file that could not be opened at the start, on a full disk, is opened later.
    """

    def __init__(self, file: Path, max_size: int, old_files: int) -> None:
        """Limit the size [bytes] of a file, of which so many older ones are kept."""
        self._file = file
        self._max_size = max_size
        self._old_files = old_files

    def check(self) -> None:
        """Continue in a new file if one is due; call it several times a second."""
        status = os.fstat(2)
        is_file = stat.S_ISREG(status.st_mode)
        if is_file and status.st_size < self._max_size:
            return
        with suppress(OSError):  # a full disk: the next call tries again
            new = self._file.with_name(f"{self._file.name}.new") if is_file else self._file
            descriptor = os.open(new, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o640)
            try:
                if is_file:
                    rotate(self._file, self._old_files)
                    new.rename(self._file)
                for stream in (1, 2):
                    os.dup2(descriptor, stream)
            finally:
                os.close(descriptor)


def _cut(record: logging.LogRecord, longest: int) -> None:
    with suppress(TypeError, ValueError):  # wrong arguments, which `logging` itself reports
        text = record.getMessage()
        shown = printable(text[:longest])
        if len(text) > longest:
            shown += f" ... ({len(text):,} characters in all)"
        if shown != text:
            record.msg, record.args = shown, None


def rotate(file: Path, old_files: int) -> None:
    """Rename a log file to FILE.1, FILE.1 to FILE.2 and so on; raises `OSError`."""
    for number in range(old_files, 0, -1):
        source = rotated(file, number - 1)
        if source.exists():
            source.replace(rotated(file, number))


def rotated(file: Path, number: int) -> Path:
    """Return the path of an older log file: 1 is the newest of them, 0 the file itself."""
    return file.with_name(f"{file.name}.{number}") if number else file
