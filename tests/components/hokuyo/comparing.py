"""What a driver published against what an emulated sensor had sent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from cairn.components.hokuyo.emulated_record import SentScan

_LIMITS = {"URG": (20, 5600), "UTM": (23, 60000), "UST": (20, 30000)}
_SHORT_MOST = 4094
_CODES = {1: math.inf, 2: -math.inf}  # of UTM and UST: nothing hit, too near


def assert_were_sent(
    scans: Sequence[Any],
    sent: Sequence[SentScan],
    model: str,
    *,
    echo: str = "first",
    short: bool = False,
) -> list[SentScan]:
    """Every scan is, value by value, one that was sent, in this order; those that it was.

    A computer that is too busy may leave some out.
    """
    left = iter(sent)
    found = []
    for number, scan in enumerate(scans):
        for one in left:
            if _equal(scan, one, model, echo, short=short):
                found.append(one)
                break
        else:
            raise AssertionError(f"scan {number} was not sent, or not in this order")
    return found


def _equal(scan: Any, sent: SentScan, model: str, echo: str, *, short: bool) -> bool:
    rows = np.arange(len(sent.distances))
    column = np.zeros(len(rows), np.intp)
    if echo == "strongest" and sent.intensities is not None:
        column = np.argmax(sent.intensities, axis=1)
    wanted = ranges(sent.distances[rows, column], model, short=short)
    if len(wanted) != scan.ranges.size or not np.allclose(
        scan.ranges, wanted, rtol=0, atol=1e-5, equal_nan=True
    ):
        return False
    if sent.intensities is None:
        return bool(scan.intensities.size == 0)
    return np.array_equal(scan.intensities, sent.intensities[rows, column])


def ranges(values: Any, model: str, *, short: bool = False) -> list[float]:
    """Ranges [m] of REP 117 for values as they were sent [mm or code]."""
    least, most = _LIMITS[model[:3]]
    most = min(most, _SHORT_MOST) if short else most
    codes = {} if model.startswith("URG") else _CODES
    found = []
    for value in values.tolist():
        if value > most:
            found.append(math.inf)
        elif value < least:
            found.append(codes.get(value, math.nan))
        else:
            found.append(value / 1000)
    return found
