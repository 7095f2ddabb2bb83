"""Stamps of images: the kernel's capture time, converted to the system's time."""

from __future__ import annotations

import time
from typing import Final

_TRIES, _CLOSE_NS = 5, 5_000
_OLDEST_NS: Final = 60 * 1_000_000_000
_AHEAD_NS: Final = 1_000_000_000


def system_offset() -> int:
    """Return how far the system's time is ahead of CLOCK_MONOTONIC now [ns].

    It is measured for every image: the system's clock is slewed and set, the other one never.
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


def is_plausible(captured: int, arrived: int) -> bool:
    """Return whether a driver's capture time [ns of CLOCK_MONOTONIC] can be true.

    `arrived` is when the image was read. A time that differs by much comes from another clock,
    whatever the driver reports. Drivers that predict the time of an image may be slightly ahead.
    """
    return arrived - _OLDEST_NS <= captured <= arrived + _AHEAD_NS
