"""How a process of Cairn ends: its exit code, and the report on why it ended."""

import atexit
import os
import signal
import sys
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

WORK_NOT_DONE = 100
"""Exit code of a process that ended normally, but whose work was not done."""

_TAIL_BYTES = 4000
_TAIL_LINES = 20
_SEARCHED_BYTES = 1 << 20


@dataclass(frozen=True)
class ExitReport:
    """How a component ended.

    `normal`: it finished or was asked to stop; otherwise it failed or was killed. `success`: its
    work was done; only a normal end can be without success. `reason` is a phrase, such as
    "killed by SIGSEGV (signal 11)".
    """

    normal: bool
    reason: str
    success: bool = True

    @property
    def exit_code(self) -> int:
        """The exit code of a process that ends with this report."""
        if not self.normal:
            return 1
        return 0 if self.success else WORK_NOT_DONE


@dataclass(frozen=True)
class LogPosition:
    """A position in a log: the file, by inode number, and its size then [bytes]."""

    inode: int
    size: int


class ExitLog:
    """Reads from a component's log why a process of it ended. Create it before the process.

    Earlier incarnations have written to the same file; on a full disk the process may not have
    been able to write at all. When the file is long, it is renamed to FILE.1, and a new one is
    started (`OutputFile`).
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self._start = self.end()

    def end(self) -> LogPosition:
        """Return the position of the end of the log."""
        try:
            status = self.file.stat()
        except OSError:  # it does not exist yet
            return LogPosition(0, 0)
        return LogPosition(status.st_ino, status.st_size)

    def has_since(self, position: LogPosition, text: bytes) -> bool:
        """Return whether the log contains `text` after a position, in its last megabyte."""
        return text in self._since(position, _SEARCHED_BYTES)

    def _since(self, position: LogPosition, most: int) -> bytes:
        """Return the last `most` bytes of the log after a position."""
        read = b""
        for path in (self.file, self.file.with_name(f"{self.file.name}.1")):
            try:
                with path.open("rb") as file:
                    status = os.fstat(file.fileno())
                    # Older files are older. A new file may get the number of a removed one.
                    is_same = status.st_ino == position.inode
                    is_continued = is_same and status.st_size >= position.size
                    begin = position.size if is_continued else 0
                    file.seek(max(begin, status.st_size - (most - len(read))))
                    read = file.read(most - len(read)) + read
            except OSError:
                continue
            if is_continued or len(read) >= most:
                break
        return read

    def report(self, pid: int, code: int) -> ExitReport:
        """Return the report on a process that ended with this exit code, -N by signal N."""
        where = f"(process {pid}, log {self.file})"
        if code < 0:
            known = {one.value: one.name for one in signal.Signals}
            name = known.get(-code, "a real-time signal")
            return ExitReport(False, f"killed by {name} (signal {-code}) {where}")
        reason, last_line = self._tail(pid)
        if code in (0, WORK_NOT_DONE):
            return ExitReport(True, reason or f"exit code {code}", code == 0)
        reason = reason or f"exit code {code}{f': {last_line}' if last_line else ''}"
        return ExitReport(False, f"{reason} {where}")

    def _tail(self, pid: int) -> tuple[str, str]:
        """Return the reason that the process logged, and its last line; "" for what is missing."""
        prefix = _closing_line(pid, "")
        text = self._since(self._start, _TAIL_BYTES).decode(errors="replace")
        lines = deque(text.splitlines(), maxlen=_TAIL_LINES)
        for line in reversed(lines):
            if line.startswith(prefix):
                return line.removeprefix(prefix), line
        return "", lines[-1].strip() if lines else ""


def log_reason(reason: str) -> None:
    """Write to standard error why this process ends, so that `ExitLog` finds it in its log."""
    try:
        sys.stderr.write(f"{_closing_line(os.getpid(), reason)}\n")
        sys.stderr.flush()
    except OSError:  # a full disk; nothing may be flushed at exit, or the exit code would be lost
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def _closing_line(pid: int, reason: str) -> str:
    return f"process {pid} ended: {'; '.join(reason.splitlines())}"


def end_process(code: int) -> NoReturn:
    """End the calling process with this exit code, whatever its other threads are doing.

    The interpreter's own end is skipped. It unwinds threads that are inside a library, and Rust
    code (Zenoh) answers that with an abort: the process would end by SIGABRT instead of with its
    code. Besides, the kernel frees the memory at once; freeing each object took a tenth of the
    processor time of starting and stopping a small deployment.
    """
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):  # a full disk, or the reader is gone: the code still counts
            stream.flush()
    os._exit(code)
