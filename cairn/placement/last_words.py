"""How a component's process ended, in one sentence: from its exit and the end of its log."""

from collections import deque
from pathlib import Path

from cairn.supervision.child import ChildEnd
from cairn.supervision.child_process import WITHOUT_SUCCESS, ChildExit

_TAIL_BYTES = 4000
_TAIL_LINES = 20


def closing_words(pid: int, reason: str) -> str:
    """The line with which a component's process says why it ends."""
    return f"process {pid} ended: {'; '.join(reason.splitlines())}"


class LastWords:
    """What a process says in its component's log; made before the process is started.

    Former incarnations have written to the same file; on a full disk, this one perhaps nothing.
    """

    def __init__(self, log: Path) -> None:
        self._log = log
        try:
            self._begin = log.stat().st_size
        except OSError:  # there is none yet
            self._begin = 0

    def end_of(self, exit_: ChildExit) -> ChildEnd:
        """The end of the process; the reason tells how, and where its log is."""
        where = f"(process {exit_.pid}, log {self._log})"
        if exit_.signal is not None:
            return ChildEnd(False, f"{exit_.manner} {where}")
        words, last_line = self._tail(exit_.pid)
        if exit_.normal:
            success = exit_.code != WITHOUT_SUCCESS
            return ChildEnd(True, words or f"{exit_.manner} of its own accord", success)
        if words:
            return ChildEnd(False, f"failed {where}: {words}")
        said = f": {last_line}" if last_line else ""
        return ChildEnd(False, f"{exit_.manner} {where}{said}")

    def _tail(self, pid: int) -> tuple[str, str]:
        """The closing words of the process, "" if it had none, and the last line that it wrote."""
        mark = closing_words(pid, "")
        try:
            with self._log.open("rb") as file:
                end = file.seek(0, 2)
                file.seek(min(end, max(self._begin, end - _TAIL_BYTES)))
                lines = deque(file.read().decode(errors="replace").splitlines(), maxlen=_TAIL_LINES)
        except OSError:
            return "", ""
        for line in reversed(lines):
            if line.startswith(mark):
                return line.removeprefix(mark), line
        return "", lines[-1].strip() if lines else ""
