"""How a component's process ended, in one sentence: from its exit and the end of its log."""

from collections import deque
from pathlib import Path

from cairn.supervision.child import ChildEnd
from cairn.supervision.child_process import ChildExit

_TAIL_BYTES = 4000
_TAIL_LINES = 20


def closing_words(pid: int, reason: str) -> str:
    """The line with which a component's process says why it ends."""
    return f"process {pid} ended: {'; '.join(reason.splitlines())}"


def end_of(exit_: ChildExit, log: Path) -> ChildEnd:
    """The end of a component's process; the reason tells how, and where its log is."""
    where = f"(process {exit_.pid}, log {log})"
    if exit_.signal is not None:
        return ChildEnd(False, f"{exit_.manner} {where}")
    words, last_line = _tail(log, exit_.pid)
    if exit_.normal:
        return ChildEnd(True, words or f"{exit_.manner} of its own accord")
    if words:
        return ChildEnd(False, f"failed {where}: {words}")
    return ChildEnd(False, f"{exit_.manner} {where}" + (f": {last_line}" if last_line else ""))


def _tail(log: Path, pid: int) -> tuple[str, str]:
    """The closing words of a process, "" if it had none, and the last line of its log."""
    mark = closing_words(pid, "")
    try:
        with log.open("rb") as file:
            file.seek(0, 2)
            file.seek(max(0, file.tell() - _TAIL_BYTES))
            lines = deque(file.read().decode(errors="replace").splitlines(), maxlen=_TAIL_LINES)
    except OSError:
        return "", ""
    for line in reversed(lines):
        if line.startswith(mark):
            return line.removeprefix(mark), line
    return "", lines[-1].strip() if lines else ""
