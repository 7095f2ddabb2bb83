"""How far the pose that a pair tells is off, and how sure it is, over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from components.experiments.series import PairSeries, WorldSeries
from planar.poses import wrap_all

Array = NDArray[np.float64]

STEP_S = 0.5
# So far off [m] a robot is lost.
LOST_M = 1.0
# So near the truth [m], [rad] a robot that was carried off has found itself.
FOUND_M, FOUND_RAD = 0.5, 0.5


@dataclass(frozen=True)
class Course:
    """Means of what was told within each step of `STEP_S`, NaN where nothing was told.

    `stamps` (n,) are the middles of the steps [s]; errors and deviations in m and rad (n,).
    """

    stamps: Array
    position_error: Array
    heading_error: Array
    position_sd: Array
    heading_sd: Array

    def between(self, begin: float, end: float) -> Course:
        """That part of it which lies within [begin, end) s."""
        inside = (self.stamps >= begin) & (self.stamps < end)
        return Course(
            self.stamps[inside],
            self.position_error[inside],
            self.heading_error[inside],
            self.position_sd[inside],
            self.heading_sd[inside],
        )

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
    position: Array = np.hypot(off[:, 0], off[:, 1])
    xx, _, yy, turn = np.maximum(pair.variances, 0.0).T
    step = np.floor(pair.stamps / STEP_S).astype(np.int64)
    inside = (step >= 0) & (step < count)
    told = np.bincount(step[inside], minlength=count)

    def mean(values: Array, power: int = 1) -> Array:
        total = np.bincount(step[inside], weights=values[inside] ** power, minlength=count)
        with np.errstate(invalid="ignore"):
            return np.asarray((total / told) ** (1.0 / power), np.float64)

    return Course(
        np.asarray((np.arange(count) + 0.5) * STEP_S, np.float64),
        mean(position, 2),
        mean(off[:, 2], 2),
        mean(np.sqrt(xx + yy)),
        mean(np.sqrt(turn)),
    )


def found_after(pair: PairSeries, world: WorldSeries, carried_s: float) -> float | None:
    """How long [s] after it was carried off the robot told a pose near the truth; None: never."""
    off = np.abs(_offsets(pair, world))
    near = (np.hypot(off[:, 0], off[:, 1]) <= FOUND_M) & (off[:, 2] <= FOUND_RAD)
    found = pair.stamps[near & (pair.stamps > carried_s)]
    return float(found[0] - carried_s) if found.size else None


def _offsets(pair: PairSeries, world: WorldSeries) -> Array:
    """What each told pose is off (n, 3) [m, m, rad]."""
    off = pair.poses - world.truth(pair.stamps)
    off[:, 2] = wrap_all(off[:, 2])
    return np.asarray(off, np.float64)
