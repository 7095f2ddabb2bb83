"""Times of a log's records: which are wrong, how good the others are, and their repair."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND
from cairn.planar.poses import wrap_all

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
Indices = NDArray[np.intp]

# How far records may be out of order: messages of several processes take different ways [ns].
_DISORDER_NS = SECOND
# Records that are so far from all others [ns] belong to another run, or their time is wrong.
_LONGEST_GAP_NS = 3600 * SECOND
# Records closer than this share of the usual interval, and than this time [ns], came in a burst: a
# sensor cannot measure so fast, so they waited somewhere. The Intel lab's bursts are 20 ms long.
_BURST_SHARE, _BURST_NS = 0.25, SECOND // 20
_PERIODS = 20  # intervals in a row, of which the mean hardly depends on bursts
# The logger's clock is compared with the senders' over so many records: both drift slowly.
_CLOCK_WINDOW = 101
_GAP_NS, _GAP_PERIODS = SECOND, 5  # an interval above both is reported as a gap


NO_TIME = -(2**62)
"""The time [ns] of a record without one."""

# Where a log has no times, a robot that drives and turns so fast [m/s, rad/s] sets them; but no
# scan follows the one before sooner than after this time [s].
_DRIVE_M_S, _TURN_RAD_S, _SCAN_S = 0.5, 0.5, 0.1
_LONGEST_STEP_S = 60.0  # a robot that is so far from the pose before was carried


@dataclass(frozen=True)
class TimeQuality:
    """How good the times of a stream's records are, and what was done about it.

    `period_s` is the usual interval [s], `jitter_s` the standard deviation of the intervals [s]
    without their outliers. `gaps` are intervals of more than 1 s and 5 periods. `disordered` are
    records older than one before them, by up to `disorder_s` [s]; `bursts` those that came together
    with the one before. `duplicates` and `contradicting` ones were left out. The times of `retimed`
    were changed, by up to `shift_s` [s].
    """

    records: int
    period_s: float | None
    jitter_s: float | None
    gaps: int
    longest_gap_s: float
    disordered: int
    disorder_s: float
    bursts: int
    duplicates: int = 0
    contradicting: int = 0
    retimed: int = 0
    shift_s: float = 0.0


def time_quality(stamps: Sequence[int] | Stamps) -> TimeQuality:
    """Return the quality of times [ns] in the order of the file."""
    times = np.asarray(stamps, dtype=np.int64)
    late = np.maximum.accumulate(times) - times if times.size else times
    intervals = _intervals(np.sort(times))
    period = _period(intervals)
    spread = float(np.median(np.abs(intervals - np.median(intervals)))) if intervals.size else 0.0
    gaps = intervals[intervals > max(_GAP_NS, _GAP_PERIODS * period)]
    return TimeQuality(
        records=int(times.size),
        period_s=period / SECOND if intervals.size else None,
        jitter_s=1.4826 * spread / SECOND if intervals.size else None,
        gaps=int(gaps.size),
        longest_gap_s=float(intervals.max()) / SECOND if intervals.size else 0.0,
        disordered=int(np.count_nonzero(late)),
        disorder_s=float(late.max()) / SECOND if times.size else 0.0,
        bursts=int(np.count_nonzero(intervals < _burst_limit(intervals))),
    )


@dataclass(frozen=True)
class WrongTime:
    """A record, by its index, whose time is wrong, and why."""

    index: int
    fault: str


def wrong_times(stamps: Sequence[int]) -> list[WrongTime]:
    """Return the records, given by their times [ns] in the order of the file, with wrong times.

    The largest set of records in order is right, apart from those more than an hour from the most.
    Others are wrong if they are more than a second out of order.
    """
    chain = _ordered_chain(stamps)
    wrong: dict[int, str] = {}
    place = 0
    for index, stamp in enumerate(stamps):
        while place < len(chain) and chain[place] < index:
            place += 1
        if stamp == NO_TIME:
            wrong[index] = "it has no time that can be used"
        elif stamp < 0:
            wrong[index] = f"time is {stamp / SECOND:.3f} s"
        elif place < len(chain) and chain[place] == index:
            continue
        elif place and stamp < stamps[chain[place - 1]] - _DISORDER_NS:
            before = stamps[chain[place - 1]] / SECOND
            wrong[index] = f"time runs backwards, from {before:.3f} s to {stamp / SECOND:.3f} s"
        elif place < len(chain) and stamp > stamps[chain[place]] + _DISORDER_NS:
            after = stamps[chain[place]] / SECOND
            wrong[index] = f"time is {stamp / SECOND:.3f} s, ahead of {after:.3f} s after it"
    wrong |= times_apart({k: stamp for k, stamp in enumerate(stamps) if k not in wrong})
    return [WrongTime(index, wrong[index]) for index in sorted(wrong)]


def times_apart(stamps: Mapping[int, int]) -> dict[int, str]:
    """Return what is wrong with times [ns] that are more than an hour from the most, by key."""
    groups: list[list[tuple[int, int]]] = []
    for entry in sorted((stamp, k) for k, stamp in stamps.items()):
        if not groups or entry[0] - groups[-1][-1][0] > _LONGEST_GAP_NS:
            groups.append([])
        groups[-1].append(entry)
    largest = max(groups, key=len, default=[])
    apart: dict[int, str] = {}
    for group in groups:
        if group is not largest:
            ends = (group[0][0] - largest[-1][0], largest[0][0] - group[-1][0])
            for stamp, k in group:
                far_s = max(ends) / SECOND
                apart[k] = f"time is {stamp / SECOND:.3f} s, {far_s:.0f} s from the others"
    return apart


def times_by_order(lines: Sequence[int], known: Sequence[tuple[int, int]]) -> list[int]:
    """Return times [ns] of records at `lines` of a file, between those `known` of other lines."""
    at, times = np.array(known, np.int64).T
    since = np.interp(lines, at, (times - times[0]).astype(np.float64))
    return [int(times[0]) + round(one) for one in since.tolist()]


def times_along_path(poses: Array) -> list[int]:
    """Return the times [ns] at which a robot at a usual speed has the poses (n, 3) [m, m, rad]."""
    steps = np.diff(poses, axis=0)
    driven = np.hypot(steps[:, 0], steps[:, 1]) / _DRIVE_M_S
    turned = np.abs(wrap_all(steps[:, 2])) / _TURN_RAD_S
    seconds = np.clip(np.maximum(driven, turned), _SCAN_S, _LONGEST_STEP_S)
    return [0, *np.round(np.cumsum(seconds) * SECOND).astype(np.int64).tolist()]


def _ordered_chain(stamps: Sequence[int]) -> list[int]:
    """Return the indices of the longest subsequence in order (patience sorting)."""
    ends: list[int] = []  # the least last time of a chain of each length
    last: list[int] = []  # the index of that time
    before: list[int] = []
    for index, stamp in enumerate(stamps):
        length = bisect_right(ends, stamp) if stamp >= 0 else 0
        before.append(last[length - 1] if length else -1)
        if stamp < 0:
            continue
        if length == len(ends):
            ends.append(stamp)
            last.append(index)
        else:
            ends[length], last[length] = stamp, index
    chain: list[int] = []
    index = last[-1] if last else -1
    while index >= 0:
        chain.append(index)
        index = before[index]
    return chain[::-1]


@dataclass(frozen=True)
class RepairedTimes:
    """Records in temporal order: their indices (n,) in the file, and times (n,) [ns] ascending."""

    order: Indices
    stamps: Stamps


def repair_times(recorded: Sequence[int], logger_s: Array, poses: Array | None) -> RepairedTimes:
    """Order records and repair their times.

    `recorded` are the times [ns] in the order of the file, `logger_s` those at which the logger
    wrote the records [s, NaN if unknown], `poses` (n, 3) [m, m, rad] what the records measured.

    Records that are out of order are sorted by time, unless the poses move less in the order of the
    file: then their times are fitted to that order. Where the logger's clock runs more evenly than
    the senders', the fit is the logger's time plus a running median of the difference; else it is
    the nearest ascending series (isotonic regression). Bursts are spread over the time before them.
    """
    times = np.array(recorded, dtype=np.int64)
    order: Indices = np.arange(times.size)
    if times.size < 2:
        return RepairedTimes(order, times)
    sorted_order = np.argsort(times, kind="stable")
    if np.any(np.diff(times) < 0) and not _moves_less_in_file(poses, sorted_order):
        order = sorted_order
    times = times[order]
    if _faults(times):
        fitted = _by_logger(times, np.asarray(logger_s, np.float64)[order])
        if fitted is None:
            fitted = _ascending(times) if np.any(np.diff(times) < 0) else times
        times = _spread_bursts(fitted)
    return RepairedTimes(order, times)


def with_repair(quality: TimeQuality, recorded: Stamps, repaired: RepairedTimes) -> TimeQuality:
    """Return the quality of `recorded` times, with the changes by their repair."""
    shifts = np.abs(repaired.stamps - recorded[repaired.order])
    return replace(
        quality,
        retimed=int(np.count_nonzero(shifts)),
        shift_s=float(shifts.max()) / SECOND if shifts.size else 0.0,
    )


def _moves_less_in_file(poses: Array | None, by_time: Indices) -> bool:
    return poses is not None and _path_length(poses) < 0.95 * _path_length(poses[by_time])


def _path_length(poses: Array) -> float:
    """Return the sum of the steps [m], a radian of turning counted as half a meter."""
    steps = np.diff(poses, axis=0)
    turns = np.abs(wrap_all(steps[:, 2]))
    return float(np.hypot(steps[:, 0], steps[:, 1]).sum() + 0.5 * turns.sum())


def _intervals(times: Stamps) -> Stamps:
    intervals: Stamps = times[1:] - times[:-1]
    return intervals


def _period(intervals: Stamps) -> float:
    """Return the usual interval [ns], 0 without any.

    It is the median over several in a row: with many bursts, most single ones are too short.
    """
    if not intervals.size:
        return 0.0
    count = min(_PERIODS, intervals.size)
    sums = np.convolve(intervals.astype(np.float64), np.ones(count), mode="valid")
    return float(np.median(sums)) / count


def _burst_limit(intervals: Stamps) -> float:
    return min(_BURST_SHARE * _period(intervals), float(_BURST_NS))


def _faults(times: Stamps) -> int:
    """Return how many intervals are negative or as short as in a burst."""
    intervals = _intervals(times)
    limit = max(1.0, _burst_limit(_intervals(np.sort(times))))
    return int(np.count_nonzero(intervals < limit))


def _by_logger(times: Stamps, logger_s: Array) -> Stamps | None:
    """Return the times [ns] by the logger's clock; None if that clock is not better."""
    if not np.isfinite(logger_s).all() or np.any(np.diff(logger_s) < 0):
        return None
    logger = np.round((logger_s - logger_s[0]) * SECOND).astype(np.int64)
    span = int(times.max() - times.min())
    if abs(int(logger[-1]) - span) > 0.05 * span + _DISORDER_NS:
        return None
    if 2 * _faults(logger) >= _faults(times):
        return None
    apart = (times - logger).astype(np.float64)
    half = (min(_CLOCK_WINDOW, times.size) - 1) // 2
    padded = np.pad(apart, half, mode="reflect")
    medians = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)
    fitted: Stamps = np.maximum.accumulate(logger + np.round(medians).astype(np.int64))
    return fitted


def _ascending(times: Stamps) -> Stamps:
    """Return the nearest ascending times [ns], in the sense of least squares."""
    from scipy.optimize import isotonic_regression  # takes 0.3 s: only for a log out of order

    origin = int(times[0])
    fit = isotonic_regression((times - origin).astype(np.float64)).x
    fitted: Stamps = origin + np.round(fit).astype(np.int64)
    return fitted


def _spread_bursts(times: Stamps) -> Stamps:
    """Return strictly ascending times [ns]: those of a burst spread before its last record.

    The last record of a burst waited least. Those before it were measured one period apart, or
    evenly since the record before the burst if that is not long enough ago.
    """
    intervals = _intervals(times)
    limit = max(1.0, _burst_limit(intervals))
    period = _period(intervals)
    spread = times.copy()
    begin = 0
    for end in range(1, times.size + 1):
        if end < times.size and intervals[end - 1] < limit:
            continue
        count = end - begin  # records begin..end - 1 came together
        if count > 1:
            since = times[begin - 1] if begin else 0  # no time is negative
            step = min(period, float(times[end - 1] - since) / count)
            back = np.arange(count - 1, -1, -1) * step
            spread[begin:end] = times[end - 1] - np.round(back).astype(np.int64)
        begin = end
    return spread


def quality_text(quality: TimeQuality) -> str:
    """Return the quality of a stream's times in words."""
    words = [f"{quality.records} records"]
    if quality.period_s is not None and quality.jitter_s is not None:
        words.append(f"every {quality.period_s:.3f} s, jitter {quality.jitter_s:.3f} s")
    if quality.gaps:
        words.append(f"{quality.gaps} gaps, the longest {quality.longest_gap_s:.1f} s")
    if quality.bursts:
        words.append(f"{quality.bursts} in bursts")
    if quality.disordered:
        words.append(f"{quality.disordered} out of order by up to {quality.disorder_s:.3f} s")
    if quality.duplicates:
        words.append(f"{quality.duplicates} duplicates left out")
    if quality.contradicting:
        words.append(f"{quality.contradicting} left out, which contradict the scans' own odometry")
    if quality.retimed:
        words.append(f"{quality.retimed} times corrected by up to {quality.shift_s:.3f} s")
    return "; ".join(words)
