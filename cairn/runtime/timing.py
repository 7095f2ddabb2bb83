"""When a component's timers run: its clock, set forth and back, and its scheduler."""

import logging
from collections.abc import Callable, Iterable

from cairn.clock import Clock
from cairn.runtime.loop import Scheduler
from cairn.runtime.timers import Timers

Periodic = tuple[int, Callable[[], None]]
"""A period [ns] and what is called in it."""


class Timing:
    """Has the calls of one component made when its clock says so; only from its calls."""

    def __init__(
        self, clock: Clock, scheduler: Scheduler, log: logging.Logger, *, told: bool
    ) -> None:
        """`told`: the clock is moved by messages, and `moved` called then; else it runs."""
        self._clock = clock
        self._scheduler = scheduler
        self._log = log
        self._told = told
        self._timers = Timers()
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
