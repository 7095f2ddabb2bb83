"""Whether a quantity of a process grows, apart from its warm-up and from noise."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

_WINDOWS = 6

Samples = Sequence[tuple[float, float]]
"""Pairs of time [s] and value."""


def growth(samples: Samples, since_s: float) -> tuple[float, float] | None:
    """Return the medians of the first and the last sixth of the samples after `since_s` [s].

    Medians, so that the noise of a garbage collector does not count. None if there are fewer than
    six samples.
    """
    values = [value for at_s, value in samples if at_s >= since_s]
    size = len(values) // _WINDOWS
    if size == 0:
        return None
    return statistics.median(values[:size]), statistics.median(values[-size:])


def growth_percent(samples: Samples, since_s: float) -> float:
    """Return the growth [%] from the first to the last sixth of the samples after `since_s` [s].

    0 if there are too few samples.
    """
    found = growth(samples, since_s)
    if found is None or not found[0]:
        return 0.0
    first, last = found
    return 100.0 * (last - first) / first
