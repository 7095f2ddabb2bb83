"""The motions that a command starts: follow a path, back off, look around, explore.

AutoMove selects them (`automove/recovery_selection.py`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np

from cairn.components.motion_control.collision_checks import check_lines, free_arc
from cairn.components.motion_control.followed_path import FollowedPath
from cairn.components.motion_control.local_planner import LocalPlanner, PlannerInput
from cairn.components.motion_control.scan_memory import NearbyObstacles, ScanMemory
from cairn.components.motion_control.velocity_limits import (
    STAND_STILL,
    MotionLimits,
    VelocityTarget,
)
from cairn.planar.poses import Pose, compose, distance, relative, wrap
from cairn.schemas.cairn_nav_msgs import MotionStatus, ReasonCode

SECOND_NS = 1_000_000_000

# Where no other reason is given, the constants of the behaviors were chosen by hand;
# `lab/constants.yaml` has the effect of half and double.

# Slower than this [m/s], [rad/s] the robot stands: wheels report noise of this size.
_STANDING, _NOT_TURNING = 0.03, 0.06
# The least tolerances of a goal [m], [rad] that the robot is asked for: its pose is no more exact.
_LEAST_POSITION, _LEAST_HEADING = 0.02, 0.02


class MotionState(IntEnum):
    """The state of a behavior, with the numbers of the message MotionStatus."""

    STANDING = MotionStatus.STANDING
    MOVING = MotionStatus.MOVING
    BLOCKED = MotionStatus.BLOCKED
    DONE = MotionStatus.DONE
    STOPPED = MotionStatus.STOPPED


@dataclass(frozen=True)
class BehaviorInput:
    """What a behavior knows at `now` [ns]: poses in the odometry frame and in the map, obstacles.

    `speed` [m/s] and `turn` [rad/s] are measured; `pose` is None while it is unknown;
    `field_of_view` is the part of a circle around the robot that the scanner sees: its middle and
    half its width [rad].
    """

    now: int
    odom: Pose
    speed: float
    turn: float
    pose: Pose | None
    memory: ScanMemory
    obstacles: NearbyObstacles
    field_of_view: tuple[float, float] = (0.0, math.pi)

    @property
    def planner_input(self) -> PlannerInput:
        """Return the part of it that the local planner needs."""
        return PlannerInput(self.now, self.odom, self.speed, self.obstacles)

    @property
    def is_standing(self) -> bool:
        """Return whether the robot stands still, except for the noise of its odometry."""
        return abs(self.speed) < _STANDING and abs(self.turn) < _NOT_TURNING


@dataclass(frozen=True)
class BehaviorResult:
    """The velocity to drive at now, its reason, and the distance `left` [m] to go."""

    target: VelocityTarget = STAND_STILL
    state: MotionState = MotionState.MOVING
    reason: str = ""
    left: float = 0.0
    code: int = ReasonCode.NONE


class Behavior(Protocol):
    """A motion that ends with the state DONE."""

    def step(self, inputs: BehaviorInput) -> BehaviorResult:
        """Return the result for the current inputs."""
        ...


class Follow:
    """Follow a path in the map to its goal, then turn to the goal's heading.

    The goal is reached within `position` [m] and `heading` [rad]; the behavior aims at a third of
    these, so that noise does not end it early.
    """

    # The robot does not drive to a path that is farther away than this [m]; the planner must
    # replan. Shorter than the part of a path that is considered (`HORIZON_M`, 3 m).
    MAX_DISTANCE_M = 2.5
    # The state is BLOCKED only after no motion was possible for so long [ns]: single scans are
    # noisy. Five scans at 10 Hz.
    PATIENCE_NS = SECOND_NS // 2
    # Shares of the tolerances. The robot has arrived within a third of the goal's, or within two
    # thirds if the goal is beside or behind it [m]: then driving on does not bring it nearer. Once
    # arrived, it stays so until it leaves nearly the whole tolerance.
    _AIMED, _PASSED, _KEPT = 0.35, 0.7, 0.9
    _BESIDE_M = 0.02
    # The rest of the path counts as the straight distance to the goal below this [m].
    _STRAIGHT_M = 0.5

    def __init__(
        self, limits: MotionLimits, path: FollowedPath, position: float, heading: float
    ) -> None:
        self._limits = limits
        self._planner = LocalPlanner(limits)
        self._position = max(_LEAST_POSITION, position)
        self._heading = max(_LEAST_HEADING, heading)
        self._arrived = self._done = False
        self._moved_at = 0
        self.path = path

    def step(self, inputs: BehaviorInput) -> BehaviorResult:
        """Return the result for the current inputs, which must have a pose."""
        pose, goal = inputs.pose, self.path.goal
        assert pose is not None
        distance_left = distance(pose, goal)
        if self._done:
            return BehaviorResult(state=MotionState.DONE)
        if not self._arrived:
            ahead = relative(pose, goal)[0]
            self._arrived = distance_left < self._AIMED * self._position or (
                distance_left < self._PASSED * self._position and ahead < self._BESIDE_M
            )
        elif distance_left > self._KEPT * self._position:
            self._arrived = False
        if self._arrived:
            return self._turn(inputs, distance_left, wrap(goal[2] - pose[2]))
        way = self.path.ahead(pose)
        left = self.path.left
        if left < self._STRAIGHT_M:
            left = max(left, distance_left)
        if self.path.off > self.MAX_DISTANCE_M:
            reason = f"the path is {self.path.off:.1f} m away"
            return BehaviorResult(
                state=MotionState.BLOCKED, reason=reason, left=left, code=ReasonCode.OFF_PATH
            )
        target = self._planner.along(way, left, inputs.planner_input)
        if target.blocked and distance_left < self._KEPT * self._position:
            self._arrived = True
        if not target.blocked:
            self._moved_at = inputs.now
        if inputs.now - self._moved_at < self.PATIENCE_NS:
            return BehaviorResult(
                target, MotionState.MOVING, target.blocked, left, _reason_code(target)
            )
        return _driving(target, left)

    def _turn(self, inputs: BehaviorInput, distance_left: float, off: float) -> BehaviorResult:
        if abs(off) > self._AIMED * self._heading:
            return BehaviorResult(
                VelocityTarget(turn=self._limits.turn_rate_for(off)), left=distance_left
            )
        self._done = inputs.is_standing
        return BehaviorResult(
            state=MotionState.DONE if self._done else MotionState.MOVING, left=distance_left
        )


class BackOff:
    """Drive back a little: backward where the ground was seen lately, otherwise turned around."""

    SPEED = 0.15  # [m/s], the `creep_speed` beside obstacles
    SEEN_NS = 4 * SECOND_NS  # it drives 0.6 m in this time, twice the usual length
    # With less room [m] behind the robot it does not start; it must drive this far [m] to be done.
    _LEAST, _WORTH = 0.03, 0.05
    # It is done this near to its end [m], stops this far before an obstacle [m], and drives at
    # least so fast [m/s] that a base can follow.
    _END_M, _STOP_GAP_M, _LEAST_SPEED = 0.01, 0.02, 0.04

    def __init__(self, limits: MotionLimits, length: float = 0.3) -> None:
        self._limits = limits
        self._length = length
        self._start: Pose | None = None
        self._turned_planner: LocalPlanner | None = None
        self._end: BehaviorResult | None = None

    def step(self, inputs: BehaviorInput) -> BehaviorResult:
        """Return the result for the current inputs."""
        if self._start is None:
            self._start = inputs.odom
        if self._end is not None and self._end.state is MotionState.DONE:
            return self._end
        driven = distance(self._start, inputs.odom)
        left = self._length - driven
        if left <= self._END_M:
            return self._finish(MotionState.DONE, "")
        if self._turned_planner is not None:
            return self._drive_turned(self._turned_planner, inputs, driven, left)
        limits = self._limits
        free = _free_behind(limits, inputs.obstacles)
        if free < self._LEAST:
            return self._end_blocked(driven, f"an obstacle {free + limits.margin:.2f} m behind")
        since = inputs.now - self.SEEN_NS
        if not inputs.memory.is_ground_seen(inputs.odom, math.pi, min(left, free), since):
            self._turned_planner = LocalPlanner(limits)
            return self._drive_turned(self._turned_planner, inputs, driven, left)
        free -= self._STOP_GAP_M
        pace = min(self.SPEED, limits.speed_to_stop_in(left), limits.speed_to_stop_in(free))
        return BehaviorResult(VelocityTarget(speed=-max(self._LEAST_SPEED, pace)), left=left)

    def _drive_turned(
        self, planner: LocalPlanner, inputs: BehaviorInput, driven: float, left: float
    ) -> BehaviorResult:
        assert self._start is not None
        off = wrap(self._start[2] + math.pi - inputs.odom[2])
        target = planner.straight(inputs.obstacles, off, left)
        if target.blocked:
            return self._end_blocked(driven, target.blocked)
        return _driving(target, left)

    def _end_blocked(self, driven: float, reason: str) -> BehaviorResult:
        if driven >= self._WORTH:
            return self._finish(MotionState.DONE, f"{driven:.2f} m back: {reason}")
        return self._finish(MotionState.BLOCKED, reason)

    def _finish(self, state: MotionState, reason: str) -> BehaviorResult:
        code = ReasonCode.OBSTACLE if reason else ReasonCode.NONE
        self._end = BehaviorResult(state=state, reason=reason, code=code)
        return self._end


class Reverse:
    """Drive straight back, where scans show no obstacle; end if there is one."""

    _END_M, _LEAST, _LEAST_SPEED = BackOff._END_M, BackOff._LEAST, BackOff._LEAST_SPEED
    _STOP_GAP_M = BackOff._STOP_GAP_M

    def __init__(self, limits: MotionLimits, length: float, speed: float) -> None:
        self._limits = limits
        self._length = length
        self._speed = min(speed, BackOff.SPEED) if speed > 0.0 else BackOff.SPEED
        self._start: Pose | None = None

    def step(self, inputs: BehaviorInput) -> BehaviorResult:
        """Return the result for the current inputs."""
        if self._start is None:
            self._start = inputs.odom
        left = self._length - distance(self._start, inputs.odom)
        if left <= self._END_M:
            return BehaviorResult(state=MotionState.DONE)
        limits = self._limits
        free = _free_behind(limits, inputs.obstacles) - self._STOP_GAP_M
        if free < self._LEAST:
            reason = f"an obstacle {max(0.0, free) + limits.margin:.2f} m behind"
            return BehaviorResult(
                state=MotionState.BLOCKED, reason=reason, left=left, code=ReasonCode.OBSTACLE
            )
        pace = min(self._speed, limits.speed_to_stop_in(left), limits.speed_to_stop_in(free))
        return BehaviorResult(VelocityTarget(speed=-max(self._LEAST_SPEED, pace)), left=left)


class LookAround:
    """Turn on the spot: once around, or by `angle` [rad], to the left if it is positive."""

    SPEED = 0.8  # [rad/s]: 0.08 rad between scans at 10 Hz
    _END_RAD = 0.02  # it is done this near to its end [rad], a degree

    def __init__(
        self, limits: MotionLimits, angle: float = 2.0 * math.pi, speed: float = 0.0
    ) -> None:
        self._limits = limits
        self._left = abs(angle)
        self._sign = math.copysign(1.0, angle)
        self._speed = min(speed, self.SPEED) if speed > 0.0 else self.SPEED
        self._heading: float | None = None

    def step(self, inputs: BehaviorInput) -> BehaviorResult:
        """Return the result for the current inputs; `left` is the angle to turn [rad]."""
        heading = inputs.odom[2]
        if self._heading is not None:
            self._left -= self._sign * wrap(heading - self._heading)
        self._heading = heading
        if self._left <= self._END_RAD:
            return BehaviorResult(state=MotionState.DONE)
        turn = min(self._speed, self._limits.turn_rate_for(self._left))
        return BehaviorResult(VelocityTarget(turn=self._sign * turn), left=self._left)


class Explore:
    """Drive `length` [m] in the direction with the most room."""

    # Least room [m] to start, more than a robot's diameter, and distance [m] to keep from what ends
    # the room.
    _ROOM, _APART = 0.6, 0.3
    # Directions that are examined, 5 degrees apart: at 3 m 0.26 m, less than the robot's width.
    _DIRECTIONS = np.linspace(-math.pi, math.pi, 72, endpoint=False)
    # Room beyond this [m] is worth no more, and a direction is worth less by so much per angle off
    # the heading [m/rad], so that of equal directions the robot takes the one ahead.
    _WORTH_M, _WORTH_PER_RAD = 3.0, 0.1
    _PATIENCE_NS = 1 * SECOND_NS  # blocked for so long, it chooses another direction
    _TRIES = 4  # directions, then it gives up
    # A direction is driven this far beyond what is left [m], and given up this near to its end [m]:
    # the robot ends exploring while it drives.
    _BEYOND_M = _END_M = 0.1
    REACH = 4.0  # obstacles within this distance [m] are considered: `ScanMemory.MAX_RANGE_M`

    def __init__(self, limits: MotionLimits, length: float) -> None:
        self._limits = limits
        self._left = length
        self._planner = LocalPlanner(limits)
        self._path: FollowedPath | None = None
        self._look_around: LookAround | None = None
        self._odom: Pose | None = None
        self._tries = 0
        self._moved_at: int | None = None
        self._free = np.empty(self._DIRECTIONS.size)

    def step(self, inputs: BehaviorInput) -> BehaviorResult:
        """Return the result for the current inputs."""
        driven = 0.0 if self._odom is None else distance(self._odom, inputs.odom)
        self._odom = inputs.odom
        self._left -= driven
        if self._left <= 0.0:
            return BehaviorResult(state=MotionState.DONE)
        if self._look_around is not None:
            result = self._look_around.step(inputs)
            if result.state is not MotionState.DONE:
                return BehaviorResult(
                    result.target,
                    MotionState.MOVING,
                    "looking for room",
                    self._left,
                    ReasonCode.NO_ROOM,
                )
            self._look_around = None
        if self._path is None:
            return self._choose(inputs)
        way = self._path.ahead(inputs.odom)
        if self._path.left < self._END_M:
            self._path = None
            return BehaviorResult(left=self._left)
        target = self._planner.along(way, self._path.left, inputs.planner_input)
        if not target.blocked:
            self._moved_at = inputs.now
        elif inputs.now - (self._moved_at or 0) > self._PATIENCE_NS:
            self._path = None
        return BehaviorResult(
            target, MotionState.MOVING, target.blocked, self._left, _reason_code(target)
        )

    def _choose(self, inputs: BehaviorInput) -> BehaviorResult:
        """Start in the visible direction with the most room, or turn to look behind, or give up."""
        if self._tries == self._TRIES:
            reason = f"no room of {self._ROOM:.1f} m to go to"
            return BehaviorResult(
                state=MotionState.BLOCKED, reason=reason, left=self._left, code=ReasonCode.NO_ROOM
            )
        self._tries += 1
        limits = self._limits
        points = inputs.memory.around(inputs.odom, self.REACH).points
        check_lines(
            points, self._DIRECTIONS, limits.keepout_radius, limits.contact_radius, self._free
        )
        free = np.minimum(self._free, self._WORTH_M)
        wide = np.minimum(free, np.minimum(np.roll(free, 1), np.roll(free, -1)))
        middle, half = inputs.field_of_view
        seen = np.abs((self._DIRECTIONS - middle + math.pi) % (2 * math.pi) - math.pi) <= half
        worth = np.where(seen, wide - self._WORTH_PER_RAD * np.abs(self._DIRECTIONS), -np.inf)
        best = int(np.argmax(worth))
        if wide[best] < self._ROOM or not seen[best]:
            self._look_around = LookAround(self._limits, math.pi)
            return BehaviorResult(left=self._left)
        length = min(self._left + self._BEYOND_M, wide[best] - self._APART)
        direction = float(self._DIRECTIONS[best])
        end = compose(
            inputs.odom,
            (length * math.cos(direction), length * math.sin(direction), direction),
        )
        self._path = FollowedPath(np.array([inputs.odom, end]), end)
        self._moved_at = inputs.now
        return BehaviorResult(left=self._left)


def _free_behind(limits: MotionLimits, obstacles: NearbyObstacles) -> float:
    """Return how far the robot can drive straight back [m]."""
    return free_arc(obstacles.points * -1.0, 0.0, limits.keepout_radius, limits.contact_radius)


def _driving(target: VelocityTarget, left: float) -> BehaviorResult:
    state = MotionState.BLOCKED if target.blocked else MotionState.MOVING
    return BehaviorResult(target, state, target.blocked, max(0.0, left), _reason_code(target))


def _reason_code(target: VelocityTarget) -> ReasonCode:
    return ReasonCode.OBSTACLE if target.blocked else ReasonCode.NONE
