"""Whether a quantity of a process grows, apart from its warm-up and from passing use."""

from __future__ import annotations

from collections.abc import Sequence

import psutil

_WINDOWS = 6
_SHORTEST_WINDOW_S = 60.0  # a process returns the memory that it has freed once a minute

Samples = Sequence[tuple[float, float]]
"""Pairs of time [s] and value."""


def own_memory_mib(process: psutil.Process) -> float:
    """Return the memory of a process that no file backs [MiB]; raises `psutil.Error`.

    Without the code of libraries: all processes share it, the system takes it back at will, and it
    counts for a process only from its first use on, hours after the start perhaps.
    """
    memory = process.memory_info()
    return float(memory.rss - memory.shared) / 2**20


def growth(samples: Samples, since_s: float) -> tuple[float, float] | None:
    """Return the least values in the first and in the last sixth of the time after `since_s` [s].

    The least, so that what a process uses for a while, for a search perhaps, does not count: what
    leaks is never returned. Each part lasts at least a minute. None if the samples are of less than
    two minutes.
    """
    kept = [sample for sample in samples if sample[0] >= since_s]
    if not kept:
        return None
    begin_s, end_s = kept[0][0], kept[-1][0]
    window_s = max((end_s - begin_s) / _WINDOWS, _SHORTEST_WINDOW_S)
    if end_s - begin_s < 2 * window_s:
        return None
    first = min(value for at_s, value in kept if at_s <= begin_s + window_s)
    last = min(value for at_s, value in kept if at_s >= end_s - window_s)
    return first, last


def growth_percent(samples: Samples, since_s: float) -> float:
    """Return the growth [%] from the first to the last sixth of the time after `since_s` [s].

    0 if the samples are of less than two minutes.
    """
    found = growth(samples, since_s)
    if found is None or not found[0]:
        return 0.0
    first, last = found
    return 100.0 * (last - first) / first
