"""What became of a camera's pictures, and what that says of how the camera is."""

from __future__ import annotations

from dataclasses import dataclass

from cairn.driver.diagnostics import ERROR, OK, WARN

_SLOW = 0.9
"""A rate of less than this share of the one agreed on is told."""

_OFTEN = 2.0
"""Cameras of fewer pictures a second may have none between two reports, which come every second."""


@dataclass
class Counts:
    """Counts since the camera was configured. One thread counts, others only look.

    `pictures` were handed on; `lost` are missing in the kernel's numbers; `skipped` gave way to a
    newer one that had come as well; `marked` were damaged as the driver said, `short` had too few
    bytes, `damaged` could not be decoded; `unstamped` have the time of their arrival as the driver
    told none that can be true. `restarts` of the stream and `returns` of the camera mended it.
    """

    pictures: int = 0
    lost: int = 0
    skipped: int = 0
    marked: int = 0
    short: int = 0
    damaged: int = 0
    unstamped: int = 0
    restarts: int = 0
    returns: int = 0

    def spoiled_since(self, before: Counts) -> list[str]:
        """What went wrong since `before`, in words."""
        words = {
            "lost": self.lost - before.lost,
            "skipped": self.skipped - before.skipped,
            "damaged": self.marked + self.damaged - before.marked - before.damaged,
            "too short": self.short - before.short,
            "without a time": self.unstamped - before.unstamped,
        }
        return [f"{number} {what}" for what, number in words.items() if number > 0]


def health(
    counts: Counts, before: Counts, rate: float, nominal: float, trouble: str
) -> tuple[int, str]:
    """Level of a `DiagnosticStatus` and its message.

    `before` are the counts when it was last told, `rate` that of the pictures handed on and
    `nominal` the one that the camera agreed to [1/s], 0 if it does not tell. `trouble` says why it
    does not stream; empty if it does.
    """
    if trouble:
        return ERROR, trouble
    spoiled = counts.spoiled_since(before)
    of_which = f" ({', '.join(spoiled)})" if spoiled else ""
    is_slow = rate > 0.0 and 0.0 < nominal < _OFTEN  # none need have come since
    if counts.pictures == before.pictures and not is_slow:
        return ERROR, f"no picture comes{of_which}"
    if rate < _SLOW * nominal:
        return WARN, f"{rate:.3g} pictures a second instead of {nominal:.3g}{of_which}"
    if spoiled:
        return WARN, f"pictures {', '.join(spoiled)}"
    return OK, f"{rate:.3g} pictures a second"
