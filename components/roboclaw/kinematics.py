"""What wheels do when a differential base moves: twists, wheel speeds, encoder counts.

Frames as REP 103 has them: x ahead, turns counterclockwise. With wheels at distance b,
forward speed v and turn w: v_left = v - w b/2, v_right = v + w b/2 (Siegwart and Nourbakhsh,
Introduction to Autonomous Mobile Robots, section 3.2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Channel = Literal["m1", "m2"]
Pair = tuple[float, float]
"""Of the left and the right wheel, or forward [m/s] and turn [rad/s]."""

_WRAP = 1 << 32


@dataclass(frozen=True)
class Geometry:
    """The base's measures, and which channel of the controller drives which wheel."""

    radius: float
    """Of the left wheel [m]."""
    radius_ratio: float
    """Radius of the right wheel to that of the left one [1]."""
    separation: float
    """Distance of the points where the wheels touch the floor [m]."""
    counts_per_turn: float
    """Encoder counts, four to a line, for a turn of the wheel: gear included."""
    left: Channel
    left_inverted: bool
    right_inverted: bool

    def wheel_speeds(self, forward: float, turn: float) -> Pair:
        """Speeds [m/s] of the left and the right wheel along the floor."""
        half = 0.5 * turn * self.separation
        return forward - half, forward + half

    def twist(self, left: float, right: float) -> Pair:
        """Forward [m/s or m] and turn [rad/s or rad] of wheels' speeds [m/s] or ways [m]."""
        return 0.5 * (left + right), (right - left) / self.separation

    def channel_counts(self, left: float, right: float) -> tuple[int, int]:
        """Counts [1/s] for M1 and M2 of wheels' speeds [m/s]."""
        scales = self._counts_per_meter()
        wheels = (round(left * scales[0]), round(right * scales[1]))
        return wheels if self.left == "m1" else (wheels[1], wheels[0])

    def wheel_ways(self, first: int, second: int) -> Pair:
        """Ways [m] of the left and the right wheel of counts of M1 and M2."""
        left, right = (first, second) if self.left == "m1" else (second, first)
        scales = self._counts_per_meter()
        return left / scales[0], right / scales[1]

    def fastest_wheels(self, first: int, second: int) -> float:
        """The speed [m/s] that both wheels reach, where M1 and M2 reach these [counts/s]."""
        return min(abs(way) for way in self.wheel_ways(first, second))

    def _counts_per_meter(self) -> Pair:
        left = self.counts_per_turn / (2.0 * math.pi * self.radius)
        right = left / self.radius_ratio
        return (
            -left if self.left_inverted else left,
            -right if self.right_inverted else right,
        )


@dataclass(frozen=True)
class Limits:
    """How fast the base may move [m/s, rad/s] and become faster or slower [m/s^2, rad/s^2]."""

    speed: float
    turn: float
    acceleration: float
    turn_acceleration: float

    @property
    def slowing_s(self) -> float:
        """The longest that slowing down to rest takes [s]."""
        return max(self.speed / self.acceleration, self.turn / self.turn_acceleration)

    def wheel_acceleration(self, separation: float) -> float:
        """The most that a wheel is ever asked for [m/s^2]."""
        return self.acceleration + 0.5 * separation * self.turn_acceleration


def limited(forward: float, turn: float, limits: Limits, wheel: Pair, fastest_wheel: float) -> Pair:
    """A twist within the limits, on the same curve: both speeds are scaled by one factor.

    `wheel`: the speeds [m/s] that it asks of the wheels, which go at most `fastest_wheel`.
    """
    share = min(
        1.0,
        _share(forward, limits.speed),
        _share(turn, limits.turn),
        *(_share(one, fastest_wheel) for one in wheel),
    )
    return share * forward, share * turn


def approached(now: Pair, wanted: Pair, limits: Limits, seconds: float) -> Pair:
    """The twist after so many seconds on the way from one to another.

    Both speeds take the same share of the way: from rest, the curve is the one wanted.
    """
    ahead, round_ = wanted[0] - now[0], wanted[1] - now[1]
    share = min(
        1.0,
        _share(ahead, limits.acceleration * seconds),
        _share(round_, limits.turn_acceleration * seconds),
    )
    return now[0] + share * ahead, now[1] + share * round_


def counted(before: int, after: int) -> int:
    """Counts between two readings of a 32 bit counter, which wraps: less than 2^31 either way."""
    return (after - before + _WRAP // 2) % _WRAP - _WRAP // 2


def _share(value: float, most: float) -> float:
    return most / abs(value) if abs(value) > most else 1.0
