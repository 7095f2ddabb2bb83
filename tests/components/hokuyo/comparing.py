"""What a driver published against what an emulated sensor had sent."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from components.hokuyo.emulated_record import SentScan

_LIMITS = {"URG": (20, 5600), "UTM": (23, 60000), "UST": (20, 30000)}
_SHORT_MOST = 4094
_CODES = {1: math.inf, 2: -math.inf}  # of UTM and UST: nothing hit, too near


def assert_equal(
    scan: Any, sent: SentScan, model: str, *, echo: str = "first", short: bool = False
) -> None:
    """Every range, and every intensity, is the value that was sent."""
    rows = np.arange(len(sent.distances))
    column = np.zeros(len(rows), np.intp)
    if echo == "strongest" and sent.intensities is not None:
        column = np.argmax(sent.intensities, axis=1)
    assert scan.ranges.tolist() == pytest.approx(
        ranges(sent.distances[rows, column], model, short=short), abs=1e-6, nan_ok=True
    )
    if sent.intensities is None:
        assert scan.intensities.size == 0
    else:
        assert scan.intensities.tolist() == sent.intensities[rows, column].tolist()


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
