"""What the robot is and can do, and how fast it may be before something."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Size [m], speeds [m/s, rad/s] and accelerations [m/s^2, rad/s^2] of a round robot.

    `margin` [m] is kept around the robot, and `stop_distance` [m] before what blocks the path.
    `full_speed_clearance` [m] to its side it needs for full speed; with less it is slower, down to
    `creep_speed`. `braking` and `turn_braking` are counted on where it is to stop, after
    `latency` [s]; `lookahead` [s] is how far ahead on the path it aims.
    """

    radius: float
    margin: float
    stop_distance: float
    full_speed_clearance: float
    speed: float
    creep_speed: float
    turn_speed: float
    acceleration: float
    turn_acceleration: float
    braking: float
    turn_braking: float
    latency: float
    lookahead: float

    def speed_before(self, distance: float) -> float:
        """The speed [m/s] from which it stops within a distance [m]."""
        return min(self.speed, _stopping(distance, self.braking, self.latency))

    def speed_beside(self, clearance: float) -> float:
        """The speed [m/s] that a clearance [m] between robot and obstacle allows."""
        share = (clearance - self.margin) / (self.full_speed_clearance - self.margin)
        return self.creep_speed + (self.speed - self.creep_speed) * min(1.0, max(0.0, share))

    def speed_in(self, curvature: float) -> float:
        """The speed [m/s] at which it can follow a curvature [1/m]."""
        bend = abs(curvature)
        if bend < 1e-6:
            return self.speed
        sideways = math.sqrt(self.acceleration / bend)
        return min(self.speed, sideways, 0.9 * self.turn_speed / bend)

    def turn_by(self, angle: float) -> float:
        """The speed [rad/s] of a turn on the spot that has that angle [rad] to go."""
        size = abs(angle)
        if size < 1e-3:
            return 0.0
        turn = _stopping(size, self.turn_braking, self.latency)
        return math.copysign(min(self.turn_speed, max(turn, min(0.1, size))), angle)

    @property
    def kept(self) -> float:
        """Radius [m] of the circle that is kept free around the robot's center."""
        return self.radius + self.margin

    @property
    def tight(self) -> float:
        """Radius [m] of the circle that suffices where there is no other way."""
        return self.radius + 0.5 * self.margin

    @property
    def touching(self) -> float:
        """Distance [m] of what almost touches the robot to its center: never less on purpose."""
        return self.radius + min(0.01, 0.4 * self.margin)


def _stopping(distance: float, deceleration: float, latency: float) -> float:
    if distance <= 0.0:
        return 0.0
    lag = deceleration * latency
    return math.sqrt(lag * lag + 2.0 * deceleration * distance) - lag
