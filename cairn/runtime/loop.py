"""The loop of a component: makes its calls one at a time, in order of arrival, and on time."""

import math
import threading
import time as monotonic
from collections import deque
from collections.abc import Callable
from typing import Protocol

from cairn.system.bell import Bell
from cairn.system.clock import SECOND, SystemClock

_LONGEST_WAIT_S = 3600.0
_SET_BACK_NS = 1_000_000  # less is jitter of the readings, or a time service that slows the clock


class Scheduler(Protocol):
    """Where a component's calls are queued: a thread of its own, or the lockstep executor."""

    def post(self, call: Callable[[], None]) -> None:
        """Queue `call` behind those before it; never made by the calling thread; thread-safe."""

    def deliver(self, call: Callable[[], None]) -> None:
        """Queue `call` for a received message; the calling thread may make it itself."""

    def receive(self, call: Callable[[], None]) -> None:
        """Queue `call` for a received answer; never made by the calling thread; thread-safe."""

    def wake_at(self, time: int) -> None:
        """Call the function given to `bind` at `time` of the system clock [ns].

        Replaces the time set before; only from within a call.
        """

    def bind(self, on_time: Callable[[], None]) -> None:
        """Set the function that runs due timers."""

    def stop(self) -> None:
        """Make no further calls; only from within a call."""


class ThreadLoop:
    """Makes the calls of one component, one at a time, on whatever thread they come from.

    The thread that received a message makes the call itself if no other call is in progress:
    waking a second thread for it would cost more than most handlers take. Calls are made in order
    of arrival. The loop's own thread, which is in `run`, makes the calls that were posted and those
    of timers, and continues with calls that arrived while a message was handled, because a
    receiving thread has to return to its topic.
    """

    def __init__(self) -> None:
        self._calls: deque[Callable[[], None]] = deque()
        self._turn = threading.Lock()  # held by the thread that makes calls
        self._bell = Bell()
        self._clock = SystemClock()
        self._clock_ahead: float = -math.inf  # of the monotonic clock [ns]
        self._wake_at: int | None = None
        self._asleep_until = -math.inf  # of the loop's own thread
        self._on_time: Callable[[], None] = _do_nothing
        self._running = True
        self._finished = False
        self._failure: Exception | None = None

    def post(self, call: Callable[[], None]) -> None:
        """Queue `call`; another thread than the calling one makes it."""
        self._calls.append(call)
        self._bell.ring()
        self._discard_if_finished()

    def receive(self, call: Callable[[], None]) -> None:
        """Queue `call`, as `post` does."""
        self.post(call)

    def deliver(self, call: Callable[[], None]) -> None:
        """Queue `call`; the calling thread makes it if no other call is in progress."""
        self._calls.append(call)
        self._make_calls(len(self._calls))
        if self._calls:
            self._bell.ring()
        self._discard_if_finished()

    def wake_at(self, time: int) -> None:
        """Run the due timers at `time` of the system clock [ns]."""
        # Waits use the monotonic clock, which is never set; the system clock may be set back. If it
        # has just been, `time` is from before, and the timers have to learn of it now.
        awake = monotonic.monotonic_ns()
        ahead, before = self._clock.now() - awake, self._clock_ahead
        self._clock_ahead = ahead
        due = awake if ahead < before - _SET_BACK_NS else time - ahead
        self._wake_at = due
        if due < self._asleep_until:
            self._bell.ring()

    def bind(self, on_time: Callable[[], None]) -> None:
        """Set the function that runs due timers."""
        self._on_time = on_time

    def stop(self) -> None:
        """Leave `run` after the current call."""
        self._running = False
        self._bell.ring()

    def run(self) -> None:
        """Make calls until `stop`; raises an exception that a call has let through."""
        while self._running:
            self._sleep()
            if self._wake_at is not None and self._wake_at <= monotonic.monotonic_ns():
                self._wake_at = None
                self._calls.append(self._on_time)
            while self._make_calls(len(self._calls)):
                pass
        with self._turn:  # the last call may be in progress on another thread
            self._finished = True
        self._discard_if_finished()
        if self._failure is not None:
            raise self._failure

    def _sleep(self) -> None:
        # Announce the sleep before reading its end: a time set in between rings the bell.
        self._asleep_until = math.inf
        due = self._wake_at
        wait = _LONGEST_WAIT_S
        if due is not None:
            self._asleep_until = due
            wait = min(wait, max(0.0, (due - monotonic.monotonic_ns()) / SECOND))
        self._bell.wait(wait)
        self._asleep_until = -math.inf

    def _make_calls(self, most: int) -> bool:
        """Make up to `most` calls unless another thread makes some; return whether any are left."""
        # Check again after releasing the turn: a call may have arrived while it was still held.
        while self._calls and self._running and most > 0:
            if not self._turn.acquire(blocking=False):
                return False
            try:
                while self._calls and self._running and most > 0:
                    most -= 1
                    self._calls.popleft()()
            except Exception as error:
                self._failure = error
                self.stop()
            finally:
                self._turn.release()
        return bool(self._calls) and self._running

    def _discard_if_finished(self) -> None:
        # A process that waits for the reply to a discarded request learns so at once.
        if self._finished:
            self._calls.clear()


def _do_nothing() -> None:
    """Stand in for the function that runs timers, before `bind`."""
