"""Checks stamps and rates of messages, and detects pauses of the computer during a sample.

A failed check raises `AssertionError`, which describes the fault. Stamps are in nanoseconds. The
checks use medians, so that one message that a busy computer delays does not fail a driver.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import pairwise
from statistics import median
from typing import Any, TypeVar

import pytest

from cairn.schemas.builtin_interfaces import to_ns
from cairn.system.clock import SECOND
from cairn.testing.robot import Arrival, Reading

_NAP_S = 0.005
_TRIES = 3
BUSY_SHARE, _LONGEST_PAUSE_S = 0.1, 0.2
"""A computer that pauses for a larger share of the time, or for longer at once [s], is too busy for
tests in real time."""
IN_TRANSIT_S = 0.2
"""Messages in transit arrive within this time of each other, unless the computer pauses [s]."""
_TRANSIT_LIMIT_S = 2.0

T = TypeVar("T")


def stamps_of(arrivals: Sequence[Arrival[Any]]) -> list[int]:
    """Return the stamps in the messages' headers [ns]."""
    return [to_ns(arrival.message.header.stamp) for arrival in arrivals]


def check_rate(stamps: Sequence[int], rate_hz: float, tolerance: float) -> None:
    """Check that the median interval of the stamps fits the rate, within a relative tolerance."""
    period_s = median(_spacings_s(stamps))
    assert period_s > 0, f"the stamps do not advance: {stamps[:3]} ..., so the rate is undefined"
    rate = 1.0 / period_s
    assert abs(rate - rate_hz) <= tolerance * rate_hz, (
        f"by the stamps the rate is {rate:.2f} Hz, but the nominal rate is {rate_hz:g} Hz "
        f"(tolerance {tolerance:.0%})"
    )


def check_increasing(stamps: Sequence[int]) -> None:
    """Check that each stamp is later than the one before."""
    for number, (before, after) in enumerate(pairwise(stamps), start=1):
        assert after > before, (
            f"the stamp of message {number} is {(before - after) / SECOND:g} s before that of the "
            f"previous one ({after} after {before} ns): stamps must increase"
        )


def check_regular(stamps: Sequence[int], jitter: float) -> None:
    """Check that three of four intervals are multiples of the median, within `jitter` of it."""
    spacings = _spacings_s(stamps)
    period = median(spacings)
    off = [s for s in spacings if abs(s - max(1, round(s / period)) * period) > jitter * period]
    assert len(off) <= len(spacings) / 4, (
        f"{len(off)} of {len(spacings)} intervals between stamps differ from the median of "
        f"{period * 1e3:.1f} ms by more than {jitter:.0%}, such as {off[0] * 1e3:.1f} ms: a stamp "
        "must be the time of measurement, not of reading or sending"
    )


def check_present(
    arrivals: Sequence[Arrival[Any]], soonest_s: float, oldest_s: float, early_s: float
) -> None:
    """Check that the median age of messages on arrival is between `soonest_s` and `oldest_s` [s].

    No stamp may be more than `early_s` [s] in the future.
    """
    ages = [
        (arrival.clock_ns - stamp) / SECOND
        for arrival, stamp in zip(arrivals, stamps_of(arrivals), strict=True)
    ]
    assert min(ages) >= -early_s, (
        f"a message is stamped {-min(ages):.3f} s in the future (at most {early_s:g} s is allowed)"
    )
    age = median(ages)
    assert age <= oldest_s, (
        f"messages are {age:.3f} s old on arrival (at most {oldest_s:g} s is allowed): stamps "
        "are of another clock, or messages are delayed"
    )
    assert age >= soonest_s - early_s, (
        f"messages are {age * 1e3:.1f} ms old on arrival, but the measurement takes "
        f"{soonest_s * 1e3:.1f} ms: a stamp must be of the measurement's beginning, not of its end"
    )


def _spacings_s(stamps: Sequence[int]) -> list[float]:
    assert len(stamps) >= 2, "there are no two messages to compare"
    return [(after - before) / SECOND for before, after in pairwise(stamps)]


class Pauses:
    """Measures pauses of the computer: a thread sleeps briefly and adds up how late it wakes.

    A context manager. At its end it has the sum of the pauses `lost_s` [s], the longest one
    `longest_s` [s], and their `share` of the context's time, 0 to 1.
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
    """Return a sample that `take` took while the computer did not pause.

    Other samples prove nothing about a driver. If the computer paused for more than a tenth of the
    sample's time, or for 0.2 s at once, the sample is repeated, up to three times in all; then the
    test is skipped.
    """
    for _ in range(_TRIES):
        with Pauses() as pauses:
            taken = take()
        if pauses.share <= BUSY_SHARE and pauses.longest_s <= _LONGEST_PAUSE_S:
            return taken
    pytest.skip(_too_busy(pauses, f"each of {_TRIES} samples, in the last one"))


def in_time(check: Callable[[], bool]) -> bool:
    """Return whether `check` holds, which waits for an event up to its own limit.

    If it does not hold, and the computer paused for more than a tenth of the time, the test is
    skipped: then the limit proves nothing about a driver.
    """
    with Pauses() as pauses:
        holds = check()
    if not holds and pauses.share > BUSY_SHARE:
        pytest.skip(_too_busy(pauses, "the wait for an event"))
    return holds


def falls_silent(reading: Reading[Any], seconds: float) -> bool:
    """Return whether no message arrives for `seconds` [s], after those that are in transit.

    A busy computer may delay a message: the wait is repeated, up to three times in all.
    """
    for _ in range(_TRIES):
        with suppress(AssertionError):
            reading.await_silence(IN_TRANSIT_S, _TRANSIT_LIMIT_S)
        if reading.stays_silent(seconds):
            return True
    return False


def _too_busy(pauses: Pauses, when: str) -> str:
    return (
        f"this computer is too busy for tests in real time: it paused during {when} for "
        f"{pauses.share:.0%} of the time, at most {pauses.longest_s:.2f} s at once; run the test "
        "on an idle computer"
    )
