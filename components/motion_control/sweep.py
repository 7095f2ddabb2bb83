"""One sweep of the scanner, and where on the way it was when each beam was taken."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planar.poses import Pose, compose
from planar.scans import beams_of
from schemas.sensor_msgs import LaserScan

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sweep:
    """One scan: `ranges` (n,) [m], +inf nothing there, NaN unknown; angles on the scanner [rad].

    `start` and `end` are the scanner's poses in the odometry frame at the first and last beam.
    """

    ranges: Array
    first_angle: float
    step: float
    start: Pose
    end: Pose

    @property
    def is_whole_turn(self) -> bool:
        """Whether the beams go once around."""
        return abs(self.step) * (self.ranges.size + 0.5) >= 2.0 * math.pi


def sweep_of(scan: LaserScan, mount: Pose, start: Pose, end: Pose) -> Sweep:
    """A scan as a sweep, by the scanner's `mount` on the robot.

    `start` and `end` are the robot's poses in the odometry frame at the first and last beam.
    """
    return Sweep(
        beams_of(scan, mount).ranges,
        scan.angle_min,
        scan.angle_increment,
        compose(start, mount),
        compose(end, mount),
    )


def view_of(scan: LaserScan, mount: Pose) -> tuple[float, float]:
    """The part of a circle around the robot that is seen: middle and half the width [rad]."""
    middle = mount[2] + 0.5 * (scan.angle_min + scan.angle_max)
    return middle, 0.5 * abs(scan.angle_max - scan.angle_min)
