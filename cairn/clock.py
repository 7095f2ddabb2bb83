"""Clocks: the one source of time of a component, in integer nanoseconds."""

import time
from typing import Protocol

from cairn.schemas.builtin_interfaces import Time

SECOND = 1_000_000_000


class Clock(Protocol):
    """Where a component reads the time; replay and simulation exchange it, code never knows."""

    def now(self) -> int:
        """The time in nanoseconds since the clock's epoch."""
        ...


class SystemClock:
    """The computer's clock: nanoseconds since 1970-01-01 UTC."""

    def now(self) -> int:
        """The time in nanoseconds since 1970."""
        return time.time_ns()


class SimulatedClock:
    """Time as told by the messages on topic `clock`; 0 before the first."""

    def __init__(self) -> None:
        self._now = 0

    def now(self) -> int:
        """The time of the last clock message in nanoseconds."""
        return self._now

    def set(self, now: int) -> None:
        """Move on, or back, to `now`."""
        self._now = now


def to_ns(stamp: Time) -> int:
    """A message's time stamp in nanoseconds."""
    return stamp.sec * SECOND + stamp.nanosec


def from_ns(nanoseconds: int) -> Time:
    """Nanoseconds as a message's time stamp; seconds must fit an int32 (1901 to 2038)."""
    sec, nanosec = divmod(nanoseconds, SECOND)
    return Time(sec=sec, nanosec=nanosec)
