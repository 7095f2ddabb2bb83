"""Limits on velocity commands: speed, acceleration and jerk, along one axis and for both.

All functions are pure. Along one axis the state is a velocity [m/s or rad/s] and its rate of change
(`rate`, per second); the ramp is the fastest one with limited rate and limited jerk.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

Velocity = tuple[float, float]
"""Speed ahead [m/s] and turn rate [rad/s]."""

STILL: Velocity = (0.0, 0.0)

# Longest time [s] for which a ramp advances in one step: a process that was held up must not make
# up for it with a leap. Two periods of 20 Hz.
LONGEST_STEP_S = 0.1


@dataclass(frozen=True)
class RampLimits:
    """Most increase and decrease of a velocity's magnitude [1/s^2 of it], and jerk [1/s^3]."""

    acceleration: float
    deceleration: float
    jerk: float


@dataclass(frozen=True)
class SpeedLimits:
    """Fastest speeds ahead and backward [m/s], and turn rate [rad/s]."""

    ahead: float
    backward: float
    turn: float


@dataclass(frozen=True)
class AxisState:
    """Velocity along one axis and its rate of change."""

    velocity: float = 0.0
    rate: float = 0.0


def clamp(command: Velocity, limits: SpeedLimits) -> Velocity:
    """Return a finite command scaled into the limits by one factor, so that its arc is kept."""
    speed, turn = command
    share = 1.0
    for value, most in ((speed, limits.ahead), (-speed, limits.backward), (abs(turn), limits.turn)):
        if value > most:
            share = min(share, most / value)
    return share * speed, share * turn


def ramp(state: AxisState, target: float, limits: RampLimits, seconds: float) -> AxisState:
    """Return the state after some seconds of the fastest change to `target` within the limits.

    The velocity passes zero only after it has stopped there; from rest or on the way to another
    target it never overshoots. Time beyond `LONGEST_STEP_S` does not count.
    """
    seconds = min(max(0.0, seconds), LONGEST_STEP_S)
    velocity, rate, jerk = state.velocity, state.rate, limits.jerk
    if velocity < 0.0 < target or target < 0.0 < velocity:
        target = 0.0
    # Mirror, so that the velocity has to increase: also if it would pass the target now.
    after_easing = velocity + rate * abs(rate) / (2.0 * jerk)
    side = 1.0 if target >= after_easing else -1.0
    rises = side * velocity >= 0.0 and side * target >= 0.0
    most = limits.acceleration if rises else limits.deceleration
    rate, to_go = side * rate, side * (target - velocity)
    peak = min(most, math.sqrt(max(0.0, jerk * to_go + 0.5 * rate * rate)))
    first_s, last_s = abs(peak - rate) / jerk, peak / jerk
    held = to_go - 0.5 * (rate + peak) * first_s - 0.5 * peak * last_s
    held_s = max(0.0, held / peak) if peak > 0.0 else 0.0
    if seconds >= first_s + held_s + last_s:
        return AxisState(target, 0.0)
    if seconds <= first_s:
        change = math.copysign(jerk, peak - rate)
        gained = rate * seconds + 0.5 * change * seconds * seconds
        return AxisState(velocity + side * gained, side * (rate + change * seconds))
    gained, left_s = 0.5 * (rate + peak) * first_s, seconds - first_s
    if left_s <= held_s:
        return AxisState(velocity + side * (gained + peak * left_s), side * peak)
    gained, left_s = gained + peak * held_s, left_s - held_s
    gained += peak * left_s - 0.5 * jerk * left_s * left_s
    return AxisState(velocity + side * gained, side * (peak - jerk * left_s))


def brake(velocity: float, target: float, deceleration: float | None, seconds: float) -> AxisState:
    """Return the state while the velocity falls toward `target` as in an emergency.

    `target` is nearer to zero than the velocity, and has its sign. Without a deceleration
    the velocity falls at once: the base brakes as hard as it can. The jerk is not limited.
    """
    if deceleration is None:
        return AxisState(target)
    change = deceleration * min(max(0.0, seconds), LONGEST_STEP_S)
    if velocity > target:
        return AxisState(max(target, velocity - change))
    return AxisState(min(target, velocity + change))
