"""Invariants of a robot that drives: collisions, goals, and reasons for standing still."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import Field

from cairn.deployment.model import Deployment
from cairn.runtime.parameters import Config
from cairn.schemas.cairn_nav_msgs import (
    NAVIGATION_END_STATES,
    NAVIGATION_STATES,
    Collision,
    NavigationStatus,
    VelocityGateStatus,
)
from cairn.schemas.nav_msgs import Odometry
from cairn_lab.campaign.invariants import Invariant
from cairn_lab.campaign.observations import GoalEnded

_STANDS_MPS = 0.01
_STANDS_RADPS = 0.02


class NoCollision(Invariant):
    """The robot touches nothing in the simulated world."""

    topics: Mapping[str, type[Any]] = {"collisions": Collision}

    def on_message(self, at_s: float, topic: str, message: Any) -> Iterable[str]:
        """Report a collision."""
        yield (
            f"the robot touched {message.obstacle} at {message.x:.2f}, {message.y:.2f} with "
            f"{message.speed:.2f} m/s"
        )


class GoalsEnd(Invariant):
    """Each goal ends in time: reached, or failed with a reason."""

    def on_goal(self, goal: GoalEnded) -> Iterable[str]:
        """Judge the end of a goal."""
        x, y, theta = goal.pose
        what = f"the goal {x:g}, {y:g}, {theta:g} rad"
        if goal.state == "late":
            yield f"{what} had not ended after {goal.took_s:.0f} s; the robot is {goal.reason}"
        elif goal.state != "succeeded" and not goal.reason:
            yield f"{what} {goal.state} without a reason"


class StandingConfig(Config):
    """Parameters of `stands_with_reason`."""

    patience_s: float = Field(
        60.0, gt=0, le=3600, description="Time for which it may stand without a reason [s]."
    )


class StandsWithReason(Invariant):
    """A robot that has a goal and stands publishes the reason.

    Judged by odometry, the navigation status and the velocity gate's status. Without odometry the
    robot counts as standing.
    """

    config_type = StandingConfig
    config: StandingConfig

    topics: Mapping[str, type[Any]] = {
        "odom": Odometry,
        "navigation_status": NavigationStatus,
        "velocity_gate_status": VelocityGateStatus,
    }

    def __init__(self, config: Config) -> None:
        super().__init__(config)
        self._moved_s: float | None = None
        self._status: NavigationStatus | None = None
        self._gate_reason = ""

    def on_start(self, at_s: float, deployment: Deployment) -> Iterable[str]:
        """Forget the launch before."""
        self._moved_s, self._status, self._gate_reason = None, None, ""
        return ()

    def on_message(self, at_s: float, topic: str, message: Any) -> Iterable[str]:
        """Note that the robot drives, or why it does not."""
        if isinstance(message, Odometry):
            twist = message.twist.twist
            speed = math.hypot(twist.linear.x, twist.linear.y)
            if speed > _STANDS_MPS or abs(twist.angular.z) > _STANDS_RADPS:
                self._moved_s = at_s
        elif isinstance(message, NavigationStatus):
            self._status = message
        elif isinstance(message, VelocityGateStatus):
            self._gate_reason = message.reason
        return ()

    def on_processes(self, at_s: float, processes: Any) -> Iterable[str]:
        """Judge, once a second."""
        status = self._status
        if (
            status is None
            or status.state in NAVIGATION_END_STATES
            or status.reason
            or self._gate_reason
            or self._moved_s is None
        ):
            self._moved_s = at_s
            return
        stood_s = at_s - self._moved_s
        if stood_s > self.config.patience_s:
            self._moved_s = at_s  # reported again only after as long
            state = NAVIGATION_STATES[status.state]
            yield f"the robot has a goal ({state}) and stands for {stood_s:.0f} s without a reason"
