"""A harness around the examiner: the test publishes as the world and the robot."""

from __future__ import annotations

from pathlib import Path

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
from cairn.testing.lockstep import ComponentHarness
from cairn_lab.evaluation.examiner import NavigationExaminer
from cairn_lab.evaluation.results import RunResult

Box = tuple[float, float, float, float]  # left, bottom, right, top [m]
HALL: Box = (0.0, 0.0, 12.0, 10.0)
START_S = 10.0


def segments_of(*boxes: Box) -> list[list[float]]:
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
    """An examiner that is active; the robot stands at (2, 2) in an empty hall."""

    def __init__(self, folder: Path, **parameters: object) -> None:
        self.file = folder / "result.json"
        self.examiner = ComponentHarness(
            NavigationExaminer,
            {"file": str(self.file), "settle": 0.0, **parameters},
            start_s=START_S,
        )
        self.robot: Pose = (2.0, 2.0, 0.0)
        self.missions = 0
        self.publish_scene()
        self.publish_truth()

    def publish_scene(self, *boxes: Box) -> None:
        """Publish the obstacles in the hall."""
        segments = segments_of(HALL, *boxes)
        count = len(segments)
        geometry = WorldGeometry(
            segments=np.array(segments).ravel(),
            surfaces=np.zeros(count, np.uint8),
            heights=np.full(count, 2.5),
            solids=np.zeros(count, np.uint32),
        )
        self.examiner.publish("world_geometry", geometry)

    def publish_people(self, *positions: tuple[float, float]) -> None:
        """Publish standing people."""
        rows = np.array([(x, y, 0.25) for x, y in positions])
        self.examiner.publish("world_state", WorldState(people=Packed(Point, rows)))

    def publish_truth(self, ago_s: float = 0.0) -> None:
        """Publish the robot's true pose, stamped `ago_s` in the past."""
        self.examiner.publish(
            "truth", PoseStamped(header=self._header(ago_s), pose=pose_message(self.robot))
        )

    def publish_estimate(self, pose: Pose, ago_s: float = 0.0, sigma: float = 0.01) -> None:
        """Publish the robot's estimate of its pose, stamped `ago_s` in the past."""
        estimate = LocalizationEstimate(
            header=self._header(ago_s),
            located=True,
            pose=with_covariance(pose, np.eye(3) * sigma**2),
        )
        self.examiner.publish("localization", estimate)

    def publish_status(self, state: int, mission: int | None = None, recoveries: int = 0) -> None:
        """Publish the status of a mission, of the last one by default."""
        status = NavigationStatus(
            header=Header(stamp=from_ns(self.examiner.now_ns)),
            mission_id=self.missions if mission is None else mission,
            state=state,
            recoveries=recoveries,
            reason="reported by the robot",
        )
        self.examiner.publish("navigation_status", status)

    def publish_collision(self, obstacle: str) -> None:
        """Publish a collision."""
        self.examiner.publish("collisions", Collision(obstacle=obstacle, x=1.0, y=2.0, speed=0.3))

    def stand(self, seconds: float) -> None:
        """Let time pass while the robot stands."""
        for _ in range(round(seconds * 10)):
            self.examiner.run_for(0.1)
            self.publish_truth()

    def drive(self, *poses: Pose) -> None:
        """Drive straight from pose to pose at 0.4 m/s."""
        for pose in poses:
            start = np.array(self.robot)
            steps = max(1, round(float(np.hypot(*(np.array(pose) - start)[:2])) / 0.04))
            for step in range(1, steps + 1):
                x, y, theta = (start + (np.array(pose) - start) * step / steps).tolist()
                self.robot = (x, y, theta)
                self.stand(0.1)

    def accept_goal(self) -> Pose:
        """Return the goal that the examiner has published; the robot accepts it."""
        self.stand(0.3)
        (message,) = self.examiner.take("goal_pose")
        goal = planar_pose(message.pose)
        self.missions += 1
        goals = packed_poses(np.array([goal]))
        self.examiner.publish("navigate_goal", NavigateGoal(mission_id=self.missions, goals=goals))
        self.publish_status(NavigationStatus.DRIVING)
        return goal

    def succeed(self) -> None:
        """Report success."""
        self.publish_status(NavigationStatus.SUCCEEDED)
        self.stand(0.2)

    def arrive(self, offset: Pose = (0.0, 0.0, 0.0)) -> Pose:
        """Drive to the next goal plus `offset`, report success, and return the goal."""
        goal = self.accept_goal()
        self.drive((goal[0] + offset[0], goal[1] + offset[1], goal[2] + offset[2]))
        self.succeed()
        return goal

    def kidnap_targets(self) -> list[Pose]:
        """Return where the examiner asked to move the robot since the last call."""
        return [planar_pose(message.pose) for message in self.examiner.take("kidnap")]

    @property
    def result(self) -> RunResult:
        """The result that the examiner wrote at its end."""
        self.stand(0.3)
        (end,) = self.examiner.ends
        assert end.normal, end.reason
        return RunResult.model_validate_json(self.file.read_text())

    def _header(self, ago_s: float) -> Header:
        stamp = from_ns(self.examiner.now_ns - round(ago_s * SECOND))
        return Header(stamp=stamp, frame_id="map")
