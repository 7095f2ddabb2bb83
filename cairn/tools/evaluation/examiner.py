"""The component that sends the robot to random goals and writes down what came of it."""

from __future__ import annotations

import math
from collections import deque
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cairn import (
    LATCHED,
    RELIABLE,
    SECOND,
    CairnError,
    Component,
    Config,
    In,
    Out,
    ParameterRejected,
    every,
    on,
    to_ns,
)
from cairn.planar.messages import planar_covariance, planar_pose, planar_poses, pose_message
from cairn.planar.odometry import OdometryHistory
from cairn.planar.poses import Pose, distance, wrap
from cairn.schemas.cairn_nav_msgs import (
    NAVIGATION_END_STATES,
    Collision,
    LocalizationEstimate,
    NavigateGoal,
    NavigationStatus,
)
from cairn.schemas.cairn_sim_msgs import WorldGeometry, WorldState
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.schemas.std_msgs import Header
from cairn.tools.evaluation.attempt import Attempt, Tolerance
from cairn.tools.evaluation.free_goals import free_goal
from cairn.tools.evaluation.localization_quality import LocalizationQuality
from cairn.tools.evaluation.results import GoalResult, RunResult
from cairn.tools.evaluation.shortest_ways import ShortestWays

# Who is carried off with turning wheels needs room to stop [m].
_STOPS_M = 0.35
# Nobody walks within this [m] of where it is set down: its last scan is of another place.
_APART_M = 1.5
_TRIES = 30
# Steps of the truth longer than this [m] are not driven: the robot was carried.
_CARRIED_M = 0.5
# A robot that does not move so long [ns] after it was to be carried off is not: somebody stands
# there, and the world refuses.
_CARRYING_NS = SECOND
# Goals of orders differ from those given by less than this [m], [rad].
_SAME = 1e-6


class ExaminerConfig(Config):
    """What the robot is examined in."""

    goals: int = Field(10, ge=1, le=10_000, description="Goals of the run [1].")
    kidnap_at: int = Field(
        0,
        ge=0,
        description="Number of the goal on the way to which the robot is carried off, or of the "
        "next if that cannot be; 0: none [1].",
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
    position_tolerance: float = Field(
        0.10, gt=0, le=2, description="How near to its goal the robot claims to be at its end [m]."
    )
    heading_tolerance: float = Field(
        0.10, gt=0, le=3.2, description="How well turned it claims to be there [rad]."
    )
    position_allowance: float = Field(
        0.05, ge=0, le=2, description="How much further from its goal it may truly be [m]."
    )
    heading_allowance: float = Field(
        0.05, ge=0, le=3.2, description="How much further it may truly be turned [rad]."
    )
    settle: float = Field(
        3.0, ge=0, le=60, description="How long to wait before the first goal [s]."
    )
    file: Path = Field(description="Where to write the result: a JSON file.")


class NavigationExaminer(Component):
    """Orders the robot to random goals, one after the other, and judges it by the truth.

    The world publishes its geometry (`world_geometry`), the robot's true pose and its contacts; the
    robot itself is only asked what it believes.
    """

    config: ExaminerConfig

    world_geometry: In[WorldGeometry] = In(qos=LATCHED)
    world_state: In[WorldState] = In(qos=RELIABLE.with_depth(200), optional=True)
    truth: In[PoseStamped]
    localization: In[LocalizationEstimate]
    navigate_goal: In[NavigateGoal] = In(qos=LATCHED)
    navigation_status: In[NavigationStatus] = In(qos=LATCHED.with_depth(20))
    collisions: In[Collision] = In(qos=RELIABLE.with_depth(100))
    goal_pose: Out[PoseStamped]
    kidnap: Out[PoseStamped]

    def on_configure(self) -> None:
        """Nothing has begun."""
        config = self.config
        if not config.file.parent.is_dir():
            raise CairnError(f"{config.file}: there is no folder {config.file.parent}")
        self._tolerance = Tolerance(
            config.position_tolerance + config.position_allowance,
            config.heading_tolerance + config.heading_allowance,
        )
        self._segments: NDArray[np.float64] | None = None
        self._ways: ShortestWays | None = None
        self._history = OdometryHistory(5 * SECOND)
        self._here: Pose | None = None
        self._told: deque[LocalizationEstimate] = deque()
        self._quality = LocalizationQuality()
        self._results: list[GoalResult] = []
        self._collisions: list[str] = []
        self._track: list[tuple[float, float]] = []
        self._attempt: Attempt | None = None
        self._began_ns: int | None = None
        self._carrying_ns: int | None = None

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """An examination keeps its rules."""
        raise ParameterRejected("the examiner takes its parameters when it is configured")

    @on("world_geometry")
    def learn(self, scene: WorldGeometry) -> None:
        """Take what stands from now on: ways of later goals are measured in that."""
        self._segments, self._ways = scene.segments.reshape(-1, 4), None

    @on("truth")
    def follow(self, truth: PoseStamped) -> None:
        """Measure the way the robot really takes, and judge what waited for the truth."""
        here, stamp = planar_pose(truth.pose), to_ns(truth.header.stamp)
        if self._began_ns is None:
            self._began_ns = stamp
        before, self._here = self._here or here, here
        if distance(before, here) > _CARRIED_M:
            self._judge_ended(stamp, before)
            self._note_carried(stamp)
        elif self._attempt is not None:
            self._attempt.driven += distance(before, here)
        self._history.add(stamp, here)
        if not self._track or math.dist(self._track[-1], here[:2]) > 0.1:
            self._track.append((round(here[0], 3), round(here[1], 3)))
        while self._told and to_ns(self._told[0].header.stamp) <= stamp:
            self._compare(self._told.popleft())
        self._judge_ended(stamp, here)

    @on("localization")
    def on_localization(self, estimate: LocalizationEstimate) -> None:
        """Compare the estimated pose with the truth of that time, once that is known."""
        if not estimate.located:
            return
        newest = self._history.newest
        if newest is not None and to_ns(estimate.header.stamp) <= newest:
            self._compare(estimate)
        else:
            self._told.append(estimate)

    @on("collisions")
    def note_collision(self, collision: Collision) -> None:
        """Write a collision down."""
        self._collisions.append(
            f"{collision.obstacle} at ({collision.x:.2f}, {collision.y:.2f}), "
            f"{collision.speed:.2f} m/s"
        )

    @on("navigate_goal")
    def note_order(self, order: NavigateGoal) -> None:
        """Learn which number the goal under way has: a result of another one is not its result."""
        attempt = self._attempt
        goals = planar_poses(order.goals).tolist()
        if attempt is None or len(goals) != 1:
            return
        (x, y, theta), goal = goals[0], attempt.goal
        off = max(abs(x - goal[0]), abs(y - goal[1]), abs(wrap(theta - goal[2])))
        if off < _SAME:
            attempt.mission_id = order.mission_id

    @on("navigation_status")
    def judge(self, status: NavigationStatus) -> None:
        """Take the result of the order; it is judged by the next truth."""
        attempt = self._attempt
        if attempt is None or status.mission_id != attempt.mission_id or attempt.end is not None:
            return
        attempt.recoveries = status.recoveries
        if status.state in NAVIGATION_END_STATES:
            attempt.end = status

    @every(hz=5)
    def examine(self) -> None:
        """Give the next goal; carry the robot off; end what takes too long."""
        now, here, began_ns = self.clock.now(), self._here, self._began_ns
        if self._segments is None or here is None or began_ns is None:
            return
        if now - began_ns < self.config.settle * SECOND:
            return
        attempt = self._attempt
        if attempt is not None:
            self._attend(attempt, here, now)
        if self._attempt is None and len(self._results) < self.config.goals:
            self._give_goal(here, now)
        elif self._attempt is None:
            self._write(now)

    def _judge_ended(self, stamp: int, here: Pose) -> None:
        attempt = self._attempt
        if attempt is None or attempt.end is None:
            return
        if to_ns(attempt.end.header.stamp) <= stamp:
            self._close(attempt, here)

    def _attend(self, attempt: Attempt, here: Pose, now: int) -> None:
        waited = (now - attempt.began_ns) / SECOND
        at = self.config.kidnap_at
        carried = attempt.carried_ns is not None or self._kidnapped()
        due = 0 < at <= len(self._results) + 1 and not carried and attempt.end is None
        if due and waited >= self.config.kidnap_after:
            self._carry_off(here, now)
        if waited > self.config.limit:  # the next goal pre-empts the order
            self._close(attempt, here, f"not there after {self.config.limit:.0f} s")

    def _give_goal(self, here: Pose, now: int) -> None:
        config, ways = self.config, self._ways_now()
        room = config.radius + config.clearance
        goal = free_goal(ways, here, config.least_distance, room, self.random)
        if goal is None:
            raise CairnError(f"no goal can be reached from ({here[0]:.2f}, {here[1]:.2f})")
        self._attempt = Attempt(goal, now, ways.length(here[:2], goal[:2]))
        self.goal_pose.publish(PoseStamped(header=Header(frame_id="map"), pose=pose_message(goal)))

    def _carry_off(self, here: Pose, now: int) -> None:
        """Ask for it; again, to another place, as long as the truth does not show it."""
        if self._carrying_ns is not None and now - self._carrying_ns < _CARRYING_NS:
            return
        place = self._place_to_carry_to(here)
        self._carrying_ns = now
        if place is None:
            self.log.warning("there is no place with room enough to carry the robot to")
            return
        self.log.info("the robot is to be carried to (%.2f, %.2f)", place[0], place[1])
        self.kidnap.publish(PoseStamped(header=Header(frame_id="map"), pose=pose_message(place)))

    def _place_to_carry_to(self, here: Pose) -> Pose | None:
        config, state = self.config, self.world_state.latest
        room = config.radius + config.clearance + _STOPS_M
        least = max(config.least_distance, 2.0 * _CARRIED_M)
        people = np.empty((0, 3)) if state is None else state.people.array
        for _ in range(_TRIES):
            place = free_goal(self._ways_now(), here, least, room, self.random)
            if place is None:
                return None
            if (np.hypot(people[:, 0] - place[0], people[:, 1] - place[1]) >= _APART_M).all():
                return place
        return None

    def _note_carried(self, stamp: int) -> None:
        """By us or by the world's events: nobody knows where the robot was on the way."""
        self._history.clear()
        if self._attempt is not None:
            self._attempt.carried_ns, self._attempt.found_ns = stamp, None

    def _kidnapped(self) -> bool:
        return any(result.kidnapped for result in self._results)

    def _compare(self, estimate: LocalizationEstimate) -> None:
        stamp, told = to_ns(estimate.header.stamp), planar_pose(estimate.pose.pose)
        true = self._history.at(stamp)
        if true is None:  # older than what is known, or from before the robot was carried off
            return
        if self._attempt is not None and self._attempt.lost(stamp, told, true):
            return
        self._quality.add(told, planar_covariance(estimate.pose), true)

    def _ways_now(self) -> ShortestWays:
        if self._ways is None:
            assert self._segments is not None  # or nothing is examined yet
            self._ways = ShortestWays(self._segments, self.config.radius)
        return self._ways

    def _close(self, attempt: Attempt, here: Pose, given_up: str = "") -> None:
        self._attempt = None
        result = attempt.judged(here, self.clock.now(), self._tolerance, given_up)
        self._results.append(result)
        self.log.info("goal %d: %s", len(self._results), result)

    def _write(self, now: int) -> None:
        quality = self._quality
        missed = self.config.kidnap_at > 0 and not self._kidnapped()
        result = RunResult(
            seed=0,
            failure="the robot was to be carried off and never was" if missed else "",
            goals=self._results,
            collisions=self._collisions,
            error_median=quality.percentile(50),
            error_p95=quality.percentile(95),
            error_max=quality.percentile(100),
            error_counts=quality.counts(),
            within=quality.within(),
            simulated_s=(now - (self._began_ns or 0)) / SECOND,
            track=self._track,
        )
        try:
            self.config.file.write_text(result.model_dump_json(), encoding="utf-8")
        except OSError as error:
            raise CairnError(
                f"the result cannot be written to {self.config.file}: {error.strerror}"
            ) from error
        self.finish(f"{len(self._results)} goals were tried")
