"""The component that sends the robot to random goals and judges it by the ground truth."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

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
    FromRobot,
    In,
    Out,
    every,
    on,
    to_ns,
)
from cairn.components.localizer.pose_health import SURE_HEALTH
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
from cairn_lab.evaluation.results import GoalResult, LocalizationQuality, RunResult
from cairn_lab.evaluation.shortest_paths import ShortestPaths

# A kidnapped robot with turning wheels needs this much room to stop [m].
_STOPPING_ROOM_M = 0.35
# No person is within this distance [m] of the place where the robot is put down: its last scan
# shows another place.
_PEOPLE_DISTANCE_M = 1.5
_KIDNAP_TRIES = 30
_GOAL_TRIES = 1000
# Steps of the ground truth longer than this [m] were not driven: the robot was kidnapped.
_KIDNAPPED_M = 0.5
# A kidnapping that does not happen within this time [ns] was rejected by the world: the place was
# occupied.
_KIDNAP_TIMEOUT_NS = SECOND
# A robot whose estimate is within this distance [m], angle [rad] of the truth is relocalized.
_RELOCALIZED_M, _RELOCALIZED_RAD = 0.5, 0.5
# A goal that the robot accepted differs from the published one by less than this [m], [rad].
_SAME_GOAL = 1e-6


class ExaminerConfig(Config):
    """Parameters of the examiner."""

    goals: int = Field(10, ge=1, le=10_000, description="Number of goals in the run [1].")
    kidnap_at: int = Field(
        0,
        ge=0,
        description="Number of the goal on the way to which the robot is kidnapped, or of the next "
        "one if that is not possible; 0: no kidnapping [1].",
    )
    kidnap_after: float = Field(
        3.0, ge=0, le=600, description="Time from that goal to the kidnapping [s]."
    )
    radius: Annotated[float, FromRobot("shape.radius_m")] = Field(
        0.22, gt=0, le=5, description="Radius of the robot [m]."
    )
    clearance: float = Field(
        0.15, ge=0, le=5, description="Additional distance of goals from obstacles [m]."
    )
    least_distance: float = Field(1.5, ge=0, le=100, description="Least distance of a goal [m].")
    limit: float = Field(300.0, gt=0, le=3600, description="Time limit for each goal [s].")
    position_tolerance: float = Field(
        0.10, gt=0, le=2, description="Goal tolerance that the robot promises [m]."
    )
    heading_tolerance: float = Field(
        0.10, gt=0, le=3.2, description="Heading tolerance that the robot promises [rad]."
    )
    position_allowance: float = Field(
        0.05, ge=0, le=2, description="Additional tolerance for the true position [m]."
    )
    heading_allowance: float = Field(
        0.05, ge=0, le=3.2, description="Additional tolerance for the true heading [rad]."
    )
    settle: float = Field(3.0, ge=0, le=60, description="Time before the first goal [s].")
    file: Path = Field(description="Result file (JSON).")


class NavigationExaminer(Component):
    """Sends the robot to random goals, one after the other, and judges it by the ground truth.

    The simulated world publishes the obstacles, the robot's true pose and its collisions.
    The robot contributes only its own estimate and the status of its goals.
    """

    # The rules hold for the whole run.
    live_parameters = frozenset()
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
        """Reset the examination."""
        config = self.config
        if not config.file.parent.is_dir():
            raise CairnError(f"{config.file}: there is no folder {config.file.parent}; create it")
        self._tolerance = Tolerance(
            config.position_tolerance + config.position_allowance,
            config.heading_tolerance + config.heading_allowance,
        )
        self._segments: NDArray[np.float64] | None = None
        self._paths: ShortestPaths | None = None
        self._history = OdometryHistory[int](5 * SECOND)
        self._true_pose: Pose | None = None
        self._pending: deque[LocalizationEstimate] = deque()
        self._quality = LocalizationQuality()
        self._results: list[GoalResult] = []
        self._collisions: list[str] = []
        self._track: list[tuple[float, float]] = []
        self._attempt: Attempt | None = None
        self._started_ns: int | None = None
        self._kidnap_requested_ns: int | None = None

    @on("world_geometry")
    def on_world_geometry(self, geometry: WorldGeometry) -> None:
        """Take the obstacles from now on: later goals are measured among them."""
        self._segments, self._paths = geometry.segments.reshape(-1, 4), None

    @on("truth")
    def on_truth(self, truth: PoseStamped) -> None:
        """Measure the true path, and judge what waited for the truth of its time."""
        pose, stamp = planar_pose(truth.pose), to_ns(truth.header.stamp)
        if self._started_ns is None:
            self._started_ns = stamp
        before, self._true_pose = self._true_pose or pose, pose
        if distance(before, pose) > _KIDNAPPED_M:
            self._close_if_ended(stamp, before)
            self._note_kidnapping(stamp)
        elif self._attempt is not None:
            self._attempt.driven += distance(before, pose)
        self._history.add(stamp, pose)
        if not self._track or math.dist(self._track[-1], pose[:2]) > 0.1:
            self._track.append((round(pose[0], 3), round(pose[1], 3)))
        while self._pending and to_ns(self._pending[0].header.stamp) <= stamp:
            self._compare(self._pending.popleft())
        self._close_if_ended(stamp, pose)

    @on("localization")
    def on_localization(self, estimate: LocalizationEstimate) -> None:
        """Compare the estimated pose with the truth of its time, once that is known."""
        if not estimate.located:
            if self._attempt is not None:
                self._attempt.judge_belief(to_ns(estimate.header.stamp), sure=False, near=False)
            return
        newest = self._history.newest
        if newest is not None and to_ns(estimate.header.stamp) <= newest:
            self._compare(estimate)
        else:
            self._pending.append(estimate)

    @on("collisions")
    def on_collision(self, collision: Collision) -> None:
        """Record a collision."""
        self._collisions.append(
            f"{collision.obstacle} at ({collision.x:.2f}, {collision.y:.2f}), "
            f"{collision.speed:.2f} m/s"
        )

    @on("navigate_goal")
    def on_navigate_goal(self, request: NavigateGoal) -> None:
        """Learn the mission id of the current goal: results of other missions do not count."""
        attempt = self._attempt
        goals = planar_poses(request.goals).tolist()
        if attempt is None or len(goals) != 1:
            return
        (x, y, theta), goal = goals[0], attempt.goal
        difference = max(abs(x - goal[0]), abs(y - goal[1]), abs(wrap(theta - goal[2])))
        if difference < _SAME_GOAL:
            attempt.mission_id = request.mission_id

    @on("navigation_status")
    def on_navigation_status(self, status: NavigationStatus) -> None:
        """Take the result of the mission; the next ground truth judges it."""
        attempt = self._attempt
        if attempt is None or status.mission_id != attempt.mission_id or attempt.end is not None:
            return
        attempt.recoveries = status.recoveries
        if status.state in NAVIGATION_END_STATES:
            attempt.end = status

    @every(hz=5)
    def advance(self) -> None:
        """Publish the next goal, kidnap the robot, or end a goal that takes too long."""
        now, here, started_ns = self.clock.now(), self._true_pose, self._started_ns
        if self._segments is None or here is None or started_ns is None:
            return
        if now - started_ns < self.config.settle * SECOND:
            return
        attempt = self._attempt
        if attempt is not None:
            self._advance_attempt(attempt, here, now)
        if self._attempt is None and len(self._results) < self.config.goals:
            self._publish_goal(here, now)
        elif self._attempt is None:
            self._write_result(now)

    def _close_if_ended(self, stamp: int, here: Pose) -> None:
        attempt = self._attempt
        if attempt is None or attempt.end is None:
            return
        if to_ns(attempt.end.header.stamp) <= stamp:
            self._close(attempt, here)

    def _advance_attempt(self, attempt: Attempt, here: Pose, now: int) -> None:
        elapsed = (now - attempt.started_ns) / SECOND
        at = self.config.kidnap_at
        kidnapped = attempt.kidnapped_ns is not None or self._kidnapped_before()
        due = 0 < at <= len(self._results) + 1 and not kidnapped and attempt.end is None
        if due and elapsed >= self.config.kidnap_after:
            self._request_kidnapping(here, now)
        if elapsed > self.config.limit:  # the next goal preempts this one
            self._close(attempt, here, f"not reached within {self.config.limit:.0f} s")

    def _publish_goal(self, here: Pose, now: int) -> None:
        config, paths = self.config, self._shortest_paths()
        clearance = config.radius + config.clearance
        goal = random_goal(paths, here, config.least_distance, clearance, self.random)
        if goal is None:
            raise CairnError(
                f"no goal can be reached from ({here[0]:.2f}, {here[1]:.2f}); choose a smaller "
                "radius, clearance or least_distance, or another world"
            )
        self._attempt = Attempt(goal, now, paths.length(here[:2], goal[:2]))
        self.goal_pose.publish(PoseStamped(header=Header(frame_id="map"), pose=pose_message(goal)))

    def _request_kidnapping(self, here: Pose, now: int) -> None:
        """Ask the world to move the robot; ask again until the ground truth shows it."""
        requested = self._kidnap_requested_ns
        if requested is not None and now - requested < _KIDNAP_TIMEOUT_NS:
            return
        target = self._kidnap_target(here)
        self._kidnap_requested_ns = now
        if target is None:
            self.log.warning("cannot kidnap the robot: no place has enough room")
            return
        self.log.info("kidnapping the robot to (%.2f, %.2f)", target[0], target[1])
        self.kidnap.publish(PoseStamped(header=Header(frame_id="map"), pose=pose_message(target)))

    def _kidnap_target(self, here: Pose) -> Pose | None:
        config, state = self.config, self.world_state.latest
        clearance = config.radius + config.clearance + _STOPPING_ROOM_M
        least = max(config.least_distance, 2.0 * _KIDNAPPED_M)
        people = np.empty((0, 3)) if state is None else state.people.array
        for _ in range(_KIDNAP_TRIES):
            pose = random_goal(self._shortest_paths(), here, least, clearance, self.random)
            if pose is None:
                return None
            distances = np.hypot(people[:, 0] - pose[0], people[:, 1] - pose[1])
            if (distances >= _PEOPLE_DISTANCE_M).all():
                return pose
        return None

    def _note_kidnapping(self, stamp: int) -> None:
        """Note a kidnapping, by us or by an event of the world: there is no path in between."""
        self._history.clear()
        if self._attempt is not None:
            self._attempt.kidnapped_ns, self._attempt.relocalized_ns = stamp, None

    def _kidnapped_before(self) -> bool:
        return any(result.kidnapped for result in self._results)

    def _compare(self, message: LocalizationEstimate) -> None:
        stamp, estimate = to_ns(message.header.stamp), planar_pose(message.pose.pose)
        true = self._history.at(stamp)
        if true is None:  # older than the history, or from before a kidnapping
            return
        if self._attempt is not None:
            near = (
                distance(estimate, true) <= _RELOCALIZED_M
                and abs(wrap(estimate[2] - true[2])) <= _RELOCALIZED_RAD
            )
            self._attempt.judge_belief(stamp, sure=message.health >= SURE_HEALTH, near=near)
            if self._attempt.is_lost(stamp, near=near):
                return
        self._quality.add(estimate, planar_covariance(message.pose), true)

    def _shortest_paths(self) -> ShortestPaths:
        if self._paths is None:
            assert self._segments is not None  # without it the examination does not start
            self._paths = ShortestPaths(self._segments, self.config.radius)
        return self._paths

    def _close(self, attempt: Attempt, here: Pose, given_up: str = "") -> None:
        self._attempt = None
        result = attempt.result(here, self.clock.now(), self._tolerance, given_up)
        self._results.append(result)
        self.log.info("goal %d: %s", len(self._results), result)

    def _write_result(self, now: int) -> None:
        quality = self._quality
        missed = self.config.kidnap_at > 0 and not self._kidnapped_before()
        result = RunResult(
            seed=0,
            failure="the robot was never kidnapped, although the run asked for it"
            if missed
            else "",
            goals=self._results,
            collisions=self._collisions,
            error_median=quality.percentile(50),
            error_p95=quality.percentile(95),
            error_max=quality.percentile(100),
            error_counts=quality.counts(),
            within=quality.within(),
            simulated_s=(now - (self._started_ns or 0)) / SECOND,
            track=self._track,
        )
        try:
            self.config.file.write_text(result.model_dump_json(), encoding="utf-8")
        except OSError as error:
            raise CairnError(
                f"{self.config.file}: the result cannot be written: {error.strerror}; free the "
                "disk or choose another file"
            ) from error
        self.finish(f"{len(self._results)} goals were tried")


@dataclass(frozen=True)
class Tolerance:
    """How near to its goal the robot must truly be: position [m], heading [rad]."""

    position: float
    heading: float


@dataclass
class Attempt:
    """The current goal, and what has been measured on the way to it.

    `started_ns` is the time of the request, `shortest` [m] the length of the shortest path.
    `mission_id` is None until the robot has accepted the goal; `end` is the last status of that
    mission. `kidnapped_ns` and `relocalized_ns` are None as long as that has not happened. Up to
    the estimate at `judged_ns` the localizer was unsure for `unsure_ns`, and sure of a wrong pose
    for at most `misled_ns`; since `misled_since_ns` it is.
    """

    goal: Pose
    started_ns: int
    shortest: float
    mission_id: int | None = None
    driven: float = 0.0
    recoveries: int = 0
    end: NavigationStatus | None = None
    kidnapped_ns: int | None = None
    relocalized_ns: int | None = None
    judged_ns: int | None = None
    unsure_ns: int = 0
    misled_since_ns: int | None = None
    misled_ns: int = 0

    def judge_belief(self, stamp: int, *, sure: bool, near: bool) -> None:
        """Count the time from the estimate before to this one, of `stamp` [ns].

        `sure`: its health suffices to complete a goal; `near`: the robot is there.
        """
        passed = max(0, stamp - (self.judged_ns or stamp))
        self.judged_ns = stamp
        if not sure:
            self.unsure_ns += passed
        self.misled_since_ns = None if near or not sure else self.misled_since_ns or stamp
        if self.misled_since_ns is not None:
            self.misled_ns = max(self.misled_ns, stamp - self.misled_since_ns)

    def is_lost(self, stamp: int, *, near: bool) -> bool:
        """Return whether the robot was kidnapped and is not relocalized by this estimate either.

        `near`: the robot is where the estimate of `stamp` [ns] says.
        """
        if self.kidnapped_ns is None:
            return False
        if self.relocalized_ns is None and near:
            self.relocalized_ns = stamp
        return self.relocalized_ns is None

    def result(self, true: Pose, now: int, tolerance: Tolerance, given_up: str) -> GoalResult:
        """Return the result with the robot's true pose; `given_up` says why it ended early."""
        error, turn = distance(true, self.goal), abs(wrap(true[2] - self.goal[2]))
        arrived = error <= tolerance.position and turn <= tolerance.heading
        claimed = self.end is not None and self.end.state == NavigationStatus.SUCCEEDED
        reason = given_up or (self.end.reason if self.end is not None else "")
        if claimed and not arrived:
            reason = f"reported success, but was {error:.2f} m and {turn:.2f} rad from the goal"
        relocalized_ns, kidnapped_ns = self.relocalized_ns, self.kidnapped_ns
        return GoalResult(
            x=self.goal[0],
            y=self.goal[1],
            theta=self.goal[2],
            reached=claimed and arrived,
            claimed=claimed,
            reason=reason,
            shortest=self.shortest,
            driven=self.driven,
            seconds=(now - self.started_ns) / SECOND,
            recoveries=self.recoveries,
            end_error=error,
            end_turn=turn,
            kidnapped=kidnapped_ns is not None,
            relocalized_s=None
            if relocalized_ns is None or kidnapped_ns is None
            else (relocalized_ns - kidnapped_ns) / SECOND,
            unsure_s=self.unsure_ns / SECOND,
            misled_s=self.misled_ns / SECOND,
        )


def random_goal(
    paths: ShortestPaths,
    start: Pose,
    least_m: float,
    clearance_m: float,
    random: np.random.Generator,
) -> Pose | None:
    """Return a random reachable pose at least `least_m` [m] from `start`; None if there is none.

    Obstacles are at least `clearance_m` [m] from it.
    """
    left, bottom, right, top = paths.bounds
    for _ in range(_GOAL_TRIES):
        x, y = float(random.uniform(left, right)), float(random.uniform(bottom, top))
        far = math.hypot(x - start[0], y - start[1]) >= least_m
        if (
            far
            and paths.clearance((x, y)) >= clearance_m
            and math.isfinite(paths.length(start[:2], (x, y)))
        ):
            return x, y, float(random.uniform(-math.pi, math.pi))
    return None
