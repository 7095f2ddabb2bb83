"""What the scanner saw in the last seconds: points that are in the way, and space that is free.

What left the field of view still counts for a while; what a newer beam passes through does not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.motion_control.seen_cells import CELL, SEEN_REACH, SeenCells
from cairn.planar.compiled import compiled
from cairn.planar.odometry import began_anew
from cairn.planar.poses import Pose
from cairn.planar.scans import Rays

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

# Points beyond this distance [m] from the robot are of no use to it.
REACH = 4.0
_ROOM = 8192  # points; more than some scans of the finest scanner within reach
# Space counts as seen if so much of it was, as single beams may fail; it is looked at so far [m]
# ahead of a robot that stands.
_SEEN_SHARE, _SEEN_AHEAD = 0.8, 0.3
# A beam clears a point that it passes, or sees anew, within these distances along and across [m].
_ALONG, _ACROSS = 0.1, 0.06
# So near to the robot [m] its next step could touch it: there a beam that goes on this far [m]
# behind a point clears it only if another one did from so far aside [rad]. Else beams beside a thin
# wall's end, or along the wall, would clear what is still there.
_NEAR, _BEHIND, _ASIDE = 0.13, 0.05, 0.2
# Where a mover will be matters if the robot may be within this distance [m] of it by then, and
# will not have gone so far [m] beyond it.
_MEETING, _PASSED = 0.9, 0.6


@dataclass(frozen=True)
class Surroundings:
    """Points (n, 2) [m] in the robot's frame, those where something will come to included.

    `nearest` is the least distance [m] of what is there now to the robot's center; `seen_ahead`
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
        self._doubts = np.empty(
            _ROOM
        )  # directions of the beams that passed them first [rad], or nan
        self._count = 0
        self._cells = SeenCells()
        self._local = np.empty((_ROOM, 2))
        self._coming = np.empty((0, 3))
        self._newest = 0

    def add(self, stamp: int, robot: Pose, rays: Rays) -> None:
        """Take the scan of that time [ns], when the robot was at `robot` in the odometry frame.

        The rays are in that frame too.
        """
        if rays.ranges.size == 0:
            return
        if began_anew(self._newest, stamp):
            self.forget()
        self._newest = stamp
        beams = rays.starts, rays.angles, rays.ranges
        x, y, _ = robot
        oldest = stamp - self._memory
        held = self._points, self._stamps, self._doubts
        self._count = _drop(*held, self._count, *beams, x, y, self._radius + _NEAR, oldest)
        self._make_room(rays.ranges.size)
        self._count = _append(*held, self._count, *beams, stamp)
        self._cells.stand(stamp, x, y, self._radius)
        self._cells.see(stamp, rays)

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
        ahead = min(SEEN_REACH - self._radius - CELL, _SEEN_AHEAD + speed * abs(speed), free)
        seen = self.is_seen(robot, 0.0, ahead, self._newest - self._memory)
        return Surroundings(self._local[:count], nearest, seen)

    def is_seen(self, robot: Pose, direction: float, length: float, since: int) -> bool:
        """Whether what the robot sweeps going straight that way was seen since that time [ns].

        `direction` [rad] from the robot's heading, `length` [m] of the way. What was seen before
        the memory begins does not count, as what stood there is forgotten.
        """
        x, y, heading = robot
        since = max(since, self._newest - self._memory)
        share = self._cells.share(x, y, heading + direction, length, self._radius, since)
        return share >= _SEEN_SHARE

    def forget(self) -> None:
        """Forget all, as when odometry begins anew."""
        self._count = 0
        self._coming = np.empty((0, 3))
        self._cells.forget()

    def _make_room(self, size: int) -> None:
        """Let the oldest points go where there is no room for so many more."""
        surplus = min(self._count, max(0, self._count + size - _ROOM))
        kept = self._count - surplus
        self._points[:kept] = self._points[surplus : self._count]
        self._stamps[:kept] = self._stamps[surplus : self._count]
        self._doubts[:kept] = self._doubts[surplus : self._count]
        self._count = kept


@compiled()
def _behind(starts: Array, angles: Array, ranges: Array, x: float, y: float) -> tuple[float, float]:
    """How far [m] the beam toward a place goes on behind it, and the beam's direction [rad].

    Negative where it ends before; nan if no beam tells.
    """
    last = ranges.size - 1
    step = (angles[last] - angles[0]) / max(1, last)
    whole = 2.0 * math.pi / abs(step) if step != 0.0 else math.inf
    beam = last // 2
    for _ in range(2):  # the beam tells from where it was sent, and that again which one it is
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
def _drop(
    points: Array,
    stamps: Stamps,
    doubts: Array,
    count: int,
    starts: Array,
    angles: Array,
    ranges: Array,
    robot_x: float,
    robot_y: float,
    near: float,
    oldest: int,
) -> int:
    """Drop points that are too old, too far from the robot, or seen anew; how many are left."""
    kept = 0
    for i in range(count):
        x, y, doubt = points[i, 0], points[i, 1], doubts[i]
        apart = (x - robot_x) ** 2 + (y - robot_y) ** 2
        if stamps[i] < oldest or apart > REACH * REACH:
            continue
        behind, direction = _behind(starts, angles, ranges, x, y)
        if behind >= -_ALONG:
            if apart > near * near or behind <= _BEHIND:
                continue
            if math.isnan(doubt):
                doubt = direction
            elif math.cos(direction - doubt) < math.cos(_ASIDE):
                continue
        points[kept, 0], points[kept, 1], stamps[kept], doubts[kept] = x, y, stamps[i], doubt
        kept += 1
    return kept


@compiled(
    "int64(float64[:,::1], int64[::1], float64[::1], int64, float64[:,::1], float64[::1],"
    " float64[::1], int64)"
)
def _append(
    points: Array,
    stamps: Stamps,
    doubts: Array,
    count: int,
    starts: Array,
    angles: Array,
    ranges: Array,
    stamp: int,
) -> int:
    """Add what the rays hit, as far as there is room; how many points there are then."""
    for i in range(ranges.size):
        if ranges[i] < REACH and count < points.shape[0]:
            points[count, 0] = starts[i, 0] + ranges[i] * math.cos(angles[i])
            points[count, 1] = starts[i, 1] + ranges[i] * math.sin(angles[i])
            stamps[count], doubts[count] = stamp, math.nan
            count += 1
    return count


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
