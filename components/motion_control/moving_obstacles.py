"""Moving obstacles: track people and other small things, and predict their positions."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND
from cairn.components.motion_control.scan_memory import MAX_RANGE_M
from cairn.planar.compiled import compiled
from cairn.planar.odometry import time_went_back
from cairn.planar.scans import Rays

Array = NDArray[np.float64]

# Hits nearer to one another than this [m] belong to the same thing, which is at most so large [m]
# and stands out from its background by so much [m]: values for people's legs and bodies.
_JOINED, _LARGEST, _BEFORE = 0.2, 0.9, 0.3
_FEWEST = 3  # beams on a thing
_MOST = 64  # maximum number of things per scan
# Beams form a full circle if the gap between last and first is no more than this [rad]: the robot
# may turn during the scan.
_SEAM = 0.2

_SAME = 0.35  # a thing is searched within this distance [m] of its predicted position
# A velocity is estimated from positions over so much time [ns].
_LEAST_WATCHED, _MOST_WATCHED = 350_000_000, 650_000_000
_FORGOTTEN = 350_000_000  # [ns] without a hit
_SLOWEST, _FASTEST = 0.35, 2.5  # [m/s] range of speeds that count as moving
# If the robot turns faster than this [rad/s], all things appear to move, and none is tracked.
_TURNING = 0.8

# Positions are predicted for these times ahead [s], by points so far from the center [m].
_TIMES = np.arange(1, 8) * 0.2
_HALF_WIDTH = 0.15


_Seen = tuple[int, float, float]
"""Time [ns], x and y [m] in the odometry frame."""


@dataclass
class _TrackedThing:
    """The observed positions of one thing, the newest last."""

    places: deque[_Seen] = field(default_factory=lambda: deque(maxlen=8))

    def velocity(self) -> tuple[float, float]:
        """Return the velocity [m/s]; zero as long as it is unknown or unsteady."""
        newest = self.places[-1]
        watched = [p for p in self.places if newest[0] - p[0] <= _MOST_WATCHED]
        if newest[0] - watched[0][0] < _LEAST_WATCHED or len(watched) < 3:
            return 0.0, 0.0
        oldest, middle = watched[0], watched[len(watched) // 2]
        first, then = _speed(oldest, middle), _speed(middle, newest)
        alike = first[0] * then[0] + first[1] * then[1]
        if alike < 0.5 * math.hypot(*first) * math.hypot(*then):
            return 0.0, 0.0
        if min(math.hypot(*first), math.hypot(*then)) < 0.5 * _SLOWEST:
            return 0.0, 0.0
        return _speed(oldest, newest)


def _speed(a: _Seen, b: _Seen) -> tuple[float, float]:
    seconds = (b[0] - a[0]) / SECOND
    return (b[1] - a[1]) / seconds, (b[2] - a[2]) / seconds


class MovingObstacleTracker:
    """Tracks small things from scan to scan."""

    def __init__(self) -> None:
        self._things: list[_TrackedThing] = []
        self._ahead = np.empty((0, 3))
        self._newest = -1

    def add_scan(self, stamp: int, rays: Rays, turn: float) -> Array:
        """Add the scan of `stamp` [ns] while the robot turns by `turn` [rad/s].

        The rays are in the odometry frame. Returns the predicted positions of moving things: x, y
        [m] in the odometry frame and the time ahead [s] (n, 3). A scan that is not newer than the
        last one changes nothing.
        """
        if time_went_back(self._newest, stamp):
            self.forget()
        elif stamp <= self._newest:
            return self._ahead
        self._newest = stamp
        self._ahead = self._expect(stamp, rays, turn)
        return self._ahead

    def _expect(self, stamp: int, rays: Rays, turn: float) -> Array:
        self._things = [t for t in self._things if stamp - t.places[-1][0] < _FORGOTTEN]
        if abs(turn) > _TURNING:
            return np.empty((0, 3))
        seen: list[_TrackedThing] = []
        for x, y in _things(rays).tolist():
            thing = self._expected(stamp, x, y)
            if thing is None:
                thing = _TrackedThing()
            else:
                self._things.remove(thing)
            thing.places.append((stamp, x, y))
            seen.append(thing)
        self._things += seen
        ahead = [_ahead(thing) for thing in seen]
        return np.vstack(ahead) if ahead else np.empty((0, 3))

    def forget(self) -> None:
        """Forget everything, as when odometry restarts."""
        self._things = []
        self._ahead = np.empty((0, 3))

    def _expected(self, stamp: int, x: float, y: float) -> _TrackedThing | None:
        best, least = None, _SAME
        for thing in self._things:
            then, px, py = thing.places[-1]
            vx, vy = thing.velocity()
            seconds = (stamp - then) / SECOND
            apart = math.hypot(px + vx * seconds - x, py + vy * seconds - y)
            if apart < least:
                best, least = thing, apart
        return best


def _ahead(thing: _TrackedThing) -> Array:
    vx, vy = thing.velocity()
    speed = math.hypot(vx, vy)
    if not _SLOWEST <= speed <= _FASTEST:
        return np.empty((0, 3))
    _, x, y = thing.places[-1]
    aside = np.array([-vy, vx]) * (_HALF_WIDTH / speed)
    middles = np.array([x, y]) + _TIMES[:, None] * np.array([vx, vy])
    rows = np.column_stack((middles, _TIMES))
    left, right = rows.copy(), rows.copy()
    left[:, :2] += aside
    right[:, :2] -= aside
    return np.vstack((left, right))


def _things(rays: Rays) -> Array:
    """Return the centers (n, 2) [m] of small things that stand out from their background."""
    told = ~np.isnan(rays.ranges)
    angles, ranges, starts = rays.angles[told], rays.ranges[told], rays.starts[told]
    if ranges.size < _FEWEST:
        return np.empty((0, 2))
    near = np.minimum(ranges, MAX_RANGE_M)
    points = starts + near[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
    span = abs(rays.angles[-1] - rays.angles[0])
    step = span / (rays.angles.size - 1)
    ends = np.array([math.inf, math.inf])
    if span + step > 2.0 * math.pi - _SEAM:  # start between two things, not within one
        begin = int(np.argmax(np.abs(near - np.roll(near, 1)) >= _JOINED))
        ranges, points = np.roll(ranges, -begin), np.roll(points, -begin, axis=0)
        ends = ranges[[-1, 0]]
    found = np.empty((_MOST, 2))
    gaps = np.maximum(_JOINED, 3.0 * step * np.minimum(ranges, MAX_RANGE_M))
    count = _small(np.concatenate((ends[:1], ranges, ends[1:])), points, gaps, found)
    return found[:count]


@compiled()
def _stands_out(ranges: Array, points: Array, first: int, end: int) -> bool:
    """Return whether the points from `first` to before `end` are a small thing that stands out."""
    if end - first < _FEWEST:
        return False
    if min(ranges[first] - ranges[first + 1], ranges[end + 1] - ranges[end]) <= _BEFORE:
        return False
    for i in range(first, end):
        dx, dy = points[i, 0] - points[first, 0], points[i, 1] - points[first, 1]
        if math.hypot(dx, dy) >= _LARGEST:
            return False
    return True


@compiled("int64(float64[::1], float64[:,::1], float64[::1], float64[:,::1])")
def _small(ranges: Array, points: Array, gaps: Array, found: Array) -> int:
    """Fill `found` with the centers of small things that stand out; return their number.

    `ranges` has one more value at each end than `points`; a point nearer than `gaps` to the
    previous one belongs to the same thing.
    """
    size = points.shape[0]
    count = first = 0
    for k in range(1, size + 1):
        if k < size and ranges[k] < MAX_RANGE_M and ranges[k + 1] < MAX_RANGE_M:
            apart = math.hypot(points[k, 0] - points[k - 1, 0], points[k, 1] - points[k - 1, 1])
            if apart < gaps[k]:
                continue
        if count < found.shape[0] and _stands_out(ranges, points, first, k):
            found[count, 0] = points[first:k, 0].mean()
            found[count, 1] = points[first:k, 1].mean()
            count += 1
        first = k
    return count
