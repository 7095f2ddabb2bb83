"""The offset between the clocks of two machines, measured by the messages that they exchange.

Each machine returns to the other one when it has sent and received what: the exchange of NTP in its
symmetric mode (RFC 5905, sections 8 and 10). With t1, t4 on this machine's clock and t2, t3 on the
other's, for a message there (t1, t2) and one back (t3, t4):

    offset = ((t2 - t1) + (t3 - t4)) / 2        round trip = (t4 - t1) - (t3 - t2)

Whatever the two ways take, the true offset is within half of the round trip.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Final

_SAMPLES: Final = 40  # those of ten seconds
_DRIFT: Final = 100e-6  # two clocks of quartz differ by less [s/s]; RFC 5905 has 15e-6 for one
_NS: Final = 1_000_000_000


@dataclass(frozen=True)
class ClockOffset:
    """How far another machine's clock is ahead of this one's [s], and how wrong that may be [s]."""

    offset_s: float
    error_s: float

    def exceeds(self, tolerance_s: float) -> bool:
        """Return whether the clocks certainly differ by more than a tolerance [s]."""
        return abs(self.offset_s) - self.error_s > tolerance_s

    def __str__(self) -> str:
        side = "ahead" if self.offset_s >= 0 else "behind"
        return f"its clock is {abs(self.offset_s):.4g} s {side} (within {self.error_s:.2g} s)"


@dataclass(frozen=True)
class _Sample:
    offset_s: float
    error_s: float
    at_s: float  # monotonic

    def error_at(self, at_s: float) -> float:
        return self.error_s + _DRIFT * (at_s - self.at_s)


class ClockOffsetFilter:
    """Estimates the offset of one other machine's clock from the quickest of the last exchanges."""

    def __init__(self) -> None:
        self._samples: deque[_Sample] = deque(maxlen=_SAMPLES)
        self._best: _Sample | None = None
        self.round_trip_s: float | None = None
        """How long the last exchange took, without the time at the other machine [s]."""

    def add(self, t1_ns: int, t2_ns: int, t3_ns: int, t4_ns: int, at_s: float) -> None:
        """Add an exchange [ns], which ended at the monotonic time `at_s` [s].

        One that contradicts those before shows that a clock was set: they count no more.
        """
        round_trip_ns = (t4_ns - t1_ns) - (t3_ns - t2_ns)
        offset_s = ((t2_ns - t1_ns) + (t3_ns - t4_ns)) / 2 / _NS
        self.round_trip_s = max(0.0, round_trip_ns / _NS)
        if round_trip_ns < 0:  # a clock was set between the two messages
            self._samples.clear()
            self._best = None
            return
        new = _Sample(offset_s, round_trip_ns / 2 / _NS, at_s)
        known = self.estimate(at_s)
        if known is not None and abs(new.offset_s - known.offset_s) > new.error_s + known.error_s:
            self._samples.clear()
        self._samples.append(new)
        self._best = min(self._samples, key=lambda one: one.error_at(at_s))

    def estimate(self, at_s: float) -> ClockOffset | None:
        """Return the offset at the monotonic time `at_s` [s]; None before the first exchange."""
        best = self._best
        return None if best is None else ClockOffset(best.offset_s, best.error_at(at_s))
