"""Laser scans as points around the robot."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import Pose
from cairn.schemas.sensor_msgs import LaserScan

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Beams:
    """The beams of one scan in the frame of the robot's base.

    `start` is the scanner's pose on the robot; `angles` (n,) [rad] are directions in the base's
    frame; `ranges` (n,) [m]: finite where something was hit, +inf where nothing was hit within
    `reach` [m], NaN where the beam tells nothing.
    """

    start: Pose
    angles: Array
    ranges: Array
    reach: float

    @property
    def hit(self) -> NDArray[np.bool_]:
        """Which beams (n,) hit something."""
        return np.isfinite(self.ranges)

    def points(self) -> Array:
        """x, y (m, 2) [m] of what was hit, in the base's frame."""
        ranges = self.ranges[self.hit]
        angles = self.angles[self.hit]
        x = self.start[0] + ranges * np.cos(angles)
        y = self.start[1] + ranges * np.sin(angles)
        return np.column_stack((x, y))


def beams_of(scan: LaserScan, mount: Pose) -> Beams:
    """The beams of a scan taken by a scanner that sits at `mount` on the robot.

    As in REP 117: +inf is no return; -inf (too near), NaN, and ranges outside the scanner's own
    limits tell nothing, except that a range at or above `range_max` is no return too.
    """
    ranges = scan.ranges.astype(np.float64)
    with np.errstate(invalid="ignore"):
        ranges[ranges < scan.range_min] = math.nan
        ranges[ranges >= scan.range_max] = math.inf
    steps = np.arange(ranges.size, dtype=np.float64)
    angles: Array = mount[2] + scan.angle_min + scan.angle_increment * steps
    return Beams(mount, angles, ranges, float(scan.range_max))
