"""Recent scans: the points of the newest one, those it could not see, and ground seen free.

A point of an earlier scan counts until a newer scan sees past it or measures it again, at most for
the memory. So it counts outside the field of view, and nearer than the scanner measures.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.planar.odometry import time_went_back
from cairn.planar.poses import Pose, compose
from cairn.planar.scans import Rays
from cairn.schemas.sensor_msgs import LaserScan

Array = NDArray[np.float64]

# A beam measures a remembered point again, or passes it, within this distance [m] along the beam:
# twice what the scanners' noise and the odometry of a few seconds add up to.
_ALONG_M = 0.1
# So many remembered points are kept at most [1]: more than two scans of the finest scanner.
_MOST_POINTS = 3000
# Ground beside a ray counts as seen up to this angle [rad] from it: the spacing of coarse scanners.
_BESIDE_RAD = 0.06

_NONE: Array = np.empty((0, 2))


@dataclass(frozen=True)
class _Sweep:
    """A scan as a function of direction: the scanner's pose in the odometry frame, and ranges."""

    stamp: int
    robot: Pose
    scanner: Pose
    first: float
    step: float
    ranges: Array

    def ranges_toward(self, points: Array) -> tuple[Array, Array]:
        """Return distances [m] of points (n, 2) from the scanner, and the ranges toward them.

        NaN where nothing was measured in that direction.
        """
        x, y = points[:, 0] - self.scanner[0], points[:, 1] - self.scanner[1]
        bearing = np.arctan2(y, x) - self.scanner[2] - self.first
        whole = 2.0 * math.pi / abs(self.step)
        beam = np.floor(bearing / self.step + 0.5) % whole
        index = np.minimum(beam, self.ranges.size - 1).astype(np.int64)
        apart = np.abs(beam - index) * abs(self.step)
        toward = np.where(apart <= max(_BESIDE_RAD, abs(self.step)), self.ranges[index], math.nan)
        return np.hypot(x, y), toward


class RecentSweeps:
    """Scans of the last `memory_ns`, in the odometry frame, for a robot of `radius` [m].

    Points farther than `reach` [m] from the robot are dropped.
    """

    def __init__(self, memory_ns: int, radius: float, reach: float) -> None:
        self._memory = memory_ns
        self._radius = radius
        self._reach = reach
        self._sweeps: deque[_Sweep] = deque()
        self.forget()

    def forget(self) -> None:
        """Forget everything, as when odometry restarts."""
        self._sweeps.clear()
        self._points = np.empty((0, 2))
        self._stamps = np.empty(0, np.int64)
        self._for_now = _NONE

    def set_points_for_now(self, points: Sequence[Array]) -> None:
        """Replace the points (n, 2) [m] of scans whose place is not certain yet.

        They count in addition to those of the scans that were added.
        """
        self._for_now = np.concatenate(points) if points else _NONE

    def add(self, stamp: int, robot: Pose, mount: Pose, scan: LaserScan, rays: Rays) -> None:
        """Add a scan that ended with the robot at `robot`; `rays` are in the odometry frame.

        A beam of -inf (REP 117: nearer than the scanner measures) counts as a point at `range_min`.
        """
        if self._sweeps and time_went_back(self._sweeps[-1].stamp, stamp):
            self.forget()
        if rays.ranges.size == 0 or scan.angle_increment == 0.0:
            return
        near = np.isneginf(scan.ranges)
        ranges = np.where(near, scan.range_min, rays.ranges)
        sweep = _Sweep(
            stamp, robot, compose(robot, mount), scan.angle_min, scan.angle_increment, ranges
        )
        points, stamps = self._remembered(sweep)
        hit = np.isfinite(ranges)
        new = rays.starts[hit].copy()
        new[:, 0] += ranges[hit] * np.cos(rays.angles[hit])
        new[:, 1] += ranges[hit] * np.sin(rays.angles[hit])
        new = new[np.hypot(new[:, 0] - robot[0], new[:, 1] - robot[1]) < self._reach]
        self._points = np.concatenate((points, new))
        self._stamps = np.concatenate((stamps, np.full(new.shape[0], stamp)))
        self._sweeps.append(sweep)
        while self._sweeps[0].stamp < stamp - self._memory:
            self._sweeps.popleft()

    def points(self, robot: Pose, within: float) -> Array:
        """Return the points (n, 2) [m] in the frame of a robot at `robot`, up to `within` [m]."""
        points = self._points
        if self._for_now.size:
            points = np.concatenate((points, self._for_now))
        x, y = points[:, 0] - robot[0], points[:, 1] - robot[1]
        near = x * x + y * y < within * within
        if not near.any():
            return _NONE
        x, y = x[near], y[near]
        cosine, sine = math.cos(robot[2]), math.sin(robot[2])
        return np.column_stack((cosine * x + sine * y, cosine * y - sine * x))

    def share_seen(self, robot: Pose, places: Array) -> float:
        """Return the share [1] of places (n, 2) [m], in the robot's frame, that were seen free.

        A place was seen if a beam passed it, or if the robot stood there.
        """
        cosine, sine = math.cos(robot[2]), math.sin(robot[2])
        x, y = places[:, 0], places[:, 1]
        there = np.column_stack(
            (robot[0] + cosine * x - sine * y, robot[1] + sine * x + cosine * y)
        )
        seen = np.zeros(there.shape[0], bool)
        for sweep in reversed(self._sweeps):
            apart, ranges = sweep.ranges_toward(there)
            stood = np.hypot(there[:, 0] - sweep.robot[0], there[:, 1] - sweep.robot[1])
            with np.errstate(invalid="ignore"):
                seen |= (apart < ranges) | (stood <= self._radius)
            if seen.all():
                break
        return float(np.mean(seen))

    def _remembered(self, sweep: _Sweep) -> tuple[Array, NDArray[np.int64]]:
        """Return the points that a new scan neither measures again nor sees past."""
        if self._points.shape[0] == 0:
            return self._points, self._stamps
        apart, ranges = sweep.ranges_toward(self._points)
        with np.errstate(invalid="ignore"):
            kept = ~(ranges > apart - _ALONG_M)
        kept &= self._stamps >= sweep.stamp - self._memory
        x, y = self._points[:, 0] - sweep.robot[0], self._points[:, 1] - sweep.robot[1]
        kept &= np.hypot(x, y) < self._reach
        index = np.flatnonzero(kept)[-_MOST_POINTS:]
        return self._points[index], self._stamps[index]
