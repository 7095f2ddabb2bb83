"""Judges when messages were measured, by their stamps, and when they came.

All raise `AssertionError` with a sentence that names the fault. Times are in nanoseconds. Medians
are judged, so that one message that was held up by a busy machine does not fail a driver.
"""

from collections.abc import Sequence
from itertools import pairwise
from statistics import median
from typing import Any

from cairn.clock import to_ns
from cairn.testing.reading import Arrival

_SECOND = 1_000_000_000


def stamps_of(arrivals: Sequence[Arrival[Any]]) -> list[int]:
    """The stamps in the messages' headers [ns]."""
    return [to_ns(arrival.message.header.stamp) for arrival in arrivals]


def check_rate(stamps: Sequence[int], rate_hz: float, tolerance: float) -> None:
    """The median time between stamps is that of the nominal rate, within a share of it."""
    period_s = median(_spacings_s(stamps))
    assert period_s > 0, f"the stamps do not advance: {stamps[:3]} ..., so there is no rate"
    rate = 1.0 / period_s
    assert abs(rate - rate_hz) <= tolerance * rate_hz, (
        f"the rate is {rate:.2f} Hz by the stamps, but nominally {rate_hz:g} Hz "
        f"(tolerance {tolerance:.0%})"
    )


def check_increasing(stamps: Sequence[int]) -> None:
    """Each stamp is later than the one before."""
    for number, (before, after) in enumerate(pairwise(stamps), start=1):
        assert after > before, (
            f"the stamp of message {number} is {(before - after) / _SECOND:g} s before that of "
            f"the one before ({after} after {before} ns): stamps must increase"
        )


def check_regular(stamps: Sequence[int], jitter: float) -> None:
    """Three of four spacings are, within a share, whole multiples of the median."""
    spacings = _spacings_s(stamps)
    period = median(spacings)
    off = [s for s in spacings if abs(s - max(1, round(s / period)) * period) > jitter * period]
    assert len(off) <= len(spacings) / 4, (
        f"{len(off)} of {len(spacings)} spacings of stamps are off the median of "
        f"{period * 1e3:.1f} ms by more than {jitter:.0%}, such as {off[0] * 1e3:.1f} ms: stamps "
        "must tell when was measured, not when something was read or sent"
    )


def check_present(
    arrivals: Sequence[Arrival[Any]], soonest_s: float, oldest_s: float, early_s: float
) -> None:
    """The median age of a message on its arrival is between `soonest_s` and `oldest_s`.

    None is from more than `early_s` in the future.
    """
    ages = [
        (arrival.clock_ns - stamp) / _SECOND
        for arrival, stamp in zip(arrivals, stamps_of(arrivals), strict=True)
    ]
    assert min(ages) >= -early_s, (
        f"a message is stamped {-min(ages):.3f} s in the future (at most {early_s:g} s is allowed)"
    )
    age = median(ages)
    assert age <= oldest_s, (
        f"messages are {age:.3f} s old when they come (at most {oldest_s:g} s is allowed): stamps "
        "are of another clock, or messages wait somewhere"
    )
    assert age >= soonest_s - early_s, (
        f"messages are {age * 1e3:.1f} ms old when they come, but measuring takes "
        f"{soonest_s * 1e3:.1f} ms: a stamp must be of the measurement's beginning, not of its end"
    )


def _spacings_s(stamps: Sequence[int]) -> list[float]:
    assert len(stamps) >= 2, "there are no two messages to compare"
    return [(after - before) / _SECOND for before, after in pairwise(stamps)]
