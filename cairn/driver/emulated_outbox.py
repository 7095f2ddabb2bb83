"""What an emulated device has to send, on its way onto the line: spoilt, and at a line's pace."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from cairn.driver.emulated_lines import LineEnd
from cairn.driver.faults import FrameFaults

_BUFFER = 65_536  # bytes of answers that are kept for a host that does not read; more are lost
_BITS_PER_BYTE = 10  # start, eight of data, stop
_PORTIONS = _BITS_PER_BYTE * 100  # a line that keeps its pace is given what it sends in 10 ms


@dataclass(frozen=True)
class _Frame:
    """Bytes to be sent, at a speed [bit/s] if that matters."""

    data: bytes
    baud: int | None


class Outbox:
    """Frames wait here until the line takes them."""

    def __init__(self, end: LineEnd, faults: FrameFaults, *, paced: bool) -> None:
        """`paced`: bytes take the time that their speed gives them."""
        self._end = end
        self._faults = faults
        self._paced = paced
        self._slow: int | None = None
        self._frames: deque[_Frame] = deque()
        self.free_at = 0.0
        """When the line has sent what it was given [s]."""
        self.frames_sent = 0
        """Frames that went onto the line, or were to, so far."""

    def __bool__(self) -> bool:
        """Whether something waits."""
        return bool(self._frames)

    def slow(self, baud: int | None) -> None:
        """Send no faster than that [bit/s] from now on; None: as before."""
        self._slow = baud
        self.free_at = 0.0

    def clear(self) -> None:
        """Throw away what waits."""
        self._frames.clear()

    def add(self, frames: list[bytes], baud: int | None, now: float) -> None:
        """Have frames sent at a speed [bit/s]; nobody gets them if nobody is there."""
        if not self._frames:
            self.free_at = max(self.free_at, now)  # what an idle line might have sent is lost
        for data in frames:
            waiting = sum(len(frame.data) for frame in self._frames)
            if waiting < _BUFFER and self._end.writable() is not None:
                self.frames_sent += 1
                self._frames.append(_Frame(self._faults.spoil(data), baud))

    def flush(self, now: float) -> None:
        """Give the line what it takes now; at the wrong speed nothing of it can be understood."""
        while self._frames and self.free_at <= now:
            frame = self._frames.popleft()
            pace = self._slow or (frame.baud if self._paced else None)
            part = frame.data if pace is None else frame.data[: max(1, pace // _PORTIONS)]
            spoken = self._end.baud()
            understood = None in (spoken, frame.baud) or spoken == frame.baud
            given = self._end.give(part if understood else bytes(len(part)))
            if given < len(frame.data):
                self._frames.appendleft(_Frame(frame.data[given:], frame.baud))
            if pace is not None:
                self.free_at = max(self.free_at, now - 0.1) + given * _BITS_PER_BYTE / pace
            if given < len(part):
                return
