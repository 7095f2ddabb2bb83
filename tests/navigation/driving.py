"""The whole navigation in lockstep: goals, changes of the world, and the ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cairn.bus.actions import SentGoal
from cairn.planar.grid import OccupancyCells, grid_of
from cairn.planar.messages import planar_pose, pose_message
from cairn.planar.poses import Pose, distance
from cairn.schemas.cairn_nav_msgs import (
    NAVIGATION_END_STATES,
    Collision,
    MotionStatus,
    NavigationStatus,
)
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.schemas.nav2_msgs.action import NavigateThroughPoses
from cairn.schemas.nav_msgs import OccupancyGrid
from cairn.schemas.std_msgs import Header
from cairn.testing.lockstep import DeploymentHarness

DEPLOY = Path(__file__).parents[2] / "deploy"
SIM = DEPLOY / "sim.yaml"

ON_REQUEST = "components.automove.parameters.load_plugins=on_request"
"""The navigation is loaded with the first goal."""
FEW_RECOVERIES = "components.automove.parameters.recoveries=1"
"""A mission that no recovery helps fails soon."""
STOPS_S = 0.95
"""Longest time until the robot stands: 0.75 s from full speed; missing inputs are checked ten times
a second, and a command takes 0.05 s to the wheels."""


class LockstepRobot(DeploymentHarness):
    """`sim.yaml` in lockstep, driven by a test; keeps what the robot publishes.

    `statuses`, `motions` and `collisions` are all messages so far.
    """

    def __init__(self, folder: Path, *sets: str, seed: int = 1) -> None:
        super().__init__(SIM, sets=[f"settings.report={folder}", *sets], seed=seed)
        self.statuses = self.read("navigation_status", NavigationStatus).messages
        self.motions = self.read("motion_status", MotionStatus).messages
        self.collisions = self.read("collisions", Collision).messages
        self._truths = self.read("truth", PoseStamped)
        self._maps = self.read("map", OccupancyGrid)
        self._awaited = 0

    @property
    def truth(self) -> Pose:
        """The robot's true pose."""
        return planar_pose(self._truths.messages[-1].pose)

    def go(self, x: float, y: float, theta: float = 0.0, frame: str = "map") -> None:
        """Send a goal as RViz does."""
        pose = pose_message((x, y, theta))
        self.publish("goal_pose", PoseStamped(header=Header(frame_id=frame), pose=pose))

    def send(self, *goals: Sequence[float]) -> SentGoal[Any, Any, Any]:
        """Send goals x, y, heading, one after the other, as `cairn go` does."""
        return send_poses(self, *goals)

    def await_end(self, limit_s: float = 300.0) -> NavigationStatus:
        """Let time pass until a mission not awaited before has its result, and return it."""

        def ended() -> bool:
            last = self.statuses[-1] if self.statuses else NavigationStatus()
            return last.state in NAVIGATION_END_STATES and last.mission_id != self._awaited

        self.run_until(ended, limit_s)
        self._awaited = self.statuses[-1].mission_id
        return self.statuses[-1]

    def await_state(self, state: int, limit_s: float = 60.0) -> NavigationStatus:
        """Let time pass until a mission is in a state."""
        self.run_until(lambda: bool(self.statuses) and self.statuses[-1].state == state, limit_s)
        return self.statuses[-1]

    def await_goal(self, number: int) -> None:
        """Let time pass until the robot drives to goal `number` of the mission."""
        self.run_until(lambda: bool(self.statuses) and self.statuses[-1].goal == number)

    def assert_arrives(self, goal: tuple[float, float], limit_s: float = 300.0) -> None:
        """Assert that the mission succeeds, with the true pose at its goal, without a collision."""
        end = self.await_end(limit_s)
        assert end.state == NavigationStatus.SUCCEEDED, str(self)
        assert distance(self.truth, (*goal, 0.0)) < 0.25
        assert self.collisions == []

    def stands(self) -> bool:
        """Let a second pass; return whether the true pose did not change."""
        before = self.truth
        self.run_for(1.0)
        return distance(before, self.truth) < 0.005

    def time_to_stand(self, limit_s: float = 5.0) -> float:
        """Let time pass; return how long the true pose changed from now on [s]."""
        begin = moved = self.now
        while self.now < begin + limit_s:
            before = self.truth
            self.run_for(0.05)
            if distance(before, self.truth) > 0.0005:
                moved = self.now
        return moved - begin

    def grid(self) -> OccupancyCells:
        """Return the last complete grid map that was published."""
        maps = self._maps.take()
        assert maps, "no new map was published"
        return grid_of(maps[-1])

    def states(self) -> list[int]:
        """Return the published states without repetitions."""
        return [
            status.state
            for number, status in enumerate(self.statuses)
            if number == 0 or self.statuses[number - 1].state != status.state
        ]

    def __str__(self) -> str:
        """Return the published statuses, for the message of a failed assertion."""
        rows: list[str] = []
        for status in self.statuses:
            row = f"{status.mission_id} {status.state} {status.goal} {status.reason}"
            if not rows or rows[-1] != row:
                rows.append(row)
        truth = self._truths.messages[-1:]
        return "\n".join([f"at {truth}, {self.now:.1f} s", *rows[-25:]])


def send_poses(robot: DeploymentHarness, *goals: Sequence[float]) -> SentGoal[Any, Any, Any]:
    """Send a goal of `navigate_through_poses`: x, y, heading in frame map."""
    poses = tuple(
        PoseStamped(header=Header(frame_id="map"), pose=pose_message((x, y, theta)))
        for x, y, theta in goals
    )
    goal = NavigateThroughPoses.Goal(poses=poses)
    return robot.send_goal("navigate_through_poses", NavigateThroughPoses, goal)


def share_occupied(grid: OccupancyCells, x: float, y: float, half_m: float = 0.35) -> float:
    """Return the share of occupied cells around a position."""
    row, column = grid.frame.cell(x, y)
    half = round(half_m / grid.frame.resolution)
    window = grid.values[row - half : row + half + 1, column - half : column + half + 1]
    return float(np.mean(window >= 65))
