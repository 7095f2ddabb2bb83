"""What the scanner saw in the last seconds: points that are in the way, and space that is free.

What left the field of view still counts for a while; what a newer beam passes through does not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from components.motion_control.sweep import Sweep
from planar.compiled import compiled
from planar.odometry import began_anew
from planar.poses import Pose

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

# Points beyond this distance [m] from the robot are of no use to it.
REACH = 4.0
_ROOM = 8192  # points; more than some scans of the finest scanner within reach
# Cells of the seen space [m], how many there are each way, and how far from the robot they are
# looked at: cells 6.4 m apart share a place, which no robot comes to within the memory's time.
_CELL, _CELLS, _SEEN_REACH = 0.1, 64, 1.6
# Space counts as seen if so much of it was, as single beams may fail; it is looked at so far [m]
# ahead of a robot that stands.
_SEEN_SHARE, _SEEN_AHEAD = 0.8, 0.3
# A beam clears a point that it passes, or sees anew, within these distances along and across [m].
_ALONG, _ACROSS = 0.1, 0.06
# Where a mover will be matters if the robot may be within this distance [m] of it by then, and
# will not have gone so far [m] beyond it.
_MEETING, _PASSED = 0.9, 0.6


@dataclass(frozen=True)
class Surroundings:
    """Points (n, 2) [m] in the robot's frame, those where something will come to included.

    `nearest` is the least distance [m] of what is there now to the robot's centre; `seen_ahead`
    is whether the space that it moves into was seen lately.
    """

    points: Array
    nearest: float
    seen_ahead: bool = True


class SeenSpace:
    """Points in the odometry frame that were seen within `memory_ns`, and where was nothing."""

    def __init__(self, memory_ns: int, robot_radius: float) -> None:
        self._memory = memory_ns
        self._radius = robot_radius
        self._points = np.empty((_ROOM, 2))
        self._stamps = np.empty(_ROOM, np.int64)
        self._count = 0
        self._seen = np.full((_CELLS, _CELLS), -(2**62), np.int64)
        self._local = np.empty((_ROOM, 2))
        self._coming = np.empty((0, 3))
        self._newest = 0

    def add(self, stamp: int, robot: Pose, sweep: Sweep) -> None:
        """Take the scan of that time [ns], when the robot was at `robot` in the odometry frame."""
        if sweep.ranges.size == 0:
            return
        if began_anew(self._newest, stamp):
            self.forget()
        self._newest = stamp
        self._count = _absorb(
            self._points,
            self._stamps,
            self._count,
            self._seen,
            sweep.ranges,
            sweep.first_angle,
            sweep.step,
            *sweep.start,
            *sweep.end,
            robot[0],
            robot[1],
            self._radius,
            stamp,
            stamp - self._memory,
        )

    def expect(self, coming: Array) -> None:
        """Take where movers will be, instead of what was expected before.

        x, y [m] in the odometry frame, and in how long [s] (n, 3).
        """
        self._coming = np.ascontiguousarray(coming)

    def around(
        self, robot: Pose, reach: float, speed: float = 0.0, fastest: float = 0.0
    ) -> Surroundings:
        """What is within `reach` [m] of the robot; its points are valid until the next call.

        Where movers will be counts if a robot that goes at `speed`, and at most at `fastest`
        [m/s], may have come near by then, and not have passed.
        """
        count, nearest, free = _around(
            self._points,
            self._count,
            self._coming,
            *robot,
            reach,
            speed,
            fastest,
            self._radius,
            self._local,
        )
        ahead = min(_SEEN_REACH - self._radius - _CELL, _SEEN_AHEAD + speed * abs(speed), free)
        seen = self.is_seen(robot, 0.0, ahead, self._newest - self._memory)
        return Surroundings(self._local[:count], nearest, seen)

    def is_seen(self, robot: Pose, direction: float, length: float, since: int) -> bool:
        """Whether what the robot sweeps going straight that way was seen since that time [ns].

        `direction` [rad] from the robot's heading, `length` [m] of the way.
        """
        x, y, heading = robot
        share = _seen_share(self._seen, x, y, heading + direction, length, self._radius, since)
        return share >= _SEEN_SHARE

    def forget(self) -> None:
        """Forget all, as when odometry begins anew."""
        self._count = 0
        self._coming = np.empty((0, 3))
        self._seen[:] = -(2**62)


@compiled(
    "int64(float64[:,::1], int64[::1], int64, int64[:,::1], float64[::1], float64, float64,"
    " float64, float64, float64, float64, float64, float64, float64, float64, float64,"
    " int64, int64)"
)
def _absorb(
    points: Array,
    stamps: Stamps,
    count: int,
    seen: Stamps,
    ranges: Array,
    first: float,
    step: float,
    x0: float,
    y0: float,
    theta0: float,
    x1: float,
    y1: float,
    theta1: float,
    robot_x: float,
    robot_y: float,
    radius: float,
    now: int,
    oldest: int,
) -> int:
    """Drop points that are too old or seen anew, then add the scan's; the new count."""
    beams = ranges.size
    dx, dy = x1 - x0, y1 - y0
    turned = (theta1 - theta0 + math.pi) % (2.0 * math.pi) - math.pi
    around = 2.0 * math.pi / abs(step) if step != 0.0 else 2.0 * beams
    kept = 0
    for i in range(count):
        if stamps[i] < oldest:
            continue
        px, py = points[i, 0], points[i, 1]
        fx, fy = px - robot_x, py - robot_y
        if fx * fx + fy * fy > REACH * REACH:
            continue
        share = 0.5
        beam = -1
        distance, across = 0.0, 0.0
        for _ in range(2):  # the beam tells when it was taken, and so where the scanner was
            sx, sy = x0 + share * dx, y0 + share * dy
            theta = theta0 + share * turned
            distance = math.hypot(px - sx, py - sy)
            bearing = math.atan2(py - sy, px - sx) - theta - first
            place = (bearing / step) if step != 0.0 else 0.0
            place = (place + 0.5) % around - 0.5
            beam = math.floor(place + 0.5)
            across = abs(place - beam) * abs(step) * distance
            share = min(1.0, max(0.0, place / max(1, beams - 1)))
        if (
            0 <= beam < beams
            and across < _ACROSS
            and not math.isnan(ranges[beam])
            and ranges[beam] >= distance - _ALONG
        ):
            continue
        points[kept, 0], points[kept, 1], stamps[kept] = px, py, stamps[i]
        kept += 1
    if kept + beams > points.shape[0]:  # the oldest go
        surplus = min(kept, kept + beams - points.shape[0])
        for i in range(surplus, kept):
            points[i - surplus, 0], points[i - surplus, 1] = points[i, 0], points[i, 1]
            stamps[i - surplus] = stamps[i]
        kept -= surplus
    reach = math.ceil(radius / _CELL)
    row, column = math.floor(robot_y / _CELL), math.floor(robot_x / _CELL)
    for r in range(row - reach, row + reach + 1):
        for c in range(column - reach, column + reach + 1):
            cx, cy = (c + 0.5) * _CELL - robot_x, (r + 0.5) * _CELL - robot_y
            if cx * cx + cy * cy <= (radius + 0.5 * _CELL) ** 2:
                seen[r % _CELLS, c % _CELLS] = now
    for beam in range(beams):
        span = ranges[beam]
        if math.isnan(span):
            continue
        share = beam / max(1, beams - 1)
        sx, sy = x0 + share * dx, y0 + share * dy
        angle = theta0 + share * turned + first + beam * step
        cosine, sine = math.cos(angle), math.sin(angle)
        marked = min(span, _SEEN_REACH)
        for k in range(int(marked / (0.5 * _CELL)) + 1):
            r = math.floor((sy + 0.5 * _CELL * k * sine) / _CELL) % _CELLS
            c = math.floor((sx + 0.5 * _CELL * k * cosine) / _CELL) % _CELLS
            seen[r, c] = now
        if span < REACH and kept < points.shape[0]:
            points[kept, 0], points[kept, 1] = sx + span * cosine, sy + span * sine
            stamps[kept] = now
            kept += 1
    return kept


@compiled(
    "Tuple((int64, float64, float64))(float64[:,::1], int64, float64[:,::1], float64, float64,"
    " float64, float64, float64, float64, float64, float64[:,::1])"
)
def _around(
    points: Array,
    count: int,
    coming: Array,
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

    Their number, the least distance of one, and how far a circle can go straight ahead; these
    are `reach` where there are none.
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
    for i in range(coming.shape[0]):
        dx, dy = coming[i, 0] - x, coming[i, 1] - y
        near = fastest * coming[i, 2] + _MEETING
        passed = max(0.0, speed * coming[i, 2] - _PASSED)
        apart = dx * dx + dy * dy
        if passed * passed <= apart < near * near and found < local.shape[0]:
            local[found, 0] = cosine * dx + sine * dy
            local[found, 1] = cosine * dy - sine * dx
            found += 1
    return found, math.sqrt(nearest), free


@compiled("float64(int64[:,::1], float64, float64, float64, float64, float64, int64)")
def _seen_share(
    seen: Stamps, x: float, y: float, angle: float, length: float, half: float, since: int
) -> float:
    """Share of the cells within `half` [m] of a line that were seen since that time."""
    cosine, sine = math.cos(angle), math.sin(angle)
    reach = math.ceil((length + half) / _CELL) + 1
    row, column = math.floor(y / _CELL), math.floor(x / _CELL)
    cells = known = 0
    for r in range(row - reach, row + reach + 1):
        for c in range(column - reach, column + reach + 1):
            dx, dy = (c + 0.5) * _CELL - x, (r + 0.5) * _CELL - y
            along, across = cosine * dx + sine * dy, cosine * dy - sine * dx
            beyond = along - min(max(along, 0.0), length)
            # The robot's own place is seen in any case.
            if beyond * beyond + across * across <= half * half < dx * dx + dy * dy:
                cells += 1
                if seen[r % _CELLS, c % _CELLS] >= since:
                    known += 1
    return 1.0 if cells == 0 else known / cells
