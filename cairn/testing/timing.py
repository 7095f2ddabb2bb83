"""Judges stamps and rates of messages, and whether the computer itself paused meanwhile.

Checks raise `AssertionError` with a sentence that names the fault. Times are in
nanoseconds. Medians are judged, so that one message delayed by a busy computer does not fail a
driver.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from itertools import pairwise
from statistics import median
from typing import Any, TypeVar

import pytest

from cairn.clock import to_ns
from cairn.testing.robot import Arrival

_SECOND = 1_000_000_000
_NAP_S = 0.005
_TRIES = 3
_MOST = 0.1
"""Share of the time that the computer may pause while a sample is taken."""

T = TypeVar("T")


def stamps_of(arrivals: Sequence[Arrival[Any]]) -> list[int]:
    """Return the stamps in the messages' headers [ns]."""
    return [to_ns(arrival.message.header.stamp) for arrival in arrivals]


def check_rate(stamps: Sequence[int], rate_hz: float, tolerance: float) -> None:
    """Check that the median period of the stamps is that of the nominal rate, within a share."""
    period_s = median(_spacings_s(stamps))
    assert period_s > 0, f"the stamps do not advance: {stamps[:3]} ..., so the rate is undefined"
    rate = 1.0 / period_s
    assert abs(rate - rate_hz) <= tolerance * rate_hz, (
        f"the rate is {rate:.2f} Hz by the stamps, but nominally {rate_hz:g} Hz "
        f"(tolerance {tolerance:.0%})"
    )


def check_increasing(stamps: Sequence[int]) -> None:
    """Check that each stamp is later than the one before."""
    for number, (before, after) in enumerate(pairwise(stamps), start=1):
        assert after > before, (
            f"the stamp of message {number} is {(before - after) / _SECOND:g} s before that of "
            f"the one before ({after} after {before} ns): stamps must increase"
        )


def check_regular(stamps: Sequence[int], jitter: float) -> None:
    """Check that three of four periods are, within a share, whole multiples of the median."""
    spacings = _spacings_s(stamps)
    period = median(spacings)
    off = [s for s in spacings if abs(s - max(1, round(s / period)) * period) > jitter * period]
    assert len(off) <= len(spacings) / 4, (
        f"{len(off)} of {len(spacings)} spacings of stamps are off the median of "
        f"{period * 1e3:.1f} ms by more than {jitter:.0%}, such as {off[0] * 1e3:.1f} ms: stamps "
        "must be the time of measurement, not of reading or sending"
    )


def check_present(
    arrivals: Sequence[Arrival[Any]], soonest_s: float, oldest_s: float, early_s: float
) -> None:
    """Check that the median age of a message at arrival is between `soonest_s` and `oldest_s`.

    No stamp may be more than `early_s` in the future.
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
        f"messages are {age:.3f} s old at arrival (at most {oldest_s:g} s is allowed): stamps "
        "are of another clock, or messages are delayed"
    )
    assert age >= soonest_s - early_s, (
        f"messages are {age * 1e3:.1f} ms old at arrival, but measuring takes "
        f"{soonest_s * 1e3:.1f} ms: a stamp must be of the measurement's beginning, not of its end"
    )


def _spacings_s(stamps: Sequence[int]) -> list[float]:
    assert len(stamps) >= 2, "there are no two messages to compare"
    return [(after - before) / _SECOND for before, after in pairwise(stamps)]


class Pauses:
    """Measures pauses of the computer: a thread sleeps briefly, and adds up how late it wakes.

    A context manager; at its end it has the sum `lost_s` [s], the `longest_s` [s] pause, and the
    `share` [1] of the time of the context.
    """

    def __enter__(self) -> Pauses:
        """Start."""
        self.lost_s = self.longest_s = 0.0
        self._over = threading.Event()
        self._began = time.monotonic()
        self._thread = threading.Thread(target=self._nap, name="pauses", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop."""
        self._over.set()
        self._thread.join()
        self.share = self.lost_s / (time.monotonic() - self._began)

    def _nap(self) -> None:
        while True:
            due = time.monotonic() + _NAP_S
            is_over = self._over.wait(_NAP_S)
            late_s = time.monotonic() - due
            if late_s > _NAP_S:
                self.lost_s += late_s
                self.longest_s = max(self.longest_s, late_s)
            if is_over:
                return


def undisturbed(take: Callable[[], T]) -> T:
    """Return a sample taken while the computer did not pause.

    Other samples prove nothing about a driver. A sample is taken again, three times in all, if the
    computer paused for a tenth of its time; if it pauses each time, the test is skipped, with the
    reason.
    """
    for _ in range(_TRIES):
        with Pauses() as pauses:
            taken = take()
        if pauses.share <= _MOST:
            return taken
    pytest.skip(
        f"this computer is too busy for tests in real time: it paused for "
        f"{pauses.longest_s:.2f} s at once, {pauses.share:.0%} of the time, in each of {_TRIES} "
        "samples; run the test on an idle one"
    )
