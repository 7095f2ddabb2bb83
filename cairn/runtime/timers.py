"""Timers of a component: calls ordered by the time at which they are due, and their clock."""

import heapq
import logging
from collections.abc import Callable, Iterable

from cairn.bus.bus import Node, Subscription
from cairn.bus.qos import Qos
from cairn.clock import Clock, SimulatedClock, to_ns
from cairn.runtime.loop import Scheduler
from cairn.schemas.message import InvalidMessage
from cairn.schemas.rosgraph_msgs import Clock as ClockMessage

Periodic = tuple[int, Callable[[], None]]
"""A period [ns] and what is called in it."""


class ComponentTimers:
    """Has the calls of one component made when its clock says so; only from its calls."""

    def __init__(
        self, clock: Clock, scheduler: Scheduler, log: logging.Logger, *, told: bool
    ) -> None:
        """`told`: the clock is moved by messages, and `moved` called then; else it runs."""
        self._clock = clock
        self._scheduler = scheduler
        self._log = log
        self._told = told
        self._timers = TimerQueue()
        self._periodic: tuple[Periodic, ...] = ()
        self._seen = clock.now()
        self._posted = False
        scheduler.bind(self._turn)

    def start(self, periodic: Iterable[Periodic]) -> None:
        """Have these calls made in their periods, from now."""
        self._periodic = tuple(periodic)
        now = self._clock.now()
        for period, call in self._periodic:
            self._timers.every(now + period, period, self._clock.now, call)
        self._arm()

    def at(self, due: int, call: Callable[[], None]) -> None:
        """Have `call` made once at time `due`; soon if that is past."""
        self._timers.at(due, call)
        self._arm()

    def moved(self) -> None:
        """Make the calls that are due now that the clock has been moved, forth or back."""
        now = self._clock.now()
        back, self._seen = now < self._seen, now
        if back:
            self._log.warning("time was set back; periodic calls start anew")
            self._timers.forget_periodic()
            self.start(self._periodic)
        # What is set meanwhile waits for the next turn: a call that sets itself anew for now
        # must not keep all others from being made.
        newest = self._timers.newest
        while (call := self._timers.pop_due(now, newest)) is not None:
            call()
        self._arm()

    def stop(self) -> None:
        """Forget all calls."""
        self._periodic = ()
        self._timers.clear()

    def _turn(self) -> None:
        self._posted = False
        self.moved()

    def _arm(self) -> None:
        due = self._timers.next_due()
        if due is None:
            return
        if not self._told:
            self._scheduler.wake_at(due)
        elif due <= self._clock.now() and not self._posted:
            self._posted = True
            self._scheduler.post(self._turn)


class TimerQueue:
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


CLOCK_TOPIC = "clock"
_NEWEST = Qos("reliable", "volatile", 1)


class ClockInput:
    """Reads clock messages (only the newest matters) and moves the clock and the timers."""

    def __init__(
        self,
        clock: SimulatedClock,
        node: Node,
        topic: str,
        scheduler: Scheduler,
        moved: Callable[[], None],
        complain: Callable[[str], None],
    ) -> None:
        self._clock = clock
        self._node = node
        self._topic = topic
        self._scheduler = scheduler
        self._moved = moved
        self._complain = complain
        self._subscription: Subscription | None = None

    def open(self) -> None:
        """Begin to follow the topic."""
        if self._subscription is None:
            self._subscription = self._node.subscribe(
                self._topic, ClockMessage, _NEWEST, lambda: self._scheduler.deliver(self._deliver)
            )

    def _deliver(self) -> None:
        if self._subscription is None:
            return
        try:
            message = self._subscription.take()
        except InvalidMessage as error:
            self._complain(f"message on {self._topic} refused: {error}")
            return
        if message is not None:
            self._clock.set(to_ns(message.clock))
            self._moved()
