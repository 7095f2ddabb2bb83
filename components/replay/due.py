"""Where in a list of recorded times a driver stands, and which records are due."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence

from cairn import SECOND

LATE_NS = SECOND // 2


class Records:
    """The records of one topic, by their times [ns], taken in order as time passes.

    Those before `begin` and after `end` [ns] are left out, if these are given.
    """

    def __init__(
        self, times: Sequence[int], begin: int | None = None, end: int | None = None
    ) -> None:
        self._times = times
        self._next = 0 if begin is None else bisect_left(times, begin)
        self._end = len(times) if end is None else bisect_right(times, end)
        self._begun = False

    def due(self, now: int) -> tuple[range, int]:
        """The records whose time has come, and how many are skipped before them.

        Only at first are records skipped: those that passed more than 0.5 s ago, before the
        driver was there (started late, or anew).
        """
        skipped = 0
        if not self._begun and now > 0:
            self._begun = True
            first = self._next
            while self._next < self._end and self._times[self._next] < now - LATE_NS:
                self._next += 1
            skipped = self._next - first
        first = self._next
        while self._next < self._end and self._times[self._next] <= now:
            self._next += 1
        return range(first, self._next), skipped
