"""Velocity limits: the limits of the robot, and commands within them that always allow to stop."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cairn.components.motion_control.collision_checks import free_arc
from cairn.components.motion_control.scan_memory import NearbyObstacles

# Where no other reason is given, these constants were chosen by hand; `lab/constants.yaml`
# has the effect of half and double.

# In a curve the robot uses this share of its turn rate [1]; the rest corrects its heading.
_TURN_SHARE = 0.9
# A turn on the spot is at least so fast [rad/s], or as the angle to go per second: slower ones
# stall.
_LEAST_TURN = 0.1
# In planned motions an obstacle keeps at least this distance [m] to the robot, or this share of the
# margin if that is less: the noise of a scan must not count as a contact.
_CONTACT_M, _CONTACT_SHARE = 0.01, 0.4
# Curvatures [1/m], angles [rad] and speeds [m/s] below these count as zero.
_STRAIGHT, _NO_ANGLE, _NO_SPEED = 1e-6, 1e-3, 1e-3


@dataclass(frozen=True)
class MotionLimits:
    """Size [m], speeds [m/s, rad/s] and accelerations [m/s^2, rad/s^2] of a round robot.

    `margin` [m] is kept free around the robot, and `stop_distance` [m] before an obstacle on the
    path. Full speed requires `full_speed_clearance` [m] beside the robot; with less clearance it
    slows down to `creep_speed`. Stopping relies on `braking` and `turn_braking` after `latency`
    [s]; `lookahead` [s] is the driving time to the pursued point on the path.
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

    def speed_to_stop_in(self, distance: float, late_s: float = 0.0) -> float:
        """Return the speed [m/s] from which the robot stops within a distance [m].

        It begins to brake `late_s` [s] later than usual.
        """
        return min(self.speed, _stopping(distance, self.braking, self.latency + late_s))

    def speed_beside(self, clearance: float) -> float:
        """Return the speed [m/s] for a clearance [m] between robot and obstacle."""
        share = (clearance - self.margin) / (self.full_speed_clearance - self.margin)
        return self.creep_speed + (self.speed - self.creep_speed) * min(1.0, max(0.0, share))

    def speed_in(self, curvature: float) -> float:
        """Return the speed [m/s] at which the robot can follow a curvature [1/m]."""
        bend = abs(curvature)
        if bend < _STRAIGHT:
            return self.speed
        sideways = math.sqrt(self.acceleration / bend)
        return min(self.speed, sideways, _TURN_SHARE * self.turn_speed / bend)

    def turn_rate_for(self, angle: float) -> float:
        """Return the turn rate [rad/s] on the spot with that angle [rad] to go."""
        size = abs(angle)
        if size < _NO_ANGLE:
            return 0.0
        turn = _stopping(size, self.turn_braking, self.latency)
        return math.copysign(min(self.turn_speed, max(turn, min(_LEAST_TURN, size))), angle)

    @property
    def keepout_radius(self) -> float:
        """Return the radius [m] of the circle that is kept free around the robot's center."""
        return self.radius + self.margin

    @property
    def minimum_radius(self) -> float:
        """Return the radius [m] of the circle that suffices where there is no other path."""
        return self.radius + 0.5 * self.margin

    @property
    def contact_radius(self) -> float:
        """Return the least distance [m] of an obstacle to the robot's center in planned motions."""
        return self.radius + min(_CONTACT_M, _CONTACT_SHARE * self.margin)


def _stopping(distance: float, deceleration: float, latency: float) -> float:
    if distance <= 0.0:
        return 0.0
    lag = deceleration * latency
    return math.sqrt(lag * lag + 2.0 * deceleration * distance) - lag


@dataclass(frozen=True)
class VelocityTarget:
    """A velocity to reach: speed [m/s] and curvature [1/m], or a turn on the spot [rad/s].

    `blocked` is the reason why no motion is possible; empty otherwise.
    """

    speed: float = 0.0
    curvature: float = 0.0
    turn: float = 0.0
    blocked: str = ""


STAND_STILL = VelocityTarget()

Command = tuple[float, float]
"""Speed ahead [m/s] and turn rate [rad/s]."""

STAND: Command = (0.0, 0.0)

# A command may be ahead of the measured velocity by this time [s] of acceleration: the delay of the
# base (`latency` 0.15 s) twice.
_LEAD_S = 0.3
# The velocity changes by at most and at least so much time [s] of acceleration per command: after a
# pause no more than two periods of 20 Hz, and at once when a scan follows a timed command.
_LONGEST_STEP_S, _SHORTEST_STEP_S = 0.12, 0.005
_TOUCH = 0.01  # [m] of free path that is left: the noise of a scanner


class CommandLimiter:
    """Limits the change from one command to the next by the accelerations."""

    def __init__(self, limits: MotionLimits) -> None:
        self._limits = limits
        self._command = STAND
        self._at = 0

    def stop(self, now: int) -> Command:
        """Command to stand at once: the base brakes as hard as it can."""
        self._command, self._at = STAND, now
        return STAND

    def command(
        self,
        target: VelocityTarget,
        now: int,
        measured: Command,
        obstacles: NearbyObstacles,
        late_s: float = 0.0,
    ) -> Command:
        """Return the next command at `now` [ns], while the robot moves as `measured`.

        If odometry is late by `late_s` [s], the robot may have moved on for so long, so it drives
        more slowly toward obstacles.
        """
        limits = self._limits
        step = min(_LONGEST_STEP_S, max(_SHORTEST_STEP_S, (now - self._at) / 1e9))
        speed, turn = self._command
        lead, turn_lead = limits.acceleration * _LEAD_S, limits.turn_acceleration * _LEAD_S
        speed = min(measured[0] + lead, max(measured[0] - lead, speed))
        turn = min(measured[1] + turn_lead, max(measured[1] - turn_lead, turn))
        change, turn_change = limits.acceleration * step, limits.turn_acceleration * step
        forward = min(speed + change, max(speed - change, target.speed))
        desired = target.turn + target.curvature * forward
        desired = min(limits.turn_speed, max(-limits.turn_speed, desired))
        turned = min(turn + turn_change, max(turn - turn_change, desired))
        forward = self._guarded(forward, turned, obstacles, late_s)
        self._command, self._at = (forward, turned), now
        return self._command

    def _guarded(
        self, forward: float, turn: float, obstacles: NearbyObstacles, late_s: float
    ) -> float:
        """Return the speed from which the robot can still stop before obstacles on this arc."""
        limits = self._limits
        if abs(forward) < _NO_SPEED or (forward > 0.0 and not obstacles.ground_seen_ahead):
            return 0.0
        points = obstacles.points
        if forward < 0.0:
            points = points * np.array([-1.0, 1.0])
            turn = -turn
        bend = turn / abs(forward)
        free = free_arc(points, bend, limits.minimum_radius, limits.contact_radius)
        most = limits.speed_to_stop_in(free - _TOUCH, late_s)
        return math.copysign(min(abs(forward), most), forward)
