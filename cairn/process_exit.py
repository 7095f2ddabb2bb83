"""How a process of Cairn ends: its exit code, and the report on why it ended."""

import atexit
import os
import signal
import sys
import threading
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

WORK_NOT_DONE = 100
"""Exit code of a process that ended normally, but whose work was not done."""

_TAIL_BYTES = 4000
_TAIL_LINES = 20


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


class ExitLog:
    """Reads from a component's log why a process of it ended. Create it before the process.

    Earlier incarnations have written to the same file; on a full disk the process may not have
    been able to write at all.
    """

    def __init__(self, file: Path) -> None:
        self.file = file
        self._start = self.size()

    def size(self) -> int:
        """Return the size of the log [bytes], 0 if it does not exist yet."""
        try:
            return self.file.stat().st_size
        except OSError:
            return 0

    def has_since(self, size: int, text: bytes) -> bool:
        """Return whether the log contains `text` after its first `size` bytes."""
        try:
            with self.file.open("rb") as file:
                file.seek(size)
                return text in file.read()
        except OSError:
            return False

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
        try:
            with self.file.open("rb") as file:
                end = file.seek(0, 2)
                file.seek(min(end, max(self._start, end - _TAIL_BYTES)))
                lines = deque(file.read().decode(errors="replace").splitlines(), maxlen=_TAIL_LINES)
        except OSError:
            return "", ""
        for line in reversed(lines):
            if line.startswith(prefix):
                return line.removeprefix(prefix), line
        return "", lines[-1].strip() if lines else ""


def log_reason(reason: str) -> None:
    """Write to standard error why this process ends, so that `ExitLog` finds it in its log."""
    try:
        print(_closing_line(os.getpid(), reason), file=sys.stderr, flush=True)  # noqa: T201
    except OSError:  # a full disk; nothing may be flushed at exit, or the exit code would be lost
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)


def _closing_line(pid: int, reason: str) -> str:
    return f"process {pid} ended: {'; '.join(reason.splitlines())}"


def end_process(code: int) -> NoReturn:
    """End the calling process with this exit code, whatever its other threads are doing.

    When the interpreter ends, Python unwinds threads that are inside a library, and Rust code
    (Zenoh) answers that with an abort: the process would end by SIGABRT instead of with its code.
    So where threads are left, as after a component that hangs, the interpreter's own end is
    skipped.
    """
    if threading.active_count() > 1:
        atexit._run_exitfuncs()
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError):  # a full disk, or the reader is gone: the code still counts
                stream.flush()
        os._exit(code)
    sys.exit(code)
