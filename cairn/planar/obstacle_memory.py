"""Obstacle memory: points that a scanner saw lately, until they are too old or beams clear them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
from cairn.planar.poses import Pose
from cairn.planar.scans import Rays

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

# So many points are remembered at most: more than several scans of the finest scanner within range.
_MOST_POINTS = 8192
# A point near the robot could be touched by its next motion: there a beam that continues this far
# [m] behind the point clears it only if another one from a direction so different [rad] did as
# well. Otherwise beams past the end of a thin wall, or along the wall, would clear points that are
# still there. Chosen by hand; half and double of each changed nothing in simulated drives.
_BEHIND, _ASIDE = 0.05, 0.2


@dataclass(frozen=True)
class Clearing:
    """When a beam clears a remembered point, because it hits the point again or passes it.

    It does if it ends at least `behind` [m] behind the point; a negative value: before it. It must
    pass within `width` [m]; if that is infinite, the beam stands for its whole sector, and the
    outermost sectors extend by `beside` [rad]. Points within `near` [m] of the robot are cleared by
    two beams of different directions only.
    """

    behind: float
    width: float = math.inf
    beside: float = 0.0
    near: float = 0.0


class ObstacleMemory:
    """Points of one frame, each with the time [ns] at which it was last seen."""

    def __init__(self, clearing: Clearing, reach: float = math.inf) -> None:
        """Drop points farther than `reach` [m] from the robot."""
        self._clearing, self._reach = clearing, reach
        self.forget()

    @property
    def points(self) -> Array:
        """The points x, y (n, 2) [m], in the order in which they were added."""
        return self._points

    def forget(self) -> None:
        """Forget everything, as when odometry restarts."""
        self._points = np.empty((0, 2))
        self._stamps = np.empty(0, np.int64)
        self._directions = np.empty(0)  # of the beams that first passed near points [rad], or NaN

    def forget_before(self, oldest: int) -> None:
        """Forget the points last seen before that time [ns]."""
        self._keep(self._stamps >= oldest)

    def clear(self, robot: Pose, rays: Rays, oldest: int) -> None:
        """Forget the points that rays clear, that are too far, or last seen before `oldest` [ns].

        The robot and the rays are in the frame of the points.
        """
        held = self._points, self._stamps, self._directions
        beams = rays.starts, rays.angles, rays.ranges
        rule = self._clearing
        limits = rule.behind, rule.width, rule.beside, rule.near, self._reach
        self._keep(slice(_clear(*held, *beams, oldest, robot[0], robot[1], *limits)))

    def add(self, stamp: int, points: Array) -> None:
        """Add points (n, 2) [m] seen at that time [ns]; drop the oldest ones if they are many."""
        size = points.shape[0]
        self._points = np.concatenate((self._points, points))
        self._stamps = np.concatenate((self._stamps, np.full(size, stamp, np.int64)))
        self._directions = np.concatenate((self._directions, np.full(size, math.nan)))
        self._keep(slice(-_MOST_POINTS, None))

    def see_again(self, stamp: int, which: NDArray[np.bool_]) -> None:
        """Count these points (n,) as seen at that time [ns], unless they were seen later."""
        self._stamps[which] = np.maximum(self._stamps[which], stamp)

    def _keep(self, index: slice | NDArray[np.bool_]) -> None:
        self._points, self._stamps = self._points[index], self._stamps[index]
        self._directions = self._directions[index]


@compiled("float64[:,::1](float64[:,::1], UniTuple(float64, 3), float64)")
def points_near(points: Array, robot: Pose, within: float) -> Array:
    """Return the points (n, 2) [m] up to `within` [m] from the robot, in the robot's frame."""
    x, y, theta = robot
    cosine, sine = math.cos(theta), math.sin(theta)
    local, count = np.empty_like(points), 0
    for i in range(points.shape[0]):
        dx, dy = points[i, 0] - x, points[i, 1] - y
        if dx * dx + dy * dy < within * within:
            local[count, 0], local[count, 1] = cosine * dx + sine * dy, cosine * dy - sine * dx
            count += 1
    return local[:count]


@compiled()
def _range_behind(
    x: float, y: float, starts: Array, angles: Array, ranges: Array, width: float, beside: float
) -> tuple[float, float]:
    """Return how far [m] the beam toward a position continues behind it, and its direction [rad].

    Negative if the beam ends before; NaN if no beam measured it.
    """
    last = ranges.size - 1
    step = (angles[last] - angles[0]) / max(1, last)
    whole = 2.0 * math.pi / abs(step) if step != 0.0 else math.inf
    beam = nearest = last // 2
    dx, dy = math.nan, math.nan
    for _ in range(2):  # the beam gives the start, and the start gives the beam
        if x - starts[beam, 0] == dx and y - starts[beam, 1] == dy:
            break
        dx, dy = x - starts[beam, 0], y - starts[beam, 1]
        off = math.atan2(dy, dx) - angles[beam]
        place = beam + (off / step if step != 0.0 else 0.0)
        nearest = math.floor((place + 0.5) % whole)
        beam = min(last, nearest)
    dx, dy, direction = x - starts[beam, 0], y - starts[beam, 1], angles[beam]
    if math.isinf(width):
        beyond = (nearest - last) * abs(step)
        if step == 0.0 or beyond > (max(beside, abs(step)) if beside > 0.0 else 0.0):
            return math.nan, direction
        return ranges[beam] - math.hypot(dx, dy), direction
    cosine, sine = math.cos(direction), math.sin(direction)
    along, across = cosine * dx + sine * dy, cosine * dy - sine * dx
    if nearest > last or along < 0.0 or abs(across) >= width:
        return math.nan, direction
    return ranges[beam] - along, direction


@compiled("float64[::1](float64[:,::1], float64[:,::1], float64[::1], float64[::1], float64)")
def ranges_behind(
    points: Array, starts: Array, angles: Array, ranges: Array, beside: float
) -> Array:
    """Return how far [m] the beams (`Rays`) toward points (n, 2) continue behind them.

    NaN where nothing was measured. `beside`: see `Clearing`.
    """
    behind = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        x, y = points[i]
        behind[i] = _range_behind(x, y, starts, angles, ranges, math.inf, beside)[0]
    return behind


@compiled(
    "int64(float64[:,::1], int64[::1], float64[::1], float64[:,::1], float64[::1], float64[::1],"
    " int64, float64, float64, float64, float64, float64, float64, float64)"
)
def _clear(
    points: Array,
    stamps: Stamps,
    directions: Array,
    starts: Array,
    angles: Array,
    ranges: Array,
    oldest: int,
    robot_x: float,
    robot_y: float,
    least_behind: float,
    width: float,
    beside: float,
    near: float,
    reach: float,
) -> int:
    """Move the points that are kept to the front, and return their number."""
    kept = 0
    for i in range(points.shape[0]):
        x, y, passed = points[i, 0], points[i, 1], directions[i]
        apart = (x - robot_x) ** 2 + (y - robot_y) ** 2
        if stamps[i] < oldest or apart > reach * reach:
            continue
        if ranges.size:
            behind, direction = _range_behind(x, y, starts, angles, ranges, width, beside)
            if behind >= least_behind:
                if apart > near * near or behind <= _BEHIND:
                    continue
                if math.isnan(passed):
                    passed = direction
                elif math.cos(direction - passed) < math.cos(_ASIDE):
                    continue
        points[kept, 0], points[kept, 1], stamps[kept], directions[kept] = x, y, stamps[i], passed
        kept += 1
    return kept
