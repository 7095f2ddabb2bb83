"""Kinematics of a differential base: velocities, wheel speeds, encoder counts, and their limits.

Frames as in REP 103: x forward, turns counterclockwise. With wheels at distance b, forward speed v
and turn rate w: v_left = v - w b/2, v_right = v + w b/2 (Siegwart and Nourbakhsh, Introduction to
Autonomous Mobile Robots, section 3.2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

MotorChannel = Literal["m1", "m2"]
Pair = tuple[float, float]
"""Of the left and the right wheel, or forward [m/s] and turn rate [rad/s]."""

_WRAP = 1 << 32


@dataclass(frozen=True)
class WheelGeometry:
    """The base's dimensions, and which channel of the controller drives which wheel."""

    radius: float
    """Of the left wheel [m]."""
    radius_ratio: float
    """Radius of the right wheel divided by that of the left one [1]."""
    separation: float
    """Distance of the points where the wheels touch the floor [m]."""
    counts_per_turn: float
    """Encoder counts, four per line, for one turn of the wheel, gear included."""
    left: MotorChannel
    left_inverted: bool
    right_inverted: bool

    def wheel_speeds(self, forward: float, turn: float) -> Pair:
        """Return the speeds [m/s] of the left and the right wheel along the floor."""
        half = 0.5 * turn * self.separation
        return forward - half, forward + half

    def body_motion(self, left: float, right: float) -> Pair:
        """Return forward [m/s or m] and turn [rad/s or rad] for wheel speeds or distances."""
        return 0.5 * (left + right), (right - left) / self.separation

    def channel_counts(self, left: float, right: float) -> tuple[int, int]:
        """Return the counts [1/s] of M1 and M2 for wheel speeds [m/s]."""
        scales = self._counts_per_meter()
        wheels = (round(left * scales[0]), round(right * scales[1]))
        return wheels if self.left == "m1" else (wheels[1], wheels[0])

    def wheel_distances(self, first: int, second: int) -> Pair:
        """Return the distances [m] of the left and the right wheel for counts of M1 and M2."""
        left, right = (first, second) if self.left == "m1" else (second, first)
        scales = self._counts_per_meter()
        return left / scales[0], right / scales[1]

    def fastest_wheels(self, first: int, second: int) -> float:
        """Return the speed [m/s] that both wheels reach if M1 and M2 reach these [counts/s]."""
        return min(abs(speed) for speed in self.wheel_distances(first, second))

    def _counts_per_meter(self) -> Pair:
        left = self.counts_per_turn / (2.0 * math.pi * self.radius)
        right = left / self.radius_ratio
        return (
            -left if self.left_inverted else left,
            -right if self.right_inverted else right,
        )


@dataclass(frozen=True)
class BaseLimits:
    """Highest speeds [m/s, rad/s] and accelerations [m/s^2, rad/s^2] of the base."""

    speed: float
    turn: float
    acceleration: float
    turn_acceleration: float

    @property
    def stopping_s(self) -> float:
        """The longest time that slowing down to rest takes [s]."""
        return max(self.speed / self.acceleration, self.turn / self.turn_acceleration)

    def wheel_acceleration(self, separation: float) -> float:
        """Return the highest acceleration of a single wheel [m/s^2]."""
        return self.acceleration + 0.5 * separation * self.turn_acceleration


def limit_velocity(
    forward: float, turn: float, limits: BaseLimits, wheel_speeds: Pair, fastest_wheel: float
) -> Pair:
    """Scale a velocity into the limits by one factor for both speeds, so the curve is kept.

    `wheel_speeds`: those of the velocity [m/s]; the wheels reach at most `fastest_wheel`.
    """
    share = min(
        1.0,
        _share(forward, limits.speed),
        _share(turn, limits.turn),
        *(_share(speed, fastest_wheel) for speed in wheel_speeds),
    )
    return share * forward, share * turn


def ramp_velocity(current: Pair, target: Pair, limits: BaseLimits, seconds: float) -> Pair:
    """Return the velocity after a time [s] of accelerating from the current to the target one.

    Both speeds change by the same share: from rest, the curve is that of the target.
    """
    forward, turn = target[0] - current[0], target[1] - current[1]
    share = min(
        1.0,
        _share(forward, limits.acceleration * seconds),
        _share(turn, limits.turn_acceleration * seconds),
    )
    return current[0] + share * forward, current[1] + share * turn


def count_difference(before: int, after: int) -> int:
    """Return the counts between two readings of a 32-bit counter that wraps, within +-2^31."""
    return (after - before + _WRAP // 2) % _WRAP - _WRAP // 2


def _share(value: float, limit: float) -> float:
    return limit / abs(value) if abs(value) > limit else 1.0
