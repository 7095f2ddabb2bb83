"""Scan memory: obstacle points of the last seconds, and the ground that was seen free.

Points outside the field of view count for a while; points that a newer beam passes through do not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
from cairn.planar.obstacle_memory import Clearing, ObstacleMemory, points_near
from cairn.planar.odometry import time_went_back
from cairn.planar.poses import Pose
from cairn.planar.scans import Rays

Array = NDArray[np.float64]
Cells = NDArray[np.int64]

# Where no other reason is given, these constants were chosen by hand; `lab/constants.yaml`
# has the effect of half and double.

GROUND_REACH_M = 1.6
"""Cells are marked up to this distance [m] from the scanner: farther than a robot needs to stop."""
CELL_M = 0.1
"""Size of a cell [m]."""

_SIDE = 64  # cells per side, twice those within reach; cells so many apart share a slot
_STAMP, _ROW, _COLUMN = 0, 1, 2
_NEVER = -(2**62)


class SeenGround:
    """The time [ns] at which each nearby cell was last seen free."""

    def __init__(self) -> None:
        self._cells = np.zeros((_SIDE, _SIDE, 3), np.int64)
        self.forget()

    def forget(self) -> None:
        """Forget everything."""
        self._cells[:, :, _STAMP] = _NEVER

    def stand(self, stamp: int, x: float, y: float, radius: float) -> None:
        """Mark the ground under the robot: nothing else is there."""
        _mark_disc(self._cells, x, y, radius, stamp)

    def see(self, stamp: int, rays: Rays) -> None:
        """Mark the cells that the rays of a scan passed through."""
        _mark_rays(self._cells, rays.starts, rays.angles, rays.ranges, stamp)

    def share(
        self, x: float, y: float, angle: float, length: float, half: float, since: int
    ) -> float:
        """Return the share of the ground within `half` [m] of a line that was seen since that time.

        The ground within `half` of the start of the line does not count.
        """
        return _share(self._cells, x, y, angle, length, half, since)


@compiled()
def _mark(cells: Cells, row: int, column: int, stamp: int) -> None:
    r, c = row % _SIDE, column % _SIDE
    cells[r, c, _STAMP], cells[r, c, _ROW], cells[r, c, _COLUMN] = stamp, row, column


@compiled("void(int64[:,:,::1], float64, float64, float64, int64)")
def _mark_disc(cells: Cells, x: float, y: float, radius: float, stamp: int) -> None:
    reach = math.ceil(radius / CELL_M)
    row, column = math.floor(y / CELL_M), math.floor(x / CELL_M)
    for r in range(row - reach, row + reach + 1):
        for c in range(column - reach, column + reach + 1):
            dx, dy = (c + 0.5) * CELL_M - x, (r + 0.5) * CELL_M - y
            if dx * dx + dy * dy <= (radius + 0.5 * CELL_M) ** 2:
                _mark(cells, r, c, stamp)


@compiled("void(int64[:,:,::1], float64[:,::1], float64[::1], float64[::1], int64)")
def _mark_rays(cells: Cells, starts: Array, angles: Array, ranges: Array, stamp: int) -> None:
    for i in range(ranges.size):
        if math.isnan(ranges[i]):
            continue
        dx, dy = 0.5 * CELL_M * math.cos(angles[i]), 0.5 * CELL_M * math.sin(angles[i])
        for k in range(int(min(ranges[i], GROUND_REACH_M) / (0.5 * CELL_M)) + 1):
            row = math.floor((starts[i, 1] + k * dy) / CELL_M)
            column = math.floor((starts[i, 0] + k * dx) / CELL_M)
            _mark(cells, row, column, stamp)


@compiled("float64(int64[:,:,::1], float64, float64, float64, float64, float64, int64)")
def _share(
    cells: Cells, x: float, y: float, angle: float, length: float, half: float, since: int
) -> float:
    cosine, sine = math.cos(angle), math.sin(angle)
    reach = math.ceil((length + half) / CELL_M) + 1
    row, column = math.floor(y / CELL_M), math.floor(x / CELL_M)
    count = seen = 0
    for r in range(row - reach, row + reach + 1):
        for c in range(column - reach, column + reach + 1):
            dx, dy = (c + 0.5) * CELL_M - x, (r + 0.5) * CELL_M - y
            along, across = cosine * dx + sine * dy, cosine * dy - sine * dx
            beyond = along - min(max(along, 0.0), length)
            if beyond * beyond + across * across <= half * half < dx * dx + dy * dy:
                count += 1
                place = cells[r % _SIDE, c % _SIDE]
                if place[_STAMP] >= since and place[_ROW] == r and place[_COLUMN] == c:
                    seen += 1
    return 1.0 if count == 0 else seen / count


# Points farther than this [m] from the robot are dropped: farther than the local planner needs them
# (`OBSTACLE_RANGE_M`, 3.3 m).
MAX_RANGE_M = 4.0
# The ground counts as seen if this share of it was, as single beams may fail; it is checked so far
# [m] ahead of a standing robot.
_SEEN_SHARE, _SEEN_AHEAD = 0.8, 0.3
# A beam clears a point that it passes, or hits again, within these distances along and across [m].
_ALONG, _ACROSS = 0.1, 0.06
# A point this near [m] to the robot could be touched by its next motion.
_NEAR = 0.13
# A predicted position of a moving thing counts if the robot may be within this distance [m] of it
# by then, and will not be so far [m] beyond it.
_MEETING, _PASSED = 0.9, 0.6


@dataclass(frozen=True)
class NearbyObstacles:
    """Points (n, 2) [m] in the robot's frame, including predicted positions of moving things.

    `nearest` is the least distance [m] of a present point to the robot's center;
    `ground_seen_ahead` is whether the ground that the robot drives onto was seen lately.
    """

    points: Array
    nearest: float
    ground_seen_ahead: bool = True


class ScanMemory:
    """Obstacles in the odometry frame, seen within `memory_ns`, and the ground seen free."""

    def __init__(self, memory_ns: int, robot_radius: float) -> None:
        self._memory = memory_ns
        self._radius = robot_radius
        clearing = Clearing(behind=-_ALONG, width=_ACROSS, near=robot_radius + _NEAR)
        self._obstacles = ObstacleMemory(clearing, MAX_RANGE_M)
        self._cells = SeenGround()
        self._predictions = np.empty((0, 3))
        self._edges = np.empty((0, 2))
        self._newest = 0

    @property
    def points(self) -> Array:
        """The obstacle points (n, 2) [m] in the odometry frame."""
        return self._obstacles.points

    def add(self, stamp: int, robot: Pose, rays: Rays) -> None:
        """Add the scan of that time [ns], when the robot was at `robot` in the odometry frame.

        The rays are in the odometry frame.
        """
        if rays.ranges.size == 0:
            return
        if time_went_back(self._newest, stamp):
            self.forget()
        self._newest = stamp
        self._obstacles.clear(robot, rays, stamp - self._memory)
        self._obstacles.add(stamp, rays.points(MAX_RANGE_M))
        self._cells.stand(stamp, robot[0], robot[1], self._radius)
        self._cells.see(stamp, rays)

    def set_predictions(self, predictions: Array) -> None:
        """Replace the predicted positions of moving things.

        x, y [m] in the odometry frame, and the time ahead [s] (n, 3).
        """
        self._predictions = predictions

    def set_edges(self, points: Array) -> None:
        """Replace the points (n, 2) [m] in the odometry frame on edges that count as obstacles."""
        self._edges = points

    def around(
        self, robot: Pose, reach: float, speed: float = 0.0, fastest: float = 0.0
    ) -> NearbyObstacles:
        """Return the obstacles within `reach` [m] of the robot.

        Edges are among the points, but `nearest` is of an obstacle.
        Predicted positions count if a robot with `speed`, and at most `fastest` [m/s], may be near
        by then and not have passed.
        """
        points = points_near(self._obstacles.points, robot, reach)
        x, y = points.T
        nearest = float(np.hypot(x, y).min(initial=reach))
        in_the_way = (x > 0.0) & (np.abs(y) < self._radius)
        free = x[in_the_way] - np.sqrt(self._radius**2 - y[in_the_way] ** 2)
        ahead = min(
            GROUND_REACH_M - self._radius - CELL_M,
            _SEEN_AHEAD + speed * abs(speed),
            max(0.0, free.min(initial=reach)),
        )
        seen = self.is_ground_seen(robot, 0.0, ahead, self._newest - self._memory)
        moving = self._predictions_near(robot, speed, fastest)
        edges = points_near(self._edges, robot, reach)
        points = np.concatenate((points, points_near(moving, robot, math.inf), edges))
        return NearbyObstacles(points, nearest, seen)

    def is_ground_seen(self, robot: Pose, direction: float, length: float, since: int) -> bool:
        """Return whether the ground on a straight drive was seen since that time [ns].

        `direction` [rad] relative to the robot's heading, `length` [m] of the path. Ground seen
        before the memory starts does not count, as obstacles there are forgotten.
        """
        x, y, heading = robot
        since = max(since, self._newest - self._memory)
        share = self._cells.share(x, y, heading + direction, length, self._radius, since)
        return share >= _SEEN_SHARE

    def forget(self) -> None:
        """Forget everything, as when odometry restarts."""
        self._obstacles.forget()
        self._predictions = np.empty((0, 3))
        self._cells.forget()

    def _predictions_near(self, robot: Pose, speed: float, fastest: float) -> Array:
        """Return the predicted positions that a robot of this speed may meet."""
        x, y, ahead_s = self._predictions.T
        apart = np.hypot(x - robot[0], y - robot[1])
        near = apart < fastest * ahead_s + _MEETING
        return self._predictions[near & (apart >= speed * ahead_s - _PASSED), :2].copy()
