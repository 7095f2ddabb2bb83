"""Scans of a robot that moves while its scanner sweeps: each ray from where it was sent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import Pose, inverse
from cairn.planar.scans import beams_of
from cairn.schemas.sensor_msgs import LaserScan

Array = NDArray[np.float64]

# A scan of which less than this share of the rays tells anything tells nothing.
_LEAST = 0.1


@dataclass(frozen=True)
class Rays:
    """Rays in the frame of the base as it was when the sweep ended, unless `placed` elsewhere.

    `starts` (n, 2) [m], directions `angles` (n,) [rad], `ranges` (n,) [m]: finite where something
    was hit, +inf where nothing was within `reach` [m], NaN where the ray tells nothing.
    """

    starts: Array
    angles: Array
    ranges: Array
    reach: float

    def points(self) -> Array:
        """x, y (m, 2) [m] of what was hit."""
        hit = np.isfinite(self.ranges)
        ranges, angles = self.ranges[hit], self.angles[hit]
        points: Array = self.starts[hit].copy()
        points[:, 0] += ranges * np.cos(angles)
        points[:, 1] += ranges * np.sin(angles)
        return points

    @property
    def tell(self) -> bool:
        """Whether at least a tenth of the rays tells anything."""
        known = int(np.count_nonzero(~np.isnan(self.ranges)))
        return known > 0 and known >= _LEAST * self.ranges.size

    def misses(self) -> tuple[Array, Array]:
        """Where the rays that hit nothing within reach start and end: x, y (m, 2) [m] of both."""
        missed = np.isposinf(self.ranges)
        starts, angles = self.starts[missed], self.angles[missed]
        return starts, starts + self.reach * np.column_stack((np.cos(angles), np.sin(angles)))

    def placed(self, base: Pose) -> Rays:
        """The rays in the frame in which the base was at `base` when the sweep ended."""
        x, y, turn = base
        cosine, sine = math.cos(turn), math.sin(turn)
        starts = np.empty_like(self.starts)
        starts[:, 0] = x + cosine * self.starts[:, 0] - sine * self.starts[:, 1]
        starts[:, 1] = y + sine * self.starts[:, 0] + cosine * self.starts[:, 1]
        return Rays(starts, self.angles + turn, self.ranges, self.reach)


def sweep_s(scan: LaserScan) -> float:
    """How long [s] the sweep took from its first to its last beam."""
    return max(0.0, scan.time_increment * (scan.ranges.size - 1))


def rays_of(scan: LaserScan, mount: Pose, moved: Pose) -> Rays:
    """The rays of a scan by a scanner that sits at `mount` on the robot.

    `moved` is the pose of the base at the last beam as seen from where it was at the first one;
    in between it moved evenly.
    """
    beams = beams_of(scan, mount)
    count = beams.ranges.size
    # How far each beam's base lies back from where the sweep ended.
    back_x, back_y, back_turn = inverse(moved)
    left = np.linspace(1.0, 0.0, count) if scan.time_increment > 0 else np.zeros(count)
    turn = left * back_turn
    cosine, sine = np.cos(turn), np.sin(turn)
    starts = np.empty((count, 2))
    starts[:, 0] = left * back_x + cosine * mount[0] - sine * mount[1]
    starts[:, 1] = left * back_y + sine * mount[0] + cosine * mount[1]
    return Rays(starts, beams.angles + turn, beams.ranges, beams.reach)
