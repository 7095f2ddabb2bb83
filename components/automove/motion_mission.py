"""Missions of one motion without a map: turn on the spot, or drive straight back."""

from __future__ import annotations

from dataclasses import dataclass, field

from cairn.components.automove.inputs import MissionInputs
from cairn.components.automove.state_machine import Mission
from cairn.planar.poses import Pose
from cairn.schemas.cairn_nav_msgs import (
    NO_REASON,
    MotionStatus,
    NavCommand,
    NavigateGoal,
    NavigationStatus,
    Reason,
    ReasonCode,
)

_PROGRESS = 0.02  # [m], [rad]: more than noise of odometry


@dataclass(kw_only=True)
class MotionMission(Mission):
    """One motion; used as `MissionStateMachine` is. `distance_left` is the rest: [m] or [rad]."""

    request: NavigateGoal
    target: Pose = (0.0, 0.0, 0.0)
    _moved_s: float = field(init=False)
    _least_left: float = field(init=False)
    _cause: Reason = NO_REASON

    def __post_init__(self) -> None:
        """Start with the first command, and all of the motion left."""
        super().__post_init__()
        self._moved_s = self.started_s
        self._least_left = abs(self.request.amount)

    @property
    def goals(self) -> tuple[Pose, ...]:
        """There are none."""
        return ()

    @property
    def distance(self) -> float:
        """How far to drive back [m]."""
        return abs(self.request.amount) if self.request.motion == NavigateGoal.REVERSE else 0.0

    @property
    def angle(self) -> float:
        """How far to turn [rad]."""
        return self.request.amount if self.request.motion == NavigateGoal.TURN else 0.0

    @property
    def speed(self) -> float:
        """The highest speed, 0: as usual."""
        return self.request.speed

    def on_plugins_loaded(self, now_s: float) -> None:
        """Command the motion, as all plugins are loaded."""
        is_turn = self.request.motion == NavigateGoal.TURN
        self.behavior = NavCommand.TURN if is_turn else NavCommand.REVERSE
        self.state = NavigationStatus.DRIVING
        self.command_id = self.next_command_id()
        self._moved_s = now_s

    def distance_left(self, inputs: MissionInputs) -> float:
        """Return what is left [m] or [rad], as motion control has published it last."""
        motion = inputs.motion
        if motion is None or motion.command_id != self.command_id:
            return abs(self.request.amount)
        return motion.distance_left

    def step(self, now_s: float, inputs: MissionInputs) -> None:
        """Decide on the state at `now_s` [s]."""
        if self.finished or self.state == NavigationStatus.LOADING:
            return
        allowed_s = self.request.time_allowance
        if allowed_s > 0.0 and now_s - self.started_s > allowed_s:
            self.fail(Reason(ReasonCode.TIMED_OUT, f"not finished within {allowed_s:g} s"))
            return
        motion = inputs.motion
        if motion is None or motion.command_id != self.command_id:
            self.reason = Reason(ReasonCode.NO_MOTION_STATUS, "motion control has not answered yet")
        elif motion.state == MotionStatus.DONE:
            self._end(NavigationStatus.SUCCEEDED, Reason(ReasonCode.ARRIVED, "finished"))
            return
        elif motion.state == MotionStatus.MOVING:
            self.reason = NO_REASON
            if motion.distance_left < self._least_left - _PROGRESS:
                self._moved_s, self._least_left = now_s, motion.distance_left
        else:
            self.reason = Reason(motion.reason_code, motion.reason)
            if motion.state == MotionStatus.BLOCKED:
                self.fail(self.reason)
                return
        # What holds the robot may come and go: a gate that stops each attempt to move.
        if motion is not None and motion.command_id == self.command_id and self.reason.text:
            self._cause = self.reason
        if now_s - self._moved_s > self.limits.blocked_s:
            words = (
                self._cause.text
                or self.reason.text
                or ("the robot does not move: the base or the velocity gate holds it")
            )
            self.fail(Reason(self._cause.code or int(ReasonCode.NO_PROGRESS), words))
