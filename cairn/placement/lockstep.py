"""The lockstep executor: virtual time, one thread, events in time order; same seed, same run."""

import heapq
import itertools
from collections.abc import Callable
from functools import partial

from cairn.errors import CairnError

_EVENTS_AT_ONE_TIME = 1_000_000


class LockstepExecutor:
    """Runs calls in order of their virtual time, ties in order of arrival. It is also the clock."""

    def __init__(self, start: int = 0) -> None:
        self._now = start
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._calls_at_now = 0

    def now(self) -> int:
        """Virtual time in nanoseconds."""
        return self._now

    def at(self, time: int, call: Callable[[], None]) -> None:
        """Have `call` made at virtual time `time`, at once if that is past."""
        heapq.heappush(self._events, (max(time, self._now), next(self._order), call))

    def soon(self, call: Callable[[], None]) -> None:
        """Have `call` made now, after what was to be made now before."""
        heapq.heappush(self._events, (self._now, next(self._order), call))

    def scheduler(self) -> "LockstepScheduler":
        """The place of one component in the executor."""
        return LockstepScheduler(self)

    def run(self, until: Callable[[], bool]) -> None:
        """Make calls until `until()` holds.

        Raises `CairnError` when nothing is left to happen before that, or when time stands still
        under a flood of calls: two components that answer each other without end.
        """
        while not until():
            if not self._events:
                raise CairnError(
                    "lockstep: nothing is left to happen and nothing has ended the run; a "
                    "component with `significant: true` must finish"
                )
            self._step()

    def run_to(self, time: int) -> None:
        """Make all calls that are due at virtual time `time` [ns] or before; it is `time` then.

        Calls that these calls add for `time` or before are made too. Raises `CairnError` under a
        flood of calls at one instant, as `run` does.
        """
        while self._events and self._events[0][0] <= time:
            self._step()
        self._now = max(self._now, time)

    def _step(self) -> None:
        """Make the next call."""
        time, _, call = heapq.heappop(self._events)
        self._calls_at_now = self._calls_at_now + 1 if time == self._now else 0
        if self._calls_at_now > _EVENTS_AT_ONE_TIME:
            raise CairnError(
                f"lockstep: {_EVENTS_AT_ONE_TIME} calls at one instant ({time} ns); do two "
                "components answer each other without end?"
            )
        self._now = time
        call()


class LockstepScheduler:
    """Queues the calls of one component in the executor."""

    def __init__(self, executor: LockstepExecutor) -> None:
        self._executor = executor
        self._on_time: Callable[[], None] | None = None
        self._wake_at: int | None = None
        self._running = True

    def post(self, call: Callable[[], None]) -> None:
        """Have `call` made now, after what was posted before."""
        self._executor.soon(partial(self._make, call))

    def deliver(self, call: Callable[[], None]) -> None:
        """The same."""
        self.post(call)

    def wake_at(self, time: int) -> None:
        """Have the due timers run at virtual time `time`."""
        if self._wake_at is not None and self._wake_at <= time:
            return
        self._wake_at = time
        self._executor.at(time, partial(self._wake, time))

    def bind(self, on_time: Callable[[], None]) -> None:
        """Name the function that runs due timers."""
        self._on_time = on_time

    def stop(self) -> None:
        """Make no further calls."""
        self._running = False

    def _make(self, call: Callable[[], None]) -> None:
        if self._running:
            call()

    def _wake(self, time: int) -> None:
        if self._wake_at != time:
            return
        self._wake_at = None
        if self._running and self._on_time is not None:
            self._on_time()
