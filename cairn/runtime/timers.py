"""Timers of one component, ordered by due time, then by the order in which they were set."""

import heapq
from collections.abc import Callable


class Timers:
    """A queue of calls to be made at given times of one clock, in nanoseconds."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, Callable[[], None], bool]] = []
        self._round = 0
        self.newest = 0

    def at(self, due: int, call: Callable[[], None]) -> None:
        """Have `call` made at time `due`."""
        self._push(due, call, periodic=False)

    def every(
        self, start: int, period: int, now: Callable[[], int], call: Callable[[], None]
    ) -> None:
        """Have `call` made at `start` and every `period` after; periods missed are skipped."""
        begun = self._round

        def repeat() -> None:
            call()
            if self._round != begun:
                return  # the call has brought an end to all periodic ones
            late = max(0, now() - start)
            self.every(start + (late // period + 1) * period, period, now, call)

        self._push(start, repeat, periodic=True)

    def next_due(self) -> int | None:
        """When the next call is due; None if there is none."""
        return self._heap[0][0] if self._heap else None

    def pop_due(self, now: int, newest: int) -> Callable[[], None] | None:
        """Take out the first call that is due at `now`; None if none is, or it is a newer one.

        `newest` is the value of that attribute, the number of calls set, to be regarded.
        """
        if self._heap and self._heap[0][0] <= now and self._heap[0][1] <= newest:
            return heapq.heappop(self._heap)[2]
        return None

    def forget_periodic(self) -> None:
        """Forget the calls set by `every`."""
        self._round += 1
        self._heap = [entry for entry in self._heap if not entry[3]]
        heapq.heapify(self._heap)

    def clear(self) -> None:
        """Forget all calls."""
        self._round += 1
        self._heap.clear()

    def _push(self, due: int, call: Callable[[], None], *, periodic: bool) -> None:
        self.newest += 1
        heapq.heappush(self._heap, (due, self.newest, call, periodic))
