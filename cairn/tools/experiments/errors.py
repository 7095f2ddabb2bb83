"""How far the pose that a pair tells is off, and how sure it is, over time."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import wrap_all
from cairn.tools.experiments.series import PairSeries, WorldSeries

Array = NDArray[np.float64]

STEP_S = 0.5
# So far off [m] a robot is lost.
LOST_M = 1.0
# So near the truth [m], [rad] a robot that was carried off has found itself.
FOUND_M, FOUND_RAD = 0.5, 0.5


@dataclass(frozen=True)
class Course:
    """Means of what was told within each step of `STEP_S`, NaN where nothing was told.

    `stamps` (n,) are the middles of the steps [s]; all others (n,) in m or rad: errors, the
    deviations that the pose states, and those of the samples.
    """

    stamps: Array
    position_error: Array
    heading_error: Array
    position_sd: Array
    heading_sd: Array
    position_spread: Array
    heading_spread: Array

    def between(self, begin: float, end: float) -> Course:
        """That part of it which lies within [begin, end) s."""
        inside = (self.stamps >= begin) & (self.stamps < end)
        return Course(*(getattr(self, field.name)[inside] for field in fields(self)))

    @property
    def lost_share(self) -> float:
        """Share of the steps in which the robot was lost or told no pose; NaN without steps."""
        if self.stamps.size == 0:
            return float("nan")
        return float(np.mean(~(self.position_error <= LOST_M)))


def course_of(pair: PairSeries, world: WorldSeries, end_s: float) -> Course:
    """The course of a pair's errors and deviations from 0 to `end_s`."""
    count = max(1, round(end_s / STEP_S))
    off = np.abs(_offsets(pair, world))
    xx, _, yy, turn = np.maximum(pair.variances, 0.0).T
    told, clouds = pair.stamps, pair.clouds
    return Course(
        np.asarray((np.arange(count) + 0.5) * STEP_S, np.float64),
        np.sqrt(_by_step(told, off[:, 0] ** 2 + off[:, 1] ** 2, count)),
        np.sqrt(_by_step(told, off[:, 2] ** 2, count)),
        _by_step(told, np.sqrt(xx + yy), count),
        _by_step(told, np.sqrt(turn), count),
        _by_step(clouds[:, 0], np.sqrt(clouds[:, 1] + clouds[:, 2]), count),
        _by_step(clouds[:, 0], np.sqrt(clouds[:, 3]), count),
    )


def found_after(pair: PairSeries, world: WorldSeries, carried_s: float) -> float | None:
    """How long [s] after it was carried off the robot told a pose near the truth; None: never."""
    off = np.abs(_offsets(pair, world))
    near = (np.hypot(off[:, 0], off[:, 1]) <= FOUND_M) & (off[:, 2] <= FOUND_RAD)
    found = pair.stamps[near & (pair.stamps > carried_s)]
    return float(found[0] - carried_s) if found.size else None


def _by_step(stamps: Array, values: Array, count: int) -> Array:
    """Means (count,) of the values (n,) whose stamps (n,) lie in each step; NaN without any."""
    step = np.floor(stamps / STEP_S).astype(np.int64)
    inside = (step >= 0) & (step < count)
    told = np.bincount(step[inside], minlength=count)
    total = np.bincount(step[inside], weights=values[inside], minlength=count)
    return np.asarray(np.where(told > 0, total / np.maximum(told, 1), np.nan), np.float64)


def _offsets(pair: PairSeries, world: WorldSeries) -> Array:
    """What each told pose is off (n, 3) [m, m, rad]."""
    off = pair.poses - world.truth(pair.stamps)
    off[:, 2] = wrap_all(off[:, 2])
    return np.asarray(off, np.float64)
