"""Scan memory: obstacle points of the last seconds, and the ground that was seen free.

Points outside the field of view count for a while; points that a newer beam passes through do not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
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


Stamps = NDArray[np.int64]

# Points farther than this [m] from the robot are dropped: farther than the local planner needs them
# (`OBSTACLE_RANGE_M`, 3.3 m).
MAX_RANGE_M = 4.0
_ROOM = 8192  # points; more than several scans of the finest scanner within range
# The ground counts as seen if this share of it was, as single beams may fail; it is checked so far
# [m] ahead of a standing robot.
_SEEN_SHARE, _SEEN_AHEAD = 0.8, 0.3
# A beam clears a point that it passes, or hits again, within these distances along and across [m].
_ALONG, _ACROSS = 0.1, 0.06
# A point this near [m] to the robot could be touched by its next motion: there a beam that
# continues this far [m] behind the point clears it only if another one from a direction so
# different [rad] did as well. Otherwise beams past the end of a thin wall, or along the wall, would
# clear points that are still there.
_NEAR, _BEHIND, _ASIDE = 0.13, 0.05, 0.2
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
    """Points in the odometry frame that were seen within `memory_ns`, and the ground seen free."""

    def __init__(self, memory_ns: int, robot_radius: float) -> None:
        self._memory = memory_ns
        self._radius = robot_radius
        self._points = np.empty((_ROOM, 2))
        self._stamps = np.empty(_ROOM, np.int64)
        self._passed_directions = np.empty(
            _ROOM
        )  # directions of the beams that first passed them [rad], or nan
        self._count = 0
        self._cells = SeenGround()
        self._local = np.empty((_ROOM, 2))
        self._predictions = np.empty((0, 3))
        self._edges = np.empty((0, 2))
        self._newest = 0

    def add(self, stamp: int, robot: Pose, rays: Rays) -> None:
        """Add the scan of that time [ns], when the robot was at `robot` in the odometry frame.

        The rays are in the odometry frame.
        """
        if rays.ranges.size == 0:
            return
        if time_went_back(self._newest, stamp):
            self.forget()
        self._newest = stamp
        beams = rays.starts, rays.angles, rays.ranges
        x, y, _ = robot
        oldest = stamp - self._memory
        held = self._points, self._stamps, self._passed_directions
        self._count = _forget_points(*held, self._count, *beams, x, y, self._radius + _NEAR, oldest)
        self._make_room(rays.ranges.size)
        self._count = _append(*held, self._count, *beams, stamp)
        self._cells.stand(stamp, x, y, self._radius)
        self._cells.see(stamp, rays)

    def set_predictions(self, predictions: Array) -> None:
        """Replace the predicted positions of moving things.

        x, y [m] in the odometry frame, and the time ahead [s] (n, 3).
        """
        self._predictions = np.ascontiguousarray(predictions)

    def set_edges(self, points: Array) -> None:
        """Replace the points (n, 2) [m] in the odometry frame on edges that count as obstacles."""
        self._edges = points

    def around(
        self, robot: Pose, reach: float, speed: float = 0.0, fastest: float = 0.0
    ) -> NearbyObstacles:
        """Return the obstacles within `reach` [m] of the robot; valid until the next call.

        Edges are among the points, but `nearest` is of an obstacle.
        Predicted positions count if a robot with `speed`, and at most `fastest` [m/s], may be near
        by then and not have passed.
        """
        count, nearest, free = _collect(
            self._points,
            self._count,
            self._predictions,
            *robot,
            reach,
            speed,
            fastest,
            self._radius,
            self._local,
        )
        ahead = min(GROUND_REACH_M - self._radius - CELL_M, _SEEN_AHEAD + speed * abs(speed), free)
        seen = self.is_ground_seen(robot, 0.0, ahead, self._newest - self._memory)
        points = self._local[:count]
        if len(self._edges):
            points = np.vstack((points, self._edges_around(robot, reach)))
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
        self._count = 0
        self._predictions = np.empty((0, 3))
        self._cells.forget()

    def _edges_around(self, robot: Pose, reach: float) -> Array:
        """Return the points of edges within reach, in the robot's frame."""
        x, y, theta = robot
        cosine, sine = math.cos(theta), math.sin(theta)
        local = (self._edges - (x, y)) @ np.array([[cosine, -sine], [sine, cosine]])
        near: Array = local[np.hypot(local[:, 0], local[:, 1]) < reach]
        return near

    def _make_room(self, size: int) -> None:
        """Drop the oldest points if there is no room for so many more."""
        surplus = min(self._count, max(0, self._count + size - _ROOM))
        kept = self._count - surplus
        self._points[:kept] = self._points[surplus : self._count]
        self._stamps[:kept] = self._stamps[surplus : self._count]
        self._passed_directions[:kept] = self._passed_directions[surplus : self._count]
        self._count = kept


@compiled()
def _range_behind(
    starts: Array, angles: Array, ranges: Array, x: float, y: float
) -> tuple[float, float]:
    """Return how far [m] the beam toward a position continues behind it, and its direction [rad].

    Negative if the beam ends before; nan if no beam measured it.
    """
    last = ranges.size - 1
    step = (angles[last] - angles[0]) / max(1, last)
    whole = 2.0 * math.pi / abs(step) if step != 0.0 else math.inf
    beam = last // 2
    for _ in range(2):  # the beam gives the start, and the start gives the beam
        off = math.atan2(y - starts[beam, 1], x - starts[beam, 0]) - angles[beam]
        place = beam + (off / step if step != 0.0 else 0.0)
        nearest = math.floor((place + 0.5) % whole)
        beam = min(last, nearest)
    dx, dy = x - starts[beam, 0], y - starts[beam, 1]
    cosine, sine = math.cos(angles[beam]), math.sin(angles[beam])
    along, across = cosine * dx + sine * dy, cosine * dy - sine * dx
    if nearest > last or along < 0.0 or abs(across) >= _ACROSS:
        return math.nan, 0.0
    return ranges[beam] - along, math.atan2(sine, cosine)


@compiled(
    "int64(float64[:,::1], int64[::1], float64[::1], int64, float64[:,::1], float64[::1],"
    " float64[::1], float64, float64, float64, int64)"
)
def _forget_points(
    points: Array,
    stamps: Stamps,
    passed_directions: Array,
    count: int,
    starts: Array,
    angles: Array,
    ranges: Array,
    robot_x: float,
    robot_y: float,
    near: float,
    oldest: int,
) -> int:
    """Drop points that are too old, too far, or seen again; return the number of those left."""
    kept = 0
    for i in range(count):
        x, y, passed_direction = points[i, 0], points[i, 1], passed_directions[i]
        apart = (x - robot_x) ** 2 + (y - robot_y) ** 2
        if stamps[i] < oldest or apart > MAX_RANGE_M * MAX_RANGE_M:
            continue
        behind, direction = _range_behind(starts, angles, ranges, x, y)
        if behind >= -_ALONG:
            if apart > near * near or behind <= _BEHIND:
                continue
            if math.isnan(passed_direction):
                passed_direction = direction
            elif math.cos(direction - passed_direction) < math.cos(_ASIDE):
                continue
        (
            points[kept, 0],
            points[kept, 1],
            stamps[kept],
            passed_directions[kept],
        ) = x, y, stamps[i], passed_direction
        kept += 1
    return kept


@compiled(
    "int64(float64[:,::1], int64[::1], float64[::1], int64, float64[:,::1], float64[::1],"
    " float64[::1], int64)"
)
def _append(
    points: Array,
    stamps: Stamps,
    passed_directions: Array,
    count: int,
    starts: Array,
    angles: Array,
    ranges: Array,
    stamp: int,
) -> int:
    """Add the hits of the rays while there is room; return the number of points."""
    for i in range(ranges.size):
        if ranges[i] < MAX_RANGE_M and count < points.shape[0]:
            points[count, 0] = starts[i, 0] + ranges[i] * math.cos(angles[i])
            points[count, 1] = starts[i, 1] + ranges[i] * math.sin(angles[i])
            stamps[count], passed_directions[count] = stamp, math.nan
            count += 1
    return count


@compiled(
    "Tuple((int64, float64, float64))(float64[:,::1], int64, float64[:,::1], float64, float64,"
    " float64, float64, float64, float64, float64, float64[:,::1])"
)
def _collect(
    points: Array,
    count: int,
    predictions: Array,
    x: float,
    y: float,
    theta: float,
    reach: float,
    speed: float,
    fastest: float,
    radius: float,
    local: Array,
) -> tuple[int, float, float]:
    """Fill `local` with the points within reach in the frame of the pose.

    Returns their number, the least distance of one, and how far a circle can drive straight ahead;
    both are `reach` without points.
    """
    cosine, sine = math.cos(theta), math.sin(theta)
    found, nearest, free = 0, reach * reach, reach
    for i in range(count):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        apart = dx * dx + dy * dy
        if apart < reach * reach:
            along, across = cosine * dx + sine * dy, cosine * dy - sine * dx
            local[found, 0], local[found, 1] = along, across
            nearest = min(nearest, apart)
            if along > 0.0 and abs(across) < radius:
                free = min(free, max(0.0, along - math.sqrt(radius**2 - across**2)))
            found += 1
    for i in range(predictions.shape[0]):
        dx, dy = predictions[i, 0] - x, predictions[i, 1] - y
        near = fastest * predictions[i, 2] + _MEETING
        passed = max(0.0, speed * predictions[i, 2] - _PASSED)
        apart = dx * dx + dy * dy
        if passed * passed <= apart < near * near and found < local.shape[0]:
            local[found, 0] = cosine * dx + sine * dy
            local[found, 1] = cosine * dy - sine * dx
            found += 1
    return found, math.sqrt(nearest), free
