"""An examiner on virtual time in the hands of a test, which plays the world and the robot."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from cairn import SECOND, from_ns
from cairn.planar.messages import packed_poses, planar_pose, pose_message, with_covariance
from cairn.planar.poses import Pose
from cairn.schemas.cairn_nav_msgs import (
    Collision,
    LocalizationEstimate,
    NavigateGoal,
    NavigationStatus,
)
from cairn.schemas.cairn_sim_msgs import WorldGeometry, WorldState
from cairn.schemas.geometry_msgs import Point, PoseStamped
from cairn.schemas.packed import Packed
from cairn.schemas.std_msgs import Header
from cairn.tools.evaluation.examiner import NavigationExaminer
from cairn.tools.evaluation.results import RunResult

Corners = tuple[float, float, float, float]  # left, bottom, right, top [m]
HALL: Corners = (0.0, 0.0, 12.0, 10.0)
BEGIN_S = 10.0


def segments_of(*boxes: Corners) -> list[list[float]]:
    """The sides of boxes: x1, y1, x2, y2 [m]."""
    return [
        side
        for left, bottom, right, top in boxes
        for side in (
            [left, bottom, right, bottom],
            [right, bottom, right, top],
            [right, top, left, top],
            [left, top, left, bottom],
        )
    ]


class Examination:
    """The examiner has begun, and the robot stands still at (2, 2) in an empty hall."""

    def __init__(self, stage: Callable[..., Any], folder: Path, **parameters: Any) -> None:
        self.file = folder / "result.json"
        self.stage = stage(
            NavigationExaminer, BEGIN_S, file=str(self.file), settle=0.0, **parameters
        ).begin()
        self.robot: Pose = (2.0, 2.0, 0.0)
        self.orders = 0
        self.show()
        self.truth()

    @property
    def now(self) -> int:
        """Virtual time [ns]."""
        return int(self.stage.executor.now())

    def show(self, *boxes: Corners) -> None:
        """Let this stand in the hall from now on."""
        segments = segments_of(HALL, *boxes)
        count = len(segments)
        scene = WorldGeometry(
            segments=np.array(segments).ravel(),
            surfaces=np.zeros(count, np.uint8),
            heights=np.full(count, 2.5),
            solids=np.zeros(count, np.uint32),
        )
        self.stage.give("world_geometry", scene)

    def people(self, *places: tuple[float, float]) -> None:
        """Let people stand there."""
        rows = np.array([(x, y, 0.25) for x, y in places])
        self.stage.give("world_state", WorldState(people=Packed(Point, rows)))

    def truth(self, ago_s: float = 0.0) -> None:
        """Tell where the robot is now, or that it was there a while ago."""
        header = Header(stamp=from_ns(self.now - round(ago_s * SECOND)), frame_id="map")
        self.stage.give("truth", PoseStamped(header=header, pose=pose_message(self.robot)))

    def told(self, pose: Pose, ago_s: float = 0.0, sigma: float = 0.01) -> None:
        """Tell where the robot believes to have been a while ago."""
        header = Header(stamp=from_ns(self.now - round(ago_s * SECOND)), frame_id="map")
        covariance = with_covariance(pose, np.eye(3) * sigma**2)
        self.stage.give(
            "localization", LocalizationEstimate(header=header, located=True, pose=covariance)
        )

    def stand(self, seconds: float) -> None:
        """Let time pass."""
        for _ in range(round(seconds * 10)):
            self.stage.wait(0.1)
            self.truth()

    def drive(self, *places: Pose) -> None:
        """Drive straight from place to place, 0.4 m in a second."""
        for place in places:
            begin = np.array(self.robot)
            steps = max(1, round(float(np.hypot(*(np.array(place) - begin)[:2])) / 0.04))
            for step in range(1, steps + 1):
                x, y, theta = (begin + (np.array(place) - begin) * step / steps).tolist()
                self.robot = (x, y, theta)
                self.stand(0.1)

    def goal(self) -> Pose:
        """The goal that was given by now; the robot takes it as its next order."""
        self.stand(0.3)
        (message,) = self.stage.taken("goal_pose")
        goal = planar_pose(message.pose)
        self.orders += 1
        goals = packed_poses(np.array([goal]))
        self.stage.give("navigate_goal", NavigateGoal(mission_id=self.orders, goals=goals))
        self.say(NavigationStatus.DRIVING)
        return goal

    def say(self, state: int, order: int | None = None, recoveries: int = 0) -> None:
        """Tell how the order gets on; the last one, if none is named."""
        status = NavigationStatus(
            header=Header(stamp=from_ns(self.now)),
            mission_id=self.orders if order is None else order,
            state=state,
            recoveries=recoveries,
            reason="as the robot says",
        )
        self.stage.give("navigation_status", status)

    def arrive(self, off: Pose = (0.0, 0.0, 0.0)) -> Pose:
        """Drive to the goal, or so far off, and say to be there; the goal."""
        goal = self.goal()
        self.drive((goal[0] + off[0], goal[1] + off[1], goal[2] + off[2]))
        self.say(NavigationStatus.SUCCEEDED)
        self.stand(0.2)
        return goal

    def touch(self, what: str) -> None:
        """Touch something."""
        self.stage.give("collisions", Collision(obstacle=what, x=1.0, y=2.0, speed=0.3))

    def carried_to(self) -> list[Pose]:
        """Where the robot was to be carried since the last call."""
        return [planar_pose(message.pose) for message in self.stage.taken("kidnap")]

    @property
    def result(self) -> RunResult:
        """What the examiner wrote in the end."""
        self.stand(0.3)
        (end,) = self.stage.ends
        assert end.normal, end.reason
        return RunResult.model_validate_json(self.file.read_text())
