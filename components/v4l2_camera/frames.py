"""Frames of a camera: when each was captured; counts of those published, lost, dropped, damaged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

_OLDEST_NS: Final = 60 * 1_000_000_000
_AHEAD_NS: Final = 1_000_000_000
_NUMBERS: Final = 1 << 32  # sequence numbers are unsigned, of 32 bits, and wrap


def is_plausible(captured: int, arrived: int) -> bool:
    """Return whether a driver's capture time [ns of CLOCK_MONOTONIC] can be true.

    `arrived` is when the image was read. A time that differs by much comes from another clock,
    whatever the driver reports. Drivers that predict the time of an image may be slightly ahead.
    """
    return arrived - _OLDEST_NS <= captured <= arrived + _AHEAD_NS


@dataclass
class FrameCounts:
    """Counts since the camera was configured. One thread counts, others only read.

    `images` were passed on; `lost` are missing in the kernel's sequence numbers; `dropped` were
    replaced by a newer one that had arrived as well; `marked` were damaged according to the kernel
    driver, `short` had too few bytes, `damaged` could not be decoded; `unstamped` have their
    time of arrival, as the kernel driver reported no plausible time. `restarts` of the stream and
    `reopened` devices are the recoveries.
    """

    images: int = 0
    lost: int = 0
    dropped: int = 0
    marked: int = 0
    short: int = 0
    damaged: int = 0
    unstamped: int = 0
    restarts: int = 0
    reopened: int = 0

    def faults_since(self, before: FrameCounts) -> list[str]:
        """Return what went wrong since `before`, in words."""
        words = {
            "lost": self.lost - before.lost,
            "dropped": self.dropped - before.dropped,
            "damaged": self.marked + self.damaged - before.marked - before.damaged,
            "too short": self.short - before.short,
            "without a time": self.unstamped - before.unstamped,
        }
        return [f"{number} {fault}" for fault, number in words.items() if number > 0]


class SequenceCounter:
    """Follows the kernel's sequence numbers; a number left out is a frame lost."""

    def __init__(self) -> None:
        self._last: int | None = None

    def lost_before(self, number: int) -> int:
        """Return how many frames are missing between the last number and this one.

        It is 0 where numbers went back: the driver started again, or does not count.
        """
        last, self._last = self._last, number
        if last is None:
            return 0
        missing = (number - last - 1) % _NUMBERS
        return missing if missing < _NUMBERS // 2 else 0
