"""Timers of a component: calls ordered by the time at which they are due, and their clock."""

import heapq
import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass

from cairn.bus.bus import Node, Subscription
from cairn.bus.qos import Qos
from cairn.runtime.loop import Scheduler
from cairn.schemas.builtin_interfaces import to_ns
from cairn.schemas.message import InvalidMessage
from cairn.schemas.rosgraph_msgs import Clock as ClockMessage
from cairn.system.clock import Clock, SimulatedClock

CLOCK_TOPIC = "clock"
_NEWEST = Qos("reliable", "volatile", 1)

Periodic = tuple[int, Callable[[], None]]
"""A period [ns] and the call to make in it."""


class ComponentTimers:
    """Makes the timed calls of one component when its clock reaches their times.

    Its methods may be called only from the component's own calls.
    """

    def __init__(
        self, clock: Clock, scheduler: Scheduler, log: logging.Logger, *, simulated: bool
    ) -> None:
        """With `simulated` time, messages set the clock, and `on_clock_set` is called then."""
        self._clock = clock
        self._scheduler = scheduler
        self._log = log
        self._simulated = simulated
        self._timers = TimerQueue()
        self._periodic: tuple[Periodic, ...] = ()
        self._last_time = clock.now()
        self._posted = False
        scheduler.bind(self._run_due)

    def start(self, periodic: Iterable[Periodic]) -> None:
        """Start the periodic calls; the first of each is due one period from now."""
        self._periodic = tuple(periodic)
        now = self._clock.now()
        for period, call in self._periodic:
            self._timers.every(now + period, period, self._clock.now, call)
        self._request_wake_up()

    def at(self, due: int, call: Callable[[], None]) -> None:
        """Make `call` once at time `due` [ns], or soon if that is past.

        If the clock is set back meanwhile, so is `due`.
        """
        self._timers.at(due, call)
        self._request_wake_up()

    def on_clock_set(self) -> None:
        """Make the calls that are due, after the clock was set forward or back."""
        now = self._clock.now()
        last, self._last_time = self._last_time, now
        if now < last:
            self._log.warning("time was set back: restarted the periodic calls")
            self._timers.set_back(last - now)
            self.start(self._periodic)
        # Timers set by these calls wait for the next turn: a call that sets a timer for now again
        # and again must not keep all other calls from being made.
        newest = self._timers.newest
        while (call := self._timers.pop_due(now, newest)) is not None:
            call()
        self._request_wake_up()

    def stop(self) -> None:
        """Discard all calls."""
        self._periodic = ()
        self._timers.clear()

    def _run_due(self) -> None:
        self._posted = False
        self.on_clock_set()

    def _request_wake_up(self) -> None:
        due = self._timers.next_due()
        if due is None:
            return
        if not self._simulated:
            self._scheduler.wake_at(due)
        elif due <= self._clock.now() and not self._posted:
            self._posted = True
            self._scheduler.post(self._run_due)


class TimerQueue:
    """Calls to be made at times of one clock [ns], by due time, then in the order they were set."""

    def __init__(self) -> None:
        self._heap: list[tuple[int, int, Callable[[], None], bool]] = []
        self._generation = 0
        self.newest = 0
        """Number of the newest timer, which counts from 1."""

    def at(self, due: int, call: Callable[[], None]) -> None:
        """Set a timer: make `call` at time `due`."""
        self._push(due, call, periodic=False)

    def every(
        self, start: int, period: int, now: Callable[[], int], call: Callable[[], None]
    ) -> None:
        """Set a periodic timer: make `call` at `start` and every `period`, skipping missed ones."""
        generation = self._generation

        def repeat() -> None:
            call()
            if self._generation != generation:
                return  # the call has ended all periodic timers
            late = max(0, now() - start)
            self.every(start + (late // period + 1) * period, period, now, call)

        self._push(start, repeat, periodic=True)

    def next_due(self) -> int | None:
        """Return when the next call is due; None if there is none."""
        return self._heap[0][0] if self._heap else None

    def pop_due(self, now: int, newest: int) -> Callable[[], None] | None:
        """Remove and return the first call due at `now`, if its timer is not newer than `newest`.

        Returns None otherwise.
        """
        if self._heap and self._heap[0][0] <= now and self._heap[0][1] <= newest:
            return heapq.heappop(self._heap)[2]
        return None

    def set_back(self, by: int) -> None:
        """Discard the timers set by `every`; those set by `at` are due earlier by `by`."""
        self._generation += 1
        self._heap = [
            (due - by, number, call, periodic)
            for due, number, call, periodic in self._heap
            if not periodic
        ]
        heapq.heapify(self._heap)

    def clear(self) -> None:
        """Discard all timers."""
        self._generation += 1
        self._heap.clear()

    def _push(self, due: int, call: Callable[[], None], *, periodic: bool) -> None:
        self.newest += 1
        heapq.heappush(self._heap, (due, self.newest, call, periodic))


@dataclass(eq=False)
class ClockInput:
    """Subscribes to topic `clock` and sets a component's simulated clock by its newest message.

    It calls `on_clock_set` after each message; `report` receives errors about invalid ones.
    """

    clock: SimulatedClock
    node: Node
    topic: str
    scheduler: Scheduler
    on_clock_set: Callable[[], None]
    report: Callable[[str], None]
    _subscription: Subscription | None = None

    def open(self) -> None:
        """Subscribe to the topic, unless that is done already."""
        if self._subscription is None:
            self._subscription = self.node.subscribe(
                self.topic, ClockMessage, _NEWEST, lambda: self.scheduler.deliver(self._receive)
            )

    def _receive(self) -> None:
        if self._subscription is None:
            return
        try:
            message = self._subscription.take()
        except InvalidMessage as error:
            self.report(f"rejected an invalid message on {self.topic}: {error}")
            return
        if message is not None:
            self.clock.set(to_ns(message.clock))
            self.on_clock_set()
