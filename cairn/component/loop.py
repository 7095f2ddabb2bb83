"""The loop of a component: one thread takes calls in their order of arrival, and timers."""

import queue
from collections.abc import Callable
from typing import Protocol

from cairn.clock import SECOND, SystemClock

_LONGEST_WAIT_S = 3600.0


class Scheduler(Protocol):
    """Where a component's calls are queued: a thread of its own, or the lockstep executor."""

    def post(self, call: Callable[[], None]) -> None:
        """Have `call` made on the component's thread, after those posted before; thread-safe."""
        ...

    def wake_at(self, time: int) -> None:
        """Have the component's `on_time` called at `time` of the system clock [ns].

        Replaces the time set before; only from the component's thread.
        """
        ...

    def bind(self, on_time: Callable[[], None]) -> None:
        """Name the function that runs due timers."""
        ...

    def stop(self) -> None:
        """Make no further calls; only from the component's thread."""
        ...


class ThreadLoop:
    """Runs one component on the thread that calls `run`."""

    def __init__(self) -> None:
        self._calls: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._clock = SystemClock()
        self._wake_at: int | None = None
        self._on_time: Callable[[], None] = _nothing
        self._running = True

    def post(self, call: Callable[[], None]) -> None:
        """Have `call` made on the loop's thread."""
        self._calls.put(call)

    def wake_at(self, time: int) -> None:
        """Have the due timers run at `time` of the system clock [ns]."""
        self._wake_at = time

    def bind(self, on_time: Callable[[], None]) -> None:
        """Name the function that runs due timers."""
        self._on_time = on_time

    def stop(self) -> None:
        """Leave `run` after the current call."""
        self._running = False

    def run(self) -> None:
        """Make calls until `stop`."""
        while self._running:
            wait = _LONGEST_WAIT_S
            if self._wake_at is not None:
                wait = (self._wake_at - self._clock.now()) / SECOND
                if wait <= 0:
                    self._wake_at = None
                    self._on_time()
                    continue
            try:
                call = self._calls.get(timeout=min(wait, _LONGEST_WAIT_S))
            except queue.Empty:
                continue
            call()


def _nothing() -> None:
    """Before `bind` there are no timers."""
