"""The component that sends the robot to random goals and writes down what came of it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from pydantic import Field

from cairn.bus.qos import LATCHED, RELIABLE
from cairn.clock import SECOND, to_ns
from cairn.component.component import Component
from cairn.component.handlers import every, on
from cairn.component.parameters import Config, ParameterRefused
from cairn.component.ports import In, Out
from cairn.errors import CairnError
from components.evaluation.free_goals import FreeGoals
from components.evaluation.localization_quality import LocalizationQuality
from components.evaluation.results import GoalResult, RunResult
from planar.grid import grid_of
from planar.messages import planar_covariance, planar_pose, pose_message
from planar.odometry import OdometryHistory
from planar.poses import Pose, distance
from schemas.cairn_nav_msgs import Collision, MoveStatus
from schemas.geometry_msgs import PoseStamped, PoseWithCovarianceStamped
from schemas.nav_msgs import OccupancyGrid
from schemas.std_msgs import Header

_ENDS = (MoveStatus.SUCCEEDED, MoveStatus.FAILED, MoveStatus.CANCELLED)
# Who is carried off with turning wheels needs room to stop [m].
_STOPS_M = 0.35
# Steps of the truth longer than this [m] are not driven: the robot was carried.
_CARRIED_M = 0.5


class ExaminerConfig(Config):
    """What the robot is examined in."""

    goals: int = Field(10, ge=1, le=10_000, description="Goals of the run [1].")
    kidnap_at: int = Field(
        0,
        ge=0,
        description="Number of the goal on the way to which the robot is carried off; 0: none [1].",
    )
    kidnap_after: float = Field(
        3.0, ge=0, le=600, description="How long after that order it is carried off [s]."
    )
    radius: float = Field(0.22, gt=0, le=5, description="Radius of the robot [m].")
    clearance: float = Field(
        0.15, ge=0, le=5, description="How much further goals keep from obstacles [m]."
    )
    least_distance: float = Field(1.5, ge=0, le=100, description="How far a goal is at least [m].")
    limit: float = Field(
        300.0, gt=0, le=3600, description="How long the robot has for each goal [s]."
    )
    tolerance: float = Field(
        0.25, gt=0, le=5, description="How near to its goal the robot must truly be [m]."
    )
    settle: float = Field(
        3.0, ge=0, le=60, description="How long to wait before the first goal [s]."
    )
    file: Path = Field(description="Where to write the result: a JSON file.")


@dataclass
class _Attempt:
    goal: Pose
    began_ns: int
    shortest: float
    driven: float = 0.0
    carried_ns: int | None = None
    kidnapped: bool = False
    found_s: float | None = None


class NavigationExaminer(Component):
    """Orders the robot to random goals, one after the other, and judges it by the truth."""

    config: ExaminerConfig

    map: In[OccupancyGrid] = In(qos=LATCHED)
    truth: In[PoseStamped]
    pose: In[PoseWithCovarianceStamped]
    move_status: In[MoveStatus] = In(qos=LATCHED)
    collisions: In[Collision] = In(qos=RELIABLE.with_depth(100), optional=True)
    goal_pose: Out[PoseStamped]
    kidnap: Out[PoseStamped]

    def on_configure(self) -> None:
        """Nothing has begun."""
        if not self.config.file.parent.is_dir():
            raise CairnError(f"{self.config.file}: there is no folder {self.config.file.parent}")
        self._free: FreeGoals | None = None
        self._roomy: FreeGoals | None = None
        self._history = OdometryHistory(5 * SECOND)
        self._here: Pose | None = None
        self._quality = LocalizationQuality()
        self._results: list[GoalResult] = []
        self._collisions: list[str] = []
        self._track: list[tuple[float, float]] = []
        self._attempt: _Attempt | None = None
        self._order_id = 0
        self._began_ns: int | None = None
        self._told: Pose | None = None

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """An examination keeps its rules."""
        raise ParameterRefused("the examiner takes its parameters when it is configured")

    @on("map")
    def learn(self, message: OccupancyGrid) -> None:
        """Take the first map: the world as it was surveyed."""
        if self._free is None:
            config, grid = self.config, grid_of(message)
            self._free = FreeGoals(grid, config.radius, config.clearance)
            self._roomy = FreeGoals(grid, config.radius, config.clearance + _STOPS_M)

    @on("truth")
    def follow(self, truth: PoseStamped) -> None:
        """Measure the way the robot really takes."""
        here, stamp = planar_pose(truth.pose), to_ns(truth.header.stamp)
        if self._began_ns is None:
            self._began_ns = stamp
        before, self._here = self._here, here
        if before is not None and distance(before, here) > _CARRIED_M:
            self._history.clear()
        elif before is not None and self._attempt is not None:
            self._attempt.driven += distance(before, here)
        self._history.add(stamp, here)
        if not self._track or math.dist(self._track[-1], here[:2]) > 0.1:
            self._track.append((round(here[0], 3), round(here[1], 3)))

    @on("pose")
    def compare(self, pose: PoseWithCovarianceStamped) -> None:
        """Compare the pose told with the truth of that time."""
        told = self._told = planar_pose(pose.pose.pose)
        stamp = to_ns(pose.header.stamp)
        true = self._history.at(stamp)
        if true is None or self._history.newest is None or stamp > self._history.newest:
            return
        attempt = self._attempt
        if attempt is not None and attempt.carried_ns is not None and attempt.found_s is None:
            if distance(told, true) > 0.5:
                return
            attempt.found_s = max(0.0, (stamp - attempt.carried_ns) / SECOND)
        self._quality.add(told, planar_covariance(pose.pose), true)

    @on("collisions")
    def note_collision(self, collision: Collision) -> None:
        """Write a collision down."""
        self._collisions.append(
            f"{collision.what} at ({collision.x:.2f}, {collision.y:.2f}), {collision.speed:.2f} m/s"
        )

    @on("move_status")
    def judge(self, status: MoveStatus) -> None:
        """Judge an order by its result."""
        attempt = self._attempt
        if attempt is None or status.order_id <= self._order_id or status.state not in _ENDS:
            return
        if to_ns(status.header.stamp) < attempt.began_ns:
            return
        self._order_id = status.order_id
        self._close(status.state == MoveStatus.SUCCEEDED, status.reason, status.recoveries)

    @every(hz=5)
    def examine(self) -> None:
        """Give the next goal; carry the robot off; end what takes too long."""
        now = self.clock.now()
        if self._free is None or self._here is None or self._began_ns is None:
            return
        if now - self._began_ns < self.config.settle * SECOND:
            return
        attempt = self._attempt
        if attempt is None:
            self._next(self._free, self._here, now)
            return
        waited = (now - attempt.began_ns) / SECOND
        due = len(self._results) + 1 == self.config.kidnap_at and not attempt.kidnapped
        if due and waited >= self.config.kidnap_after:
            self._carry_off(self._here, attempt, now)
        if waited > self.config.limit:
            self._close(False, f"not there after {self.config.limit:.0f} s", 0)

    def _next(self, free: FreeGoals, here: Pose, now: int) -> None:
        if len(self._results) >= self.config.goals:
            self._write(now)
            return
        goal = free.draw(here, self.config.least_distance, self.random)
        if goal is None:
            raise CairnError(f"{self.name}: no goal can be reached from ({here[0]}, {here[1]})")
        self._attempt = _Attempt(goal, now, free.shortest(here, goal))
        self.goal_pose.publish(PoseStamped(header=Header(frame_id="map"), pose=pose_message(goal)))

    def _carry_off(self, here: Pose, attempt: _Attempt, now: int) -> None:
        attempt.kidnapped = True
        if self._roomy is None:
            return
        place = self._roomy.draw(here, self.config.least_distance, self.random)
        if place is not None:
            attempt.carried_ns = now
            self.kidnap.publish(
                PoseStamped(header=Header(frame_id="map"), pose=pose_message(place))
            )

    def _close(self, succeeded: bool, reason: str, recoveries: int) -> None:
        attempt, self._attempt = self._attempt, None
        if attempt is None or self._here is None:
            return
        error = distance(self._here, attempt.goal)
        there = error <= self.config.tolerance
        if succeeded and not there:
            reason = f"said to be there, but was {error:.2f} m off"
        self._results.append(
            GoalResult(
                x=attempt.goal[0],
                y=attempt.goal[1],
                reached=succeeded and there,
                reason=reason,
                shortest=attempt.shortest,
                driven=attempt.driven,
                seconds=(self.clock.now() - attempt.began_ns) / SECOND,
                recoveries=recoveries,
                end_error=error,
                kidnapped=attempt.kidnapped,
                relocalised_s=attempt.found_s,
            )
        )
        self.log.info("goal %d: %s", len(self._results), self._results[-1])

    def _write(self, now: int) -> None:
        quality = self._quality
        result = RunResult(
            seed=0,
            goals=self._results,
            collisions=self._collisions,
            error_median=quality.percentile(50),
            error_p95=quality.percentile(95),
            error_max=quality.percentile(100),
            within=quality.within(),
            simulated_s=(now - (self._began_ns or 0)) / SECOND,
            track=self._track,
        )
        try:
            self.config.file.write_text(result.model_dump_json(indent=1), encoding="utf-8")
        except OSError as error:
            raise CairnError(
                f"the result cannot be written to {self.config.file}: {error.strerror}"
            ) from error
        self.finish(f"{len(self._results)} goals were tried")
