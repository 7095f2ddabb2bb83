"""Reading the encoders, with the time at which they were read."""

from __future__ import annotations

import time
from dataclasses import dataclass

from cairn.components.roboclaw.commands import ENCODERS
from cairn.components.roboclaw.dialogue import Dialogue
from cairn.components.roboclaw.kinematics import counted

_READINGS = 3
_PROMPT_S = 0.004  # a reply that takes so much longer than usual came late
_FORGET = 1.02  # a line that becomes slower is usual after a while: growth per reading


@dataclass(frozen=True)
class Counted:
    """The counters of M1 and M2, and when they were read: half-way from question to reply."""

    at: float
    """[s of the monotonic clock]"""
    stamp: int
    """By the system's clock [ns]."""
    counts: tuple[int, ...]

    def since(self, before: Counted) -> tuple[int, int]:
        """How far both have counted."""
        first, second = (counted(a, b) for a, b in zip(before.counts, self.counts, strict=True))
        return first, second

    def from_zero(self) -> tuple[int, int]:
        """How far both are from 0, where they begin when the RoboClaw is switched on."""
        first, second = (counted(0, count) for count in self.counts)
        return first, second


class EncoderReader:
    """Reads both counters in one packet.

    If the reply takes longer than usual on this line, nobody knows when they were read, and they
    are read again: else speeds would be wrong by the share that this is of a period.
    """

    def __init__(self, dialogue: Dialogue) -> None:
        self._dialogue = dialogue
        self._usual_s = float("inf")

    def read(self) -> Counted:
        """The counters now; raises `DeviceError`."""
        readings = []
        for _ in range(_READINGS):
            took, found = self._once()
            readings.append((took, found))
            self._usual_s = min(took, self._usual_s * _FORGET)
            if took < self._usual_s + _PROMPT_S:
                break
        return min(readings, key=lambda one: one[0])[1]

    def _once(self) -> tuple[float, Counted]:
        sent, sent_ns = time.monotonic(), time.time_ns()
        counts = self._dialogue.ask(ENCODERS)
        took, took_ns = time.monotonic() - sent, time.time_ns() - sent_ns
        return took, Counted(sent + 0.5 * took, sent_ns + took_ns // 2, counts)
