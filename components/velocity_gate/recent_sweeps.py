"""Recent scans: the points of the newest one, those it could not see, and ground seen free.

A point of an earlier scan counts until a newer scan sees past it or measures it again, at most for
the memory. So it counts outside the field of view, and nearer than the scanner measures.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cairn.planar.obstacle_memory import Clearing, ObstacleMemory, points_near, ranges_behind
from cairn.planar.odometry import time_went_back
from cairn.planar.poses import Pose
from cairn.planar.scans import Rays, beams_of
from cairn.schemas.sensor_msgs import LaserScan

Array = NDArray[np.float64]

# A beam measures a remembered point again, or passes it, within this distance [m] along the beam:
# twice what the scanners' noise and the odometry of a few seconds add up to.
_ALONG_M = 0.1
# Ground beside a ray counts as seen up to this angle [rad] from it: the spacing of coarse scanners.
_BESIDE_RAD = 0.06

_NONE: Array = np.empty((0, 2))


class RecentSweeps:
    """Scans of the last `memory_ns`, in the odometry frame, for a robot of `radius` [m].

    Points farther than `reach` [m] from the robot are dropped.
    """

    def __init__(self, memory_ns: int, radius: float, reach: float) -> None:
        self._memory = memory_ns
        self._radius = radius
        self._reach = reach
        self._obstacles = ObstacleMemory(Clearing(-_ALONG_M, beside=_BESIDE_RAD), reach)
        self._sweeps: deque[tuple[int, Pose, Rays]] = deque()  # stamp, robot, as if it had stood
        self._for_now = _NONE

    def forget(self) -> None:
        """Forget everything, as when odometry restarts."""
        self._sweeps.clear()
        self._obstacles.forget()
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
        if self._sweeps and time_went_back(self._sweeps[-1][0], stamp):
            self.forget()
        if rays.ranges.size == 0:
            return
        ranges = np.where(np.isneginf(scan.ranges), scan.range_min, rays.ranges)
        sweep = replace(beams_of(scan, mount).rays(robot), ranges=ranges)
        oldest = stamp - self._memory
        self._obstacles.clear(robot, sweep, oldest)
        new = replace(rays, ranges=ranges).points()
        near = np.hypot(new[:, 0] - robot[0], new[:, 1] - robot[1]) < self._reach
        self._obstacles.add(stamp, new[near])
        self._sweeps.append((stamp, robot, sweep))
        while self._sweeps[0][0] < oldest:
            self._sweeps.popleft()

    def points(self, robot: Pose, within: float) -> Array:
        """Return the points (n, 2) [m] in the frame of a robot at `robot`, up to `within` [m]."""
        return points_near(np.concatenate((self._obstacles.points, self._for_now)), robot, within)

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
        for _, stood, sweep in reversed(self._sweeps):
            behind = ranges_behind(there, sweep.starts, sweep.angles, sweep.ranges, _BESIDE_RAD)
            apart = np.hypot(there[:, 0] - stood[0], there[:, 1] - stood[1])
            seen |= (behind > 0.0) | (apart <= self._radius)
            if seen.all():
                break
        return float(np.mean(seen))
