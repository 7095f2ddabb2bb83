"""The loop of a component: its calls, one at a time in order of arrival, and its timers."""

import math
import queue
import threading
import time as monotonic
from collections import deque
from collections.abc import Callable
from typing import Protocol

from cairn.clock import SECOND, SystemClock

_LONGEST_WAIT_S = 3600.0


class Scheduler(Protocol):
    """Where a component's calls are queued: a thread of its own, or the lockstep executor."""

    def post(self, call: Callable[[], None]) -> None:
        """Have `call` made after those before it, never by the calling thread; thread-safe."""
        ...

    def deliver(self, call: Callable[[], None]) -> None:
        """As `post`, for the thread that received a message: it may make the call itself."""
        ...

    def wake_at(self, time: int) -> None:
        """Have the component's `on_time` called at `time` of the system clock [ns].

        Replaces the time set before; only from within a call.
        """
        ...

    def bind(self, on_time: Callable[[], None]) -> None:
        """Name the function that runs due timers."""
        ...

    def stop(self) -> None:
        """Make no further calls; only from within a call."""
        ...


class ThreadLoop:
    """Makes the calls of one component, one at a time, whatever thread they come from.

    The thread that received a message makes the call itself if no other call is being made:
    waking a second thread for it would cost more than most handlers take. Calls are made in
    their order of arrival. The loop's own thread, that of `run`, does it for what was posted and
    for timers, and goes on with what came while a message was handled: a thread that receives
    has to get back to its topic.
    """

    def __init__(self) -> None:
        self._calls: deque[Callable[[], None]] = deque()
        self._turn = threading.Lock()  # held by the thread that makes calls
        self._bell: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._clock = SystemClock()
        self._wake_at: int | None = None
        self._asleep_until = -math.inf  # of the loop's own thread
        self._on_time: Callable[[], None] = _nothing
        self._running = True
        self._over = False
        self._failure: Exception | None = None

    def post(self, call: Callable[[], None]) -> None:
        """Have `call` made, not by the calling thread."""
        self._calls.append(call)
        self._bell.put(None)
        self._drop_if_over()

    def deliver(self, call: Callable[[], None]) -> None:
        """Have `call` made, by the calling thread if no other is at it."""
        self._calls.append(call)
        self._make_calls(len(self._calls))
        if self._calls:
            self._bell.put(None)
        self._drop_if_over()

    def wake_at(self, time: int) -> None:
        """Have the due timers run at `time` of the system clock [ns]."""
        # Waits go by a clock that nobody sets; `time` itself may be set back for hours.
        due = monotonic.monotonic_ns() + time - self._clock.now()
        self._wake_at = due
        if due < self._asleep_until:
            self._bell.put(None)

    def bind(self, on_time: Callable[[], None]) -> None:
        """Name the function that runs due timers."""
        self._on_time = on_time

    def stop(self) -> None:
        """Leave `run` after the current call."""
        self._running = False
        self._bell.put(None)

    def run(self) -> None:
        """Make calls until `stop`; raises what a call has let through, which none should."""
        while self._running:
            self._sleep()
            if self._wake_at is not None and self._wake_at <= monotonic.monotonic_ns():
                self._wake_at = None
                self._calls.append(self._on_time)
            while self._make_calls(len(self._calls)):
                pass
        with self._turn:  # the last call may be another thread's
            self._over = True
        self._drop_if_over()
        if self._failure is not None:
            raise self._failure

    def _sleep(self) -> None:
        # First say "asleep", then look for how long: a time set meanwhile rings the bell.
        self._asleep_until = math.inf
        due = self._wake_at
        wait = _LONGEST_WAIT_S
        if due is not None:
            self._asleep_until = due
            wait = min(wait, max(0.0, (due - monotonic.monotonic_ns()) / SECOND))
        try:
            self._bell.get(timeout=wait)
        except queue.Empty:
            pass
        finally:
            self._asleep_until = -math.inf

    def _make_calls(self, most: int) -> bool:
        """Make so many calls unless another thread is at it; whether there is more to do."""
        # After the turn is given back, look again: a call may have come while it was still held.
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

    def _drop_if_over(self) -> None:
        # Whoever waits for the answer to a request that is dropped learns so at once.
        if self._over:
            self._calls.clear()


def _nothing() -> None:
    """Before `bind` there are no timers."""
