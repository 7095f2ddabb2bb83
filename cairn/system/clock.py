"""Clocks: the one source of time of a component, in integer nanoseconds."""

import time
from typing import Protocol

SECOND = 1_000_000_000
"""One second in nanoseconds, the unit of all clocks."""


class Clock(Protocol):
    """The time of a component; the system's, simulated or replayed, without a difference to it.

    `now` may be called on any thread, also on a driver's device thread.
    """

    def now(self) -> int:
        """Return the time in nanoseconds since the clock's epoch."""


class SystemClock:
    """The computer's clock: nanoseconds since 1970-01-01 UTC."""

    def now(self) -> int:
        """Return the time in nanoseconds since 1970-01-01 UTC."""
        return time.time_ns()


class SimulatedClock:
    """A clock that is set by the messages on topic `clock`; 0 before the first message."""

    def __init__(self) -> None:
        self._now = 0

    def now(self) -> int:
        """Return the time of the last clock message in nanoseconds."""
        return self._now

    def set(self, now: int) -> None:
        """Set the time to `now` [ns], which may be earlier than before."""
        self._now = now


class SteadyClock:
    """Time that passes as another clock's does, but without its steps.

    It is for what a component judges by the time since, such as that nothing arrives any more. Call
    `now` on one thread and more often than every `longest_s` [s]: what is more between two calls is
    a step of the clock, or the process stood still; both count as no time, as does a step back.
    """

    def __init__(self, clock: Clock, longest_s: float) -> None:
        self._clock = clock
        self._longest = round(longest_s * SECOND)
        self._read = clock.now()
        self._steps = 0

    def now(self) -> int:
        """Return the time in nanoseconds: that of the other clock until its first step."""
        before, self._read = self._read, self._clock.now()
        if not 0 <= self._read - before <= self._longest:
            self._steps += self._read - before
        return self._read - self._steps


def has_passed(seconds: float, since: int, now: int) -> bool:
    """Return whether a time [s] has passed from `since` to `now` [ns].

    True also if `now` is earlier: the clock was set back, so how much has passed is not known, and
    what is to be done every few seconds must not wait until the clock is where it was.
    """
    return not 0 <= now - since < seconds * SECOND
