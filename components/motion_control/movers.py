"""People and other small things that move, and where they will be in a moment."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cairn.clock import SECOND
from components.motion_control.seen_space import REACH
from components.motion_control.sweep import Sweep
from planar.compiled import compiled
from planar.odometry import began_anew

Array = NDArray[np.float64]

# Beams whose hits are so near one another [m] see the same thing, at most so large [m]; before its
# background it stands out by so much [m].
_JOINED, _LARGEST, _BEFORE = 0.2, 0.9, 0.3
_FEWEST = 3  # beams
_MOST = 64  # things that are looked at

_SAME = 0.35  # a thing is looked for so far [m] from where it is expected
_WATCHED_S = (0.35, 0.65)  # a speed is told by the way made in so much time [s]
_FORGOTTEN_S = 0.35
_SLOWEST, _FASTEST = 0.35, 2.5  # what counts as moving [m/s]
# Robots that turn faster [rad/s] than this see all things move a little.
_TURNING = 0.8

# Where a mover will be is told for these times ahead [s], by points so far from its middle [m].
_TIMES = np.arange(1, 8) * 0.2
_HALF_WIDTH = 0.15


_Seen = tuple[float, float, float]
"""Time [s], x and y [m] in the odometry frame."""


@dataclass
class _Thing:
    """Where one thing was seen, the newest last."""

    places: deque[_Seen] = field(default_factory=lambda: deque(maxlen=8))

    def velocity(self) -> tuple[float, float]:
        """Velocity [m/s], zero as long as it is not known or not steady."""
        newest = self.places[-1]
        watched = [p for p in self.places if newest[0] - p[0] <= _WATCHED_S[1]]
        if newest[0] - watched[0][0] < _WATCHED_S[0] or len(watched) < 3:
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
    seconds = b[0] - a[0]
    return (b[1] - a[1]) / seconds, (b[2] - a[2]) / seconds


class Movers:
    """Follows small things from scan to scan."""

    def __init__(self) -> None:
        self._things: list[_Thing] = []
        self._ahead = np.empty((0, 3))
        self._newest = -1
        self._found = np.empty((_MOST, 2))

    def see(self, stamp: int, sweep: Sweep, turn: float) -> Array:
        """Take the scan of `stamp` [ns], when the robot turned by `turn` [rad/s].

        Returns where movers will be in the next moments: x, y [m] in the odometry frame and how
        far ahead that is [s] (n, 3). A scan no later than the last one tells nothing new.
        """
        if began_anew(self._newest, stamp):
            self.forget()
        elif stamp <= self._newest:
            return self._ahead
        self._newest = stamp
        self._ahead = self._expect(stamp / SECOND, sweep, turn)
        return self._ahead

    def _expect(self, time: float, sweep: Sweep, turn: float) -> Array:
        self._things = [t for t in self._things if time - t.places[-1][0] < _FORGOTTEN_S]
        if abs(turn) > _TURNING or sweep.ranges.size < _FEWEST:
            return np.empty((0, 3))
        count = _things(
            sweep.ranges,
            sweep.first_angle,
            sweep.step,
            *sweep.start,
            *sweep.end,
            sweep.is_whole_turn,
            self._found,
        )
        seen: list[_Thing] = []
        for x, y in self._found[:count].tolist():
            thing = self._expected(time, x, y)
            if thing is None:
                thing = _Thing()
            else:
                self._things.remove(thing)
            thing.places.append((time, x, y))
            seen.append(thing)
        self._things += seen
        ahead = [_ahead(thing) for thing in seen]
        return np.vstack(ahead) if ahead else np.empty((0, 3))

    def forget(self) -> None:
        """Forget all, as when odometry begins anew."""
        self._things = []
        self._ahead = np.empty((0, 3))

    def _expected(self, time: float, x: float, y: float) -> _Thing | None:
        best, least = None, _SAME
        for thing in self._things:
            then, px, py = thing.places[-1]
            vx, vy = thing.velocity()
            apart = math.hypot(px + vx * (time - then) - x, py + vy * (time - then) - y)
            if apart < least:
                best, least = thing, apart
        return best


def _ahead(thing: _Thing) -> Array:
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


@compiled(
    "int64(float64[::1], float64, float64, float64, float64, float64, float64, float64, float64,"
    " boolean, float64[:,::1])"
)
def _things(
    ranges: Array,
    first: float,
    step: float,
    x0: float,
    y0: float,
    theta0: float,
    x1: float,
    y1: float,
    theta1: float,
    closed: bool,
    found: Array,
) -> int:
    """Middles of small things that stand before their background; their number."""
    beams = ranges.size
    turned = (theta1 - theta0 + math.pi) % (2.0 * math.pi) - math.pi
    begin = 0
    if closed:  # not in the middle of a thing
        while begin < beams - 1 and abs(ranges[begin] - ranges[begin - 1]) < _JOINED:
            begin += 1
    count = 0
    members = 0
    sum_x, sum_y, first_x, first_y, last_x, last_y = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    largest = 0.0
    last_range = math.inf
    before, foremost = math.inf, False
    for k in range(beams + 1):
        i = (begin + k) % beams
        span = ranges[i] if k < beams or closed else math.inf
        if math.isnan(span):
            continue
        share = i / max(1, beams - 1)
        angle = theta0 + share * turned + first + i * step
        hit = span < REACH
        x = y = 0.0
        if hit:
            x = x0 + share * (x1 - x0) + span * math.cos(angle)
            y = y0 + share * (y1 - y0) + span * math.sin(angle)
        gap = max(_JOINED, 3.0 * abs(step) * min(span, REACH))
        joined = members > 0 and hit and k < beams and math.hypot(x - last_x, y - last_y) < gap
        if members > 0 and not joined:
            stands_out = foremost and span > last_range + _BEFORE
            if stands_out and members >= _FEWEST and largest < _LARGEST and count < _MOST:
                found[count, 0], found[count, 1] = sum_x / members, sum_y / members
                count += 1
            members = 0
        if k == beams:
            break
        if hit:
            if members == 0:
                foremost = before > span + _BEFORE
                sum_x, sum_y, largest = 0.0, 0.0, 0.0
                first_x, first_y = x, y
            sum_x += x
            sum_y += y
            largest = max(largest, math.hypot(x - first_x, y - first_y))
            members += 1
            last_x, last_y, last_range = x, y, span
        before = span
    return count
