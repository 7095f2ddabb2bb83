"""Where in a list of recorded times a driver stands, and which records are due."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cairn.clock import SECOND

LATE_NS = SECOND // 2


def nanoseconds(time_s: NDArray[np.float64]) -> list[int]:
    """Recorded times [s] as whole nanoseconds; microseconds are what a double holds of them."""
    return [round(t * 1e6) * 1000 for t in time_s.tolist()]


class Records:
    """The records of one topic, by their times [ns], taken in order as time passes."""

    def __init__(self, times: Sequence[int]) -> None:
        self._times = times
        self._next = 0
        self._begun = False

    def due(self, now: int) -> tuple[range, int]:
        """The records whose time has come, and how many are skipped before them.

        Only at first are records skipped: those that passed more than 0.5 s ago, before the
        driver was there (started late, or anew).
        """
        skipped = 0
        if not self._begun and now > 0:
            self._begun = True
            while self._next < len(self._times) and self._times[self._next] < now - LATE_NS:
                self._next += 1
            skipped = self._next
        first = self._next
        while self._next < len(self._times) and self._times[self._next] <= now:
            self._next += 1
        return range(first, self._next), skipped

    @property
    def left(self) -> int:
        """How many records are yet to come."""
        return len(self._times) - self._next
