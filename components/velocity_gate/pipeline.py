"""The way of a command through the gate: speed limits, slow-down, ramp, check of obstacles.

It knows neither bus nor clock.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cairn.components.velocity_gate.collision_monitor import Array, Footprint, allowed_share
from cairn.components.velocity_gate.config import VelocityGateConfig
from cairn.components.velocity_gate.limiter import STILL, AxisState, Velocity, brake, clamp, ramp
from cairn.components.velocity_gate.recent_sweeps import RecentSweeps
from cairn.planar.poses import Pose

# The measured motion counts above this speed [m/s]; wheels report noise below it.
_MOVES = 0.05
# The robot reverses where this share of the ground [1] was seen over this distance [m] at least:
# single beams fail, and motion control requires 0.8 over up to 0.3 m.
_SEEN_SHARE, _SEEN_M = 0.6, 0.1
# Directions, of the ground behind, that are looked up [1], and the distance between them [m].
_ACROSS, _STEP_M = 7, 0.05
# Below these [m/s], [rad/s] a command counts as standing.
_STANDS, _TURNS_NOT = 0.01, 0.02


@dataclass(frozen=True)
class Surroundings:
    """What the gate knows around the robot now: scans, and the robot's pose in their frame.

    `scan_age_s` [s] is that of the newest scan; `measured` the velocity by odometry. For
    `odometry_late_s` [s] the robot may have moved otherwise than `robot` assumes.
    """

    scans: RecentSweeps
    robot: Pose
    scan_age_s: float
    measured: Velocity
    odometry_late_s: float = 0.0

    @property
    def delay_s(self) -> float:
        """How long [s] the robot may have moved since what is known."""
        return self.scan_age_s + self.odometry_late_s


@dataclass(frozen=True)
class GateOutput:
    """The command to the base, the limits that were active, and what blocks it, if anything."""

    command: Velocity
    limits: tuple[str, ...] = ()
    blocked: str = ""


class CommandPipeline:
    """Turns the desired velocity into the command to the base, step by step.

    Its state is the last command; `command` and `step` are its only ways in and out.
    """

    def __init__(self, config: VelocityGateConfig) -> None:
        self._config = config
        self._speeds = config.speed_limits()
        self._ramps = config.ramp_limits()
        self._ability = config.stopping_ability()
        outline = config.outline()
        self._stop_zone = outline.inflated(config.stop_margin)
        self._slow_zone = outline.inflated(config.slowdown_margin)
        self._reach = self._slow_zone.reach
        self._behind = _places_behind(outline)
        self._axes = AxisState(), AxisState()

    @property
    def command(self) -> Velocity:
        """The last command to the base."""
        return self._axes[0].velocity, self._axes[1].velocity

    def halt(self, seconds: float) -> Velocity:
        """Return the next command of an emergency: standing, after the emergency deceleration."""
        self._brake_to(STILL, seconds)
        return self.command

    def step(
        self,
        desired: Velocity,
        seconds: float,
        around: Surroundings | None,
        *,
        operator: bool = False,
    ) -> GateOutput:
        """Return the next command, `seconds` after the last one.

        Args:
            desired: The finite velocity that the driving source wants.
            seconds: Time since the last step [s].
            around: None if obstacles are not checked.
            operator: Whether a person drives, and sees behind the robot.

        """
        limits: list[str] = []
        target = clamp(desired, self._speeds)
        if target != desired:
            limits.append("speed")
        points = np.empty((0, 2))
        if around is not None and not STILL == target == self.command:
            points = around.scans.points(around.robot, self._range(target, around))
            target = self._slowed(target, points, limits)
        self._axes = (
            ramp(self._axes[0], target[0], self._ramps[0], seconds),
            ramp(self._axes[1], target[1], self._ramps[1], seconds),
        )
        blocked = ""
        if around is not None:
            blocked = self._check(points, around, seconds, limits, operator=operator)
        if max(abs(target[0]) / _STANDS, abs(target[1]) / _TURNS_NOT) < 1.0:
            blocked = ""
        return GateOutput(self.command, tuple(limits), blocked)

    def _range(self, target: Velocity, around: Surroundings) -> float:
        """Return the distance [m] from which points matter neither to slow-down nor to stop."""
        config = self._config
        # A ramp that must reverse its rate exceeds both velocities by as much as it eases.
        fastest, turn = (
            max(abs(target[axis]), abs(self.command[axis]), abs(around.measured[axis]))
            + limits.acceleration**2 / (2.0 * limits.jerk)
            for axis, limits in enumerate(self._ramps)
        )
        stops_s = fastest / config.braking
        if not self._stop_zone.is_round:
            stops_s = max(stops_s, turn / config.turn_braking)
        stops_s = config.latency + around.delay_s + 0.5 * stops_s
        return self._reach + fastest * max(stops_s, config.slowdown_time)

    def _slowed(self, target: Velocity, points: Array, limits: list[str]) -> Velocity:
        """Reduce the speed if a point is in the slow-down zone."""
        slow = self._config.slowdown_speed
        if abs(target[0]) <= slow:
            return target
        if self._slow_zone.seconds_to_contact(points, target) > self._config.slowdown_time:
            return target
        limits.append("slow-down zone")
        share = slow / abs(target[0])
        return share * target[0], share * target[1]

    def _check(
        self,
        points: Array,
        around: Surroundings,
        seconds: float,
        limits: list[str],
        *,
        operator: bool,
    ) -> str:
        """Reduce the command so that the robot can stop in time; return what blocks it."""
        speed, turn = self.command
        if (speed, turn) == STILL:
            return ""
        reaction_s = self._config.latency + around.delay_s
        turns = not self._stop_zone.is_round
        contact_s = self._stop_zone.seconds_to_contact(points, (speed, turn))
        share = allowed_share(contact_s, (speed, turn), self._ability, reaction_s, turns=turns)
        reason = f"an obstacle {abs(speed) * contact_s:.2f} m away on its way"
        moving = around.measured
        if abs(moving[0]) > _MOVES and moving[0] * speed > 0.0:
            other_s = self._stop_zone.seconds_to_contact(points, moving)
            most = allowed_share(other_s, moving, self._ability, reaction_s, turns=turns)
            if most < 1.0 and most * abs(moving[0]) < share * abs(speed):
                share = most * abs(moving[0]) / abs(speed)
                reason = f"an obstacle {abs(moving[0]) * other_s:.2f} m away in its direction"
        if share < 1.0:
            limits.append("approach")
        if speed < 0.0 and share > 0.0:
            most_speed = self._config.blind_reverse_speed if operator else 0.0
            if most_speed < share * -speed and not self._is_seen_behind(around, speed, reaction_s):
                share = most_speed / -speed
                reason = "the scanner has not seen the ground behind lately"
                limits.append("blind reverse")
        if share >= 1.0:
            return ""
        # A round robot may turn on the spot whatever is near.
        kept_turn = turn if share == 0.0 and not turns else share * turn
        self._brake_to((share * speed, kept_turn), seconds)
        now = self.command
        stands = abs(now[0]) < _STANDS and abs(now[1]) < _TURNS_NOT
        return reason if stands else ""

    def _is_seen_behind(self, around: Surroundings, speed: float, reaction_s: float) -> bool:
        stops_m = -speed * reaction_s + speed * speed / (2.0 * self._config.braking)
        count = math.ceil(max(_SEEN_M, stops_m) / _STEP_M)
        places = np.concatenate([self._behind - (k * _STEP_M, 0.0) for k in range(1, count + 1)])
        return around.scans.share_seen(around.robot, places) >= _SEEN_SHARE

    def _brake_to(self, target: Velocity, seconds: float) -> None:
        """Reduce the command to `target`, with the emergency deceleration if there is one."""
        speed, turn = self.command
        slower = brake(speed, target[0], self._config.emergency_deceleration, seconds)
        to_go = speed - target[0]
        share = (speed - slower.velocity) / to_go if abs(to_go) > 0.0 else 1.0
        turned = turn + share * (target[1] - turn)
        self._axes = slower, AxisState(turned, self._axes[1].rate if turned == turn else 0.0)


def _places_behind(outline: Footprint) -> Array:
    """Return places (n, 2) [m] on the rear edge of the robot."""
    if outline.is_round:
        across = np.linspace(-0.95, 0.95, _ACROSS) * outline.radius
        return np.column_stack((-np.sqrt(outline.radius**2 - across**2), across))
    corners = np.array(outline.corners)
    across = np.linspace(corners[:, 1].min(), corners[:, 1].max(), _ACROSS)
    return np.column_stack((np.full(_ACROSS, corners[:, 0].min()), across))
