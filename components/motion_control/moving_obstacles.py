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

# Where no other reason is given, these constants were chosen by hand; `lab/constants.yaml`
# has the effect of half and double. docs/benchmarks.md has the results in the hall with ten walking
# people.

# Hits nearer to one another than this [m] belong to the same thing, which is at most so large [m]
# and stands out from its background by so much [m]; people fit these sizes.
_MAX_GAP_M, _MAX_SIZE_M, _MIN_PROMINENCE_M = 0.2, 0.9, 0.3
_MIN_BEAMS = 3  # beams on a thing: one or two may be noise at an edge
_MAX_THINGS = 64  # maximum number of things per scan; limits the time that a scan takes
# Beams form a full circle if the gap between last and first is no more than this [rad]: the robot
# may turn during the scan.
_SEAM_RAD = 0.2

# A thing is searched within this distance [m] of its predicted position: one that was not seen
# moving yet walks 0.25 m between two scans at 2.5 m/s and 10 Hz.
# Half of it changes nothing in the hall with ten people (`--goals 3 --seeds 0..1`).
_MATCH_M = 0.35
# A velocity is estimated from positions over so much time [ns]: four to seven scans at 10 Hz.
_MIN_WATCHED_NS, _MAX_WATCHED_NS = 350_000_000, 650_000_000
_FORGOTTEN_NS = 350_000_000  # [ns] without a hit: three scans at 10 Hz
# Range of speeds that count as moving [m/s]: slower ones may be noise of the hits, and people
# seldom run indoors.
_SLOWEST, _FASTEST = 0.35, 2.5
# Two halves of a motion are steady if their directions agree by this cosine (60 degrees), and each
# is at least this share of the slowest motion [1].
_STEADY, _STEADY_SHARE = 0.5, 0.5
# If the robot turns faster than this [rad/s], all things appear to move, and none is tracked.
_MAX_TURN = 0.8

# Positions are predicted for these times ahead [s], in which the robot can stop from 0.6 m/s, by
# points so far from the center [m].
_PREDICTION_TIMES = np.arange(1, 8) * 0.2
_HALF_WIDTH = 0.15


_Observation = tuple[int, float, float]
"""Time [ns], x and y [m] in the odometry frame."""


@dataclass
class _TrackedThing:
    """The observed positions of one thing, the newest last."""

    positions: deque[_Observation] = field(default_factory=lambda: deque(maxlen=8))

    def velocity(self) -> tuple[float, float]:
        """Return the velocity [m/s]; zero as long as it is unknown or unsteady."""
        newest = self.positions[-1]
        watched = [p for p in self.positions if newest[0] - p[0] <= _MAX_WATCHED_NS]
        if newest[0] - watched[0][0] < _MIN_WATCHED_NS or len(watched) < 3:
            return 0.0, 0.0
        oldest, middle = watched[0], watched[len(watched) // 2]
        first, then = _speed(oldest, middle), _speed(middle, newest)
        alike = first[0] * then[0] + first[1] * then[1]
        if alike < _STEADY * math.hypot(*first) * math.hypot(*then):
            return 0.0, 0.0
        if min(math.hypot(*first), math.hypot(*then)) < _STEADY_SHARE * _SLOWEST:
            return 0.0, 0.0
        return _speed(oldest, newest)


def _speed(a: _Observation, b: _Observation) -> tuple[float, float]:
    seconds = (b[0] - a[0]) / SECOND
    return (b[1] - a[1]) / seconds, (b[2] - a[2]) / seconds


class MovingObstacleTracker:
    """Tracks small things from scan to scan."""

    def __init__(self) -> None:
        self._tracked: list[_TrackedThing] = []
        self._predictions = np.empty((0, 3))
        self._newest = -1

    def moving(self) -> Array:
        """Return what moves, as last seen: x, y [m] and direction of motion [rad] (n, 3).

        Positions and directions are in the odometry frame.
        """
        rows = []
        for thing in self._tracked:
            vx, vy = thing.velocity()
            if _SLOWEST <= math.hypot(vx, vy) <= _FASTEST:
                rows.append((*thing.positions[-1][1:], math.atan2(vy, vx)))
        return np.array(rows).reshape(-1, 3)

    def add_scan(self, stamp: int, rays: Rays, turn: float) -> Array:
        """Add the scan of `stamp` [ns] while the robot turns by `turn` [rad/s].

        The rays are in the odometry frame. Returns the predicted positions of moving things: x, y
        [m] in the odometry frame and the time ahead [s] (n, 3). A scan that is not newer than the
        last one changes nothing.
        """
        if time_went_back(self._newest, stamp):
            self.forget()
        elif stamp <= self._newest:
            return self._predictions
        self._newest = stamp
        self._predictions = self._update_things(stamp, rays, turn)
        return self._predictions

    def _update_things(self, stamp: int, rays: Rays, turn: float) -> Array:
        self._tracked = [t for t in self._tracked if stamp - t.positions[-1][0] < _FORGOTTEN_NS]
        if abs(turn) > _MAX_TURN:
            return np.empty((0, 3))
        seen: list[_TrackedThing] = []
        for x, y in _detect_things(rays).tolist():
            thing = self._match(stamp, x, y)
            if thing is None:
                thing = _TrackedThing()
            else:
                self._tracked.remove(thing)
            thing.positions.append((stamp, x, y))
            seen.append(thing)
        self._tracked += seen
        ahead = [_predict(thing) for thing in seen]
        return np.vstack(ahead) if ahead else np.empty((0, 3))

    def forget(self) -> None:
        """Forget everything, as when odometry restarts."""
        self._tracked = []
        self._predictions = np.empty((0, 3))

    def _match(self, stamp: int, x: float, y: float) -> _TrackedThing | None:
        best, least = None, _MATCH_M
        for thing in self._tracked:
            then, px, py = thing.positions[-1]
            vx, vy = thing.velocity()
            seconds = (stamp - then) / SECOND
            apart = math.hypot(px + vx * seconds - x, py + vy * seconds - y)
            if apart < least:
                best, least = thing, apart
        return best


def _predict(thing: _TrackedThing) -> Array:
    vx, vy = thing.velocity()
    speed = math.hypot(vx, vy)
    if not _SLOWEST <= speed <= _FASTEST:
        return np.empty((0, 3))
    _, x, y = thing.positions[-1]
    aside = np.array([-vy, vx]) * (_HALF_WIDTH / speed)
    middles = np.array([x, y]) + _PREDICTION_TIMES[:, None] * np.array([vx, vy])
    rows = np.column_stack((middles, _PREDICTION_TIMES))
    left, right = rows.copy(), rows.copy()
    left[:, :2] += aside
    right[:, :2] -= aside
    return np.vstack((left, right))


def _detect_things(rays: Rays) -> Array:
    """Return the centers (n, 2) [m] of small things that stand out from their background."""
    measured = ~np.isnan(rays.ranges)
    angles, ranges, starts = rays.angles[measured], rays.ranges[measured], rays.starts[measured]
    if ranges.size < _MIN_BEAMS:
        return np.empty((0, 2))
    near = np.minimum(ranges, MAX_RANGE_M)
    points = starts + near[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
    span = abs(rays.angles[-1] - rays.angles[0])
    step = span / (rays.angles.size - 1)
    ends = np.array([math.inf, math.inf])
    if span + step > 2.0 * math.pi - _SEAM_RAD:  # start between two things, not within one
        begin = int(np.argmax(np.abs(near - np.roll(near, 1)) >= _MAX_GAP_M))
        ranges, points = np.roll(ranges, -begin), np.roll(points, -begin, axis=0)
        ends = ranges[[-1, 0]]
    found = np.empty((_MAX_THINGS, 2))
    gaps = np.maximum(_MAX_GAP_M, 3.0 * step * np.minimum(ranges, MAX_RANGE_M))
    count = _find_small(np.concatenate((ends[:1], ranges, ends[1:])), points, gaps, found)
    return found[:count]


@compiled()
def _stands_out(ranges: Array, points: Array, first: int, end: int) -> bool:
    """Return whether the points from `first` to before `end` are a small thing that stands out."""
    if end - first < _MIN_BEAMS:
        return False
    if min(ranges[first] - ranges[first + 1], ranges[end + 1] - ranges[end]) <= _MIN_PROMINENCE_M:
        return False
    for i in range(first, end):
        dx, dy = points[i, 0] - points[first, 0], points[i, 1] - points[first, 1]
        if math.hypot(dx, dy) >= _MAX_SIZE_M:
            return False
    return True


@compiled("int64(float64[::1], float64[:,::1], float64[::1], float64[:,::1])")
def _find_small(ranges: Array, points: Array, gaps: Array, found: Array) -> int:
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
