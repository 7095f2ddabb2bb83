"""A mission with a scripted localizer, planner and motion control."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

from cairn.components.automove.inputs import MissionInputs
from cairn.components.automove.recovery_selection import MissionLimits
from cairn.components.automove.state_machine import MissionStateMachine
from cairn.schemas.cairn_nav_msgs import (
    LocalizationEstimate,
    MotionStatus,
    NavCommand,
    NavigationStatus,
    Plan,
)

LOCATED = LocalizationEstimate(located=True, health=0.9)


class ScriptedRobot:
    """A mission and its inputs: `localization`, `plan` and `motion` are repeated until changed.

    `reported` holds state, behavior and reason at each change of state or behavior.
    """

    def __init__(self, *goals: tuple[float, float, float], **limits: Any) -> None:
        self.now = 100.0
        self.inputs = MissionInputs(pose=(0.0, 0.0, 0.0))
        self.localization: LocalizationEstimate | None = LOCATED
        self.plan: dict[str, Any] | None = {"outcome": Plan.FOUND}
        self.motion: dict[str, Any] | None = {"state": MotionStatus.MOVING}
        self.mission = MissionStateMachine(
            mission_id=1,
            goals=goals or ((3.0, 4.0, 0.0),),
            goal_index=0,
            next_command_id=itertools.count(1).__next__,
            started_s=self.now,
            limits=MissionLimits(**limits),
        )
        self.reported: list[tuple[int, int, str]] = []
        self.mission.on_plugins_loaded(self.now)

    def run(self, seconds: float) -> ScriptedRobot:
        """Let time pass in steps of 0.1 s."""
        for _ in range(round(seconds * 10)):
            self.now += 0.1
            if self.localization is not None:
                self.inputs.localization, self.inputs.localization_s = self.localization, self.now
            command_id = self.mission.command_id
            behavior = self.mission.behavior
            if self.plan is not None and behavior == NavCommand.FOLLOW:
                self.inputs.plan = Plan(command_id=command_id, **self.plan)
            if self.motion is not None:
                standing = {"state": MotionStatus.STANDING}
                motion = standing if behavior == NavCommand.STAND else self.motion
                self.inputs.motion, self.inputs.motion_s = (
                    MotionStatus(command_id=command_id, **motion),
                    self.now,
                )
            self.mission.step(self.now, self.inputs)
            row = (self.mission.state, self.mission.behavior, self.mission.reason.text)
            if not self.reported or self.reported[-1][:2] != row[:2]:
                self.reported.append(row)
        return self

    @property
    def states(self) -> list[int]:
        """The states so far, without repetitions."""
        return [state for state, _, _ in self.reported]

    @property
    def recovery_behaviors(self) -> list[int]:
        """The behaviors of all recoveries so far."""
        return [
            behavior for state, behavior, _ in self.reported if state == NavigationStatus.RECOVERING
        ]


class DrivingRobot(ScriptedRobot):
    """A robot that drives on a path of which `path_left_m` is left; it may meet obstacles."""

    SPEED = 0.4  # [m/s]
    BACK_OFF, GIVE_WAY = 0.4, 1.4  # [m]

    def __init__(
        self, path_left_m: float, *goals: tuple[float, float, float], **limits: Any
    ) -> None:
        super().__init__(*goals, **limits)
        self.path_left_m = path_left_m
        self._back = 0.0

    def drive(
        self, limit_s: float, blocked: Callable[[float], bool] = lambda _: False
    ) -> DrivingRobot:
        """Drive for at most `limit_s`; `blocked` is called with the path left [m]."""
        until = self.now + limit_s
        while self.now < until and not self.mission.finished:
            self.motion = self._moved(self.mission.behavior, blocked)
            self.run(0.1)
        return self

    def drive_until_blocked_at(self, left_m: float) -> None:
        """Drive until a recovery from an obstacle `left_m` before the end of the path."""
        before = self.mission.recoveries
        while self.mission.recoveries == before and not self.mission.finished:
            self.drive(0.1, lambda path_left_m: path_left_m <= left_m)

    def _moved(self, behavior: int, blocked: Callable[[float], bool]) -> dict[str, Any]:
        if behavior == NavCommand.BACK_OFF and self._back < self.BACK_OFF:
            self._back += 0.02
            self.path_left_m += 0.02
            return {"state": MotionStatus.MOVING}
        if self.mission.alternative is not None and self._back < self.GIVE_WAY:
            self._back += 0.04
            self.path_left_m += 0.04
            return {"state": MotionStatus.MOVING, "distance_left": 0.5}
        self._back = 0.0
        if self.mission.alternative is not None:
            return {"state": MotionStatus.DONE}
        if behavior != NavCommand.FOLLOW or self.path_left_m <= 0.0:
            return {"state": MotionStatus.DONE}
        if blocked(self.path_left_m):
            state = MotionStatus.BLOCKED
            return {"state": state, "reason": "a wall", "distance_left": self.path_left_m}
        self.path_left_m = max(0.0, self.path_left_m - self.SPEED / 10)
        return {"state": MotionStatus.MOVING, "distance_left": self.path_left_m}
