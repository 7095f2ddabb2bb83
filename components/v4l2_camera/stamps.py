"""When a picture was taken: the kernel's time of it, in the time that messages are stamped with."""

from __future__ import annotations

import time
from typing import Final

_TRIES, _CLOSE_NS = 5, 5_000
_OLDEST_NS: Final = 60 * 1_000_000_000
_AHEAD_NS: Final = 1_000_000_000

_NUMBERS: Final = 1 << 32  # sequence numbers are unsigned, of 32 bits, and wrap


def system_offset() -> int:
    """What the system's time is ahead of CLOCK_MONOTONIC now [ns].

    It is asked anew for every picture: the system's clock is slewed and set, the other one never.
    """
    best, offset = None, 0
    for _ in range(_TRIES):
        before = time.monotonic_ns()
        system = time.time_ns()
        took = time.monotonic_ns() - before
        if best is None or took < best:  # the process may have been interrupted in between
            best, offset = took, system - before - took // 2
        if best <= _CLOSE_NS:
            break
    return offset


def is_likely(told: int, arrived: int) -> bool:
    """Whether a driver's time of a picture [ns of CLOCK_MONOTONIC] can be true.

    `arrived` is when the picture was read. What differs much was taken by another clock, whatever
    the driver says. A little ahead is what drivers are that reckon when a picture should come.
    """
    return arrived - _OLDEST_NS <= told <= arrived + _AHEAD_NS


class Sequence:
    """Follows the kernel's numbers of pictures; a number left out is a picture lost."""

    def __init__(self) -> None:
        self._last: int | None = None

    def lost_before(self, number: int) -> int:
        """How many pictures are missing between the last one noted and this, which is noted.

        0 where numbers went back: the driver began anew, or does not count.
        """
        last, self._last = self._last, number
        if last is None:
            return 0
        missing = (number - last - 1) % _NUMBERS
        return missing if missing < _NUMBERS // 2 else 0
