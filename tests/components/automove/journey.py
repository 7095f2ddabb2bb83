"""A navigator whose planner and motion control answer as a test says."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

from cairn.components.automove.inputs import NavigatorInputs
from cairn.components.automove.recovery_selection import NavigatorLimits
from cairn.components.automove.state_machine import NavigatorStateMachine
from cairn.schemas.cairn_nav_msgs import (
    LocalizationEstimate,
    MotionStatus,
    NavCommand,
    NavigationStatus,
    Plan,
)

SURE = LocalizationEstimate(located=True, health=0.9)


class Journey:
    """The planner, motion control and the localizer publish what was set last."""

    def __init__(self, *goals: tuple[float, float, float], **limits: Any) -> None:
        self.now = 100.0
        self.inputs = NavigatorInputs(pose=(0.0, 0.0, 0.0))
        self.health: LocalizationEstimate | None = SURE
        self.plan: dict[str, Any] | None = {"outcome": Plan.FOUND}
        self.motion: dict[str, Any] | None = {"state": MotionStatus.MOVING}
        self.navigator = NavigatorStateMachine(
            mission_id=1,
            goals=goals or ((3.0, 4.0, 0.0),),
            goal_index=0,
            next_goal_id=itertools.count(1).__next__,
            started_s=self.now,
            limits=NavigatorLimits(**limits),
        )
        self.reported: list[tuple[int, int, str]] = []
        self.navigator.on_plugins_loaded(self.now)

    def run(self, seconds: float) -> Journey:
        """Let that much time pass, a tenth of a second at a time."""
        for _ in range(round(seconds * 10)):
            self.now += 0.1
            if self.health is not None:
                self.inputs.localization, self.inputs.localization_s = self.health, self.now
            goal_id = self.navigator.goal_id
            wanted = self.navigator.behavior
            if self.plan is not None and wanted == NavCommand.FOLLOW:
                self.inputs.plan = Plan(goal_id=goal_id, **self.plan)
            if self.motion is not None:
                standing = {"state": MotionStatus.STANDING}
                given = standing if wanted == NavCommand.STAND else self.motion
                self.inputs.motion, self.inputs.motion_s = (
                    MotionStatus(goal_id=goal_id, **given),
                    self.now,
                )
            self.navigator.step(self.now, self.inputs)
            row = (self.navigator.state, self.navigator.behavior, self.navigator.reason.text)
            if not self.reported or self.reported[-1][:2] != row[:2]:
                self.reported.append(row)
        return self

    @property
    def states(self) -> list[int]:
        """The states, each once in a row."""
        return [state for state, _, _ in self.reported]

    @property
    def tried(self) -> list[int]:
        """The recoveries."""
        return [what for state, what, _ in self.reported if state == NavigationStatus.RECOVERING]


class Way(Journey):
    """A robot on a way that has a length, and obstacles on it."""

    SPEED = 0.4  # [m/s]
    BACK_OFF, GIVE_WAY = 0.4, 1.4  # [m]

    def __init__(self, left: float, *goals: tuple[float, float, float], **limits: Any) -> None:
        super().__init__(*goals, **limits)
        self.left = left
        self._back = 0.0

    def drive(self, limit_s: float, blocked: Callable[[float], bool] = lambda _: False) -> Way:
        """Follow the way, which is `blocked` or not with so much left, at most so long."""
        until = self.now + limit_s
        while self.now < until and not self.navigator.finished:
            self.motion = self._moved(self.navigator.behavior, blocked)
            self.run(0.1)
        return self

    def drive_until_blocked_at(self, left: float) -> None:
        """Follow the way until the robot recovers from an obstacle with so much left."""
        before = self.navigator.recoveries
        while self.navigator.recoveries == before and not self.navigator.finished:
            self.drive(0.1, lambda now_left: now_left <= left)

    def _moved(self, wanted: int, blocked: Callable[[float], bool]) -> dict[str, Any]:
        if wanted == NavCommand.BACK_OFF and self._back < self.BACK_OFF:
            self._back += 0.02
            self.left += 0.02
            return {"state": MotionStatus.MOVING}
        if self.navigator.alternative is not None and self._back < self.GIVE_WAY:
            self._back += 0.04
            self.left += 0.04
            return {"state": MotionStatus.MOVING, "distance_left": 0.5}
        self._back = 0.0
        if self.navigator.alternative is not None:
            return {"state": MotionStatus.DONE}
        if wanted != NavCommand.FOLLOW or self.left <= 0.0:
            return {"state": MotionStatus.DONE}
        if blocked(self.left):
            state = MotionStatus.BLOCKED
            return {"state": state, "reason": "a wall", "distance_left": self.left}
        self.left = max(0.0, self.left - self.SPEED / 10)
        return {"state": MotionStatus.MOVING, "distance_left": self.left}
