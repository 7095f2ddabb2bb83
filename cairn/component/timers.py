"""Timers of one component, ordered by due time, then by the order in which they were set."""

import heapq
import itertools
from collections.abc import Callable


class Timers:
    """A queue of calls to be made at given times of one clock, in nanoseconds."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, Callable[[], None]]] = []
        self._order = itertools.count()

    def at(self, due: int, call: Callable[[], None]) -> None:
        """Have `call` made at time `due`."""
        heapq.heappush(self._heap, (due, next(self._order), call))

    def every(
        self, start: int, period: int, now: Callable[[], int], call: Callable[[], None]
    ) -> None:
        """Have `call` made at `start` and every `period` after; periods missed are skipped."""

        def repeat() -> None:
            call()
            late = max(0, now() - start)
            self.every(start + (late // period + 1) * period, period, now, call)

        self.at(start, repeat)

    def next_due(self) -> int | None:
        """When the next call is due; None if there is none."""
        return self._heap[0][0] if self._heap else None

    def pop_due(self, now: int) -> Callable[[], None] | None:
        """Take out the first call that is due at `now`; None if none is."""
        if self._heap and self._heap[0][0] <= now:
            return heapq.heappop(self._heap)[2]
        return None

    def clear(self) -> None:
        """Forget all calls."""
        self._heap.clear()
