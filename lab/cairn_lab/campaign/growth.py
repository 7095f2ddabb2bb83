"""Whether a quantity of a process grows, apart from its warm-up and from passing use."""

from __future__ import annotations

from collections.abc import Sequence

import psutil

_PART_S = 120.0  # a process returns the memory that it has freed once a minute

Samples = Sequence[tuple[float, float]]
"""Pairs of time [s] and value."""


def anonymous_memory_mib(process: psutil.Process) -> float:
    """Return the anonymous memory of a process [MiB]; raises `psutil.Error`.

    Without the code of libraries: all processes share it, the system takes it back at will, and it
    counts for a process only from its first use on, hours after the start perhaps.
    """
    memory = process.memory_info()
    return float(memory.rss - memory.shared) / 2**20


def growth(samples: Samples, since_s: float) -> tuple[float, float] | None:
    """Return the least values in the first and in the last two minutes after `since_s` [s].

    The least, so that what a process uses for a while, for a search perhaps, does not count: what
    leaks is never returned. None if the samples are of less than four minutes.
    """
    kept = [sample for sample in samples if sample[0] >= since_s]
    if not kept or kept[-1][0] - kept[0][0] < 2 * _PART_S:
        return None
    begin_s, end_s = kept[0][0], kept[-1][0]
    first = min(value for at_s, value in kept if at_s <= begin_s + _PART_S)
    last = min(value for at_s, value in kept if at_s >= end_s - _PART_S)
    return first, last


def growth_percent(samples: Samples, since_s: float) -> float:
    """Return the growth [%] from the first to the last two minutes after `since_s` [s].

    0 if the samples are of less than four minutes.
    """
    found = growth(samples, since_s)
    if found is None or not found[0]:
        return 0.0
    first, last = found
    return 100.0 * (last - first) / first
