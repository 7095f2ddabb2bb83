"""The component PathPlanner: plans paths around obstacles, or reports why there are none."""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from cairn import (
    LATCHED,
    RELIABLE,
    SECOND,
    SENSOR,
    ActionServer,
    Component,
    Config,
    In,
    Out,
    ServerGoal,
    every,
    from_ns,
    goal,
    has_passed,
    on,
    to_ns,
)
from cairn.components.path_planner.config import PathPlannerConfig
from cairn.components.path_planner.cost_map import CostMap
from cairn.components.path_planner.planning import (
    Planner,
    PlanOutcome,
    PlanResult,
    first_blocked,
    nearest_pose,
    remaining_cost,
)
from cairn.components.path_planner.unmapped_obstacles import (
    AvoidedPositions,
    RecentObstacles,
    StuckDetector,
)
from cairn.planar.grid import OccupancyCells, grid_of
from cairn.planar.messages import (
    WrongFrame,
    duration_message,
    packed_poses,
    planar_pose,
    pose_in_map,
    pose_message,
)
from cairn.planar.odometry import OdometryChange
from cairn.planar.pose_tracker import PoseTracker
from cairn.planar.poses import Pose
from cairn.planar.scans import beams_of
from cairn.planar.waiting_scans import WaitingScans
from cairn.schemas.cairn_nav_msgs import (
    LocalizationEstimate,
    MotionStatus,
    NavCommand,
    Plan,
    Zone,
    Zones,
)
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.schemas.nav2_msgs.action import ComputePathToPose
from cairn.schemas.nav_msgs import OccupancyGrid, Odometry, Path
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header

# Where no other reason is given, these constants were chosen by hand; `lab/constants.yaml`
# has the effect of half and double.

# This near to the goal [m] a path is not replaced by a better one: it could save little.
NEAR_GOAL_M = 0.5
# A new path that is longer by this [m] than the blocked one is a detour: what blocked the old path
# is remembered longer within this radius [m]; otherwise the planner would return to the old path as
# soon as the obstacle is out of view.
DETOUR_M, BLOCKAGE_RADIUS_M = 1.0, 1.0
# An avoided position is so far [m] ahead of a robot that is stuck: just before its front (its
# radius is 0.22 m).
AVOIDED_AHEAD_M = 0.4
# Odometry is kept for so long [s], more than a pose is late; a step faster than this [m/s, rad/s]
# is a jump: about three times the default limits of motion control.
_HORIZON_S, _FASTEST, _FASTEST_TURN = 3.0, 2.0, 4.0
# A scan waits until odometry is no more than this [s] older: a period of 50 Hz. The pose of its
# time is not extrapolated.
_NEARLY_S = 0.02

_ERROR_CODES: Final = {
    PlanOutcome.FOUND: ComputePathToPose.Result.NONE,
    PlanOutcome.NOT_READY: ComputePathToPose.Result.TF_ERROR,
    PlanOutcome.START_BLOCKED: ComputePathToPose.Result.START_OCCUPIED,
    PlanOutcome.START_IN_KEEPOUT: ComputePathToPose.Result.START_OCCUPIED,
    PlanOutcome.GOAL_BLOCKED: ComputePathToPose.Result.GOAL_OCCUPIED,
    PlanOutcome.GOAL_IMPOSSIBLE: ComputePathToPose.Result.GOAL_OCCUPIED,
    PlanOutcome.GOAL_IN_KEEPOUT: ComputePathToPose.Result.GOAL_OCCUPIED,
    PlanOutcome.OUTSIDE_MAP: ComputePathToPose.Result.GOAL_OUTSIDE_MAP,
    PlanOutcome.UNREACHABLE: ComputePathToPose.Result.NO_VALID_PATH,
}
"""The error codes of Nav2 with the same meaning."""

_PLANNERS: Final = ("", "GridBased")
"""Names of the one planner in goals of `compute_path_to_pose`: the second is Nav2's own default."""


class PathPlanner(Component):
    """Plan the path to the goal of the current navigation command, and replan when necessary.

    It replans when an obstacle on the path is seen or mapped, when zones of the map change, when
    the robot has left the path, and when another path has become clearly better.
    """

    config: PathPlannerConfig

    service_roles = MappingProxyType({"compute_path_to_pose": "operate"})

    compute_path_to_pose: ActionServer[
        ComputePathToPose.Goal, ComputePathToPose.Result, ComputePathToPose.Feedback
    ]

    nav_command: In[NavCommand] = In(qos=LATCHED.with_depth(5))
    map: In[OccupancyGrid] = In(qos=LATCHED)
    map_updates: In[OccupancyGridUpdate] = In(qos=RELIABLE.with_depth(50))
    zones: In[Zones] = In(qos=LATCHED, optional=True)
    localization: In[LocalizationEstimate]
    odom: In[Odometry] = In(qos=RELIABLE.with_depth(1000))
    scan: In[LaserScan] = In(qos=SENSOR, optional=True)
    motion_status: In[MotionStatus] = In(optional=True)
    plan: Out[Plan] = Out(qos=LATCHED)
    path: Out[Path] = Out(qos=LATCHED)

    def on_configure(self) -> None:
        """Start without a map, a pose and a goal."""
        self._planner = Planner(self.config.step)
        self._costs: CostMap | None = None
        self._zones: tuple[Zone, ...] = ()
        self._scan_obstacles: RecentObstacles | None = None
        self._avoided = AvoidedPositions()
        self._stuck = StuckDetector()
        self._tracker = PoseTracker(_HORIZON_S, _FASTEST, _FASTEST_TURN)
        self._waiting = WaitingScans(_NEARLY_S)
        self._command: NavCommand | None = None
        self._result: PlanResult | None = None
        self._planned_at = 0
        self._scan_used_at = 0
        self._checked_at = 0
        self._published: tuple[int, int, str] | None = None

    def on_parameters(self, new: Config) -> None:
        """Compute the costs again; the next check of the path uses the new parameters."""
        assert isinstance(new, PathPlannerConfig)
        self._planner = Planner(new.step)
        if self._costs is not None:
            self._update_costs(self._costs.grid, new)

    @on("map")
    def on_map(self, message: OccupancyGrid) -> None:
        """Take a map."""
        grid = grid_of(message)
        if grid.values.size == 0:
            return
        if self._costs is None or not self._costs.replace_map(grid):
            self._update_costs(grid, self.config)
        self._check_path()

    @on("map_updates")
    def on_map_update(self, update: OccupancyGridUpdate) -> None:
        """Take changes in a window of the map."""
        if self._costs is None:
            return
        window = update.data.reshape(update.height, update.width)
        if not self._costs.update(update.y, update.x, window):
            self.log.warning(
                "ignored a map update outside the map: %d x %d cells at column %d, row %d",
                update.width, update.height, update.x, update.y,
            )  # fmt: skip
            return
        self._check_path()

    @on("zones")
    def on_zones(self, message: Zones) -> None:
        """Take the zones of the map, and plan again: motion control waits for a plan with them."""
        self._zones = message.zones
        if self._costs is not None:
            self._costs.set_zones(message.zones)
        if self._command is not None and self._result is not None:
            self.log.info("replanning: the zones of the map changed (version %d)", message.version)
            self._replan()

    @on("odom")
    def on_odom(self, odom: Odometry) -> None:
        """Track the robot's motion."""
        stamp = to_ns(odom.header.stamp)
        change = self._tracker.add_odometry(stamp, planar_pose(odom.pose.pose))
        is_reset = change is OdometryChange.RESET
        if is_reset or change is OdometryChange.JUMPED:
            self._waiting.clear()
            effect = "waiting for a new localization estimate"
            if is_reset:
                effect = "forgetting the scanner's obstacles"
            self.log.warning("odometry on %s %s: %s", self.odom.topic, self._tracker.change, effect)
        if is_reset:
            self._planned_at = self._scan_used_at = self._checked_at = 0
            self._avoided = AvoidedPositions()
            self._stuck = StuckDetector()
            if self._costs is not None:
                self._scan_obstacles = RecentObstacles(self._costs.frame, self._costs.shape)
                self._costs.set_scanner_obstacles(self._scan_obstacles.cells())
                self._costs.set_avoided_positions(())
        self._use_scans()

    @on("localization")
    def on_localization(self, estimate: LocalizationEstimate) -> None:
        """Set the robot's pose; plan if only that was missing."""
        if not estimate.located:
            return
        self._tracker.set_pose(to_ns(estimate.header.stamp), planar_pose(estimate.pose.pose))
        due = has_passed(1 / self.config.check_hz, self._checked_at, self.clock.now() + 1)
        if due or self._waits_for_plan:
            self._check_path()

    @on("scan")
    def on_scan(self, scan: LaserScan) -> None:
        """Take the obstacles that the scanner sees, and check whether the path is still free."""
        now, config = self.clock.now(), self.config
        if self._costs is None or self._scan_obstacles is None or config.obstacle_memory_s == 0:
            return
        if self._command is None or not has_passed(
            1 / config.check_hz, self._scan_used_at, now + 1
        ):
            return
        self._scan_used_at = now
        self._waiting.add(scan)
        self._use_scans()

    def _use_scans(self) -> None:
        """Use the scans that odometry has reached."""
        for scan in self._waiting.release(self._tracker.newest, self.clock.now()):
            self._use_scan(scan)

    def _use_scan(self, scan: LaserScan) -> None:
        config, stamp = self.config, to_ns(scan.header.stamp)
        if self._costs is None or self._scan_obstacles is None:
            return
        pose = self._pose_at(stamp)
        estimate = self.localization.latest
        if pose is None or estimate is None or estimate.health < config.least_health:
            return
        mount = config.mount
        self._scan_obstacles.add_scan(
            stamp,
            pose,
            beams_of(scan, mount.pose),
            (config.radius, config.obstacle_range),
            round(config.obstacle_memory_s * SECOND),
        )
        self._costs.set_scanner_obstacles(self._scan_obstacles.cells())
        self._check_path()

    @on("motion_status")
    def on_motion_status(self, status: MotionStatus) -> None:
        """Look for another path when the robot is stuck."""
        pose, result, command = self._current_pose(), self._result, self._command
        if command is None or status.command_id != command.command_id or pose is None:
            return
        if result is None or result.route is None or self._costs is None:
            return
        now = self.clock.now()
        if not self._stuck.is_stuck(now, status, pose):
            return
        from_index, _ = nearest_pose(result.route, pose)
        x, y, _ = result.route.poses[
            result.route.index_beyond(from_index, AVOIDED_AHEAD_M)
        ].tolist()
        self.log.info("the robot is stuck: avoiding (%.2f, %.2f)", x, y)
        self._avoided.add((x, y), now + round(self.config.avoided_s * SECOND))
        self._costs.set_avoided_positions(self._avoided.positions())
        self._improve(longer=True)

    @on("nav_command")
    def on_nav_command(self, nav_command: NavCommand) -> None:
        """Plan at once for a new goal; a repeated command changes nothing."""
        if nav_command.behavior != NavCommand.FOLLOW:
            self._command, self._result = None, None
            return
        command = self._command
        if command is None or (command.command_id, command.goal) != (
            nav_command.command_id,
            nav_command.goal,
        ):
            self._command, self._result = nav_command, None
            self._replan()

    @goal("compute_path_to_pose")
    def on_compute_path(self, goal: ServerGoal[Any, Any, Any]) -> None:
        """Answer with a path, as Nav2's planner server; the robot does not drive it."""
        began = self.clock.now()
        code, reason, path = self._compute_path(goal.goal)
        result = ComputePathToPose.Result(
            path=path,
            planning_time=duration_message((self.clock.now() - began) / SECOND),
            error_code=code,
            error_msg=reason,
        )
        if code == ComputePathToPose.Result.NONE:
            goal.succeed(result)
        else:
            self.log.info("no path for compute_path_to_pose: %s", reason)
            goal.abort(result)

    def _compute_path(self, asked: ComputePathToPose.Goal) -> tuple[int, str, Path]:
        """Return an error code of `ComputePathToPose.Result`, its reason, and the path."""
        codes, none = ComputePathToPose.Result, Path()
        if asked.planner_id not in _PLANNERS:
            text = f"unknown planner {asked.planner_id!r}; leave planner_id empty"
            return codes.INVALID_PLANNER, text, none
        if self._costs is None:
            return codes.TIMEOUT, self._missing_input(), none
        try:
            target = pose_in_map(asked.goal, "the goal")
            start = pose_in_map(asked.start, "the start") if asked.use_start else None
        except WrongFrame as error:
            return codes.TF_ERROR, str(error), none
        if start is None:
            start = self._current_pose()
            missing = self._missing_input()
            if start is None or missing:
                return codes.TF_ERROR, missing, none
        if self._costs.cell(start[0], start[1]) is None:
            text = f"the start ({start[0]:.2f}, {start[1]:.2f}) is outside the map"
            return codes.START_OUTSIDE_MAP, text, none
        self._forget_old_obstacles()
        result = self._plan_between(self._costs, start, target)
        if result.route is None:
            return _ERROR_CODES[result.outcome], result.reason, none
        header = Header(stamp=from_ns(self.clock.now()), frame_id="map")
        return codes.NONE, "", path_message(header, result, most=len(result.route.poses))

    @every(hz=2)
    def look_for_better_path(self) -> None:
        """Look for a better path, or for a path if there is none."""
        now = self.clock.now()
        if self._command is None or not has_passed(self.config.replan_s, self._planned_at, now + 1):
            return
        if self._result is None or self._result.route is None:
            self._replan()
        else:
            self._improve()

    @property
    def _waits_for_plan(self) -> bool:
        return self._command is not None and self._result is None

    def _update_costs(self, grid: OccupancyCells, config: PathPlannerConfig) -> None:
        self._costs = CostMap(grid, config.costs(), self._zones)
        self._planner.prepare(self._costs)
        if self._scan_obstacles is None or not self._scan_obstacles.fits(
            grid.frame, self._costs.shape
        ):
            self._scan_obstacles = RecentObstacles(grid.frame, self._costs.shape)
        self._costs.set_scanner_obstacles(self._scan_obstacles.cells())
        self._costs.set_avoided_positions(self._avoided.positions())

    def _forget_old_obstacles(self) -> None:
        """Forget expired obstacles of the scanner and expired avoided positions."""
        now = self.clock.now()
        self._avoided.forget(now)
        if self._costs is not None:
            self._costs.set_avoided_positions(self._avoided.positions())
        if self._scan_obstacles is not None and self._costs is not None:
            self._scan_obstacles.forget(now - round(self.config.obstacle_memory_s * SECOND))
            self._costs.set_scanner_obstacles(self._scan_obstacles.cells())

    def _missing_input(self) -> str:
        """Return which input is missing for a plan; empty if none is."""
        topic, estimate = self.localization.topic, self.localization.latest
        if self._costs is None:
            return f"no map yet on {self.map.topic}"
        if estimate is None:
            return f"no localization estimate yet on {topic}"
        if not estimate.located:
            return f"the robot is not located: {estimate.reason or 'no reason given'}"
        if self._tracker.waits_for_pose:
            return (
                f"no localization estimate on {topic} since odometry on {self.odom.topic} restarted"
            )
        if self._current_pose() is None:
            return f"no localization estimate yet on {topic}"
        return ""

    def _current_pose(self) -> Pose | None:
        return self._pose_at(self.clock.now())

    def _pose_at(self, stamp: int) -> Pose | None:
        """Return the pose in the map; the last one as it arrived if odometry begins later."""
        return self._tracker.pose_at(stamp) or self._tracker.last_pose

    def _plan_now(self) -> PlanResult:
        """Plan from the robot's current pose."""
        self._planned_at = self.clock.now()
        self._forget_old_obstacles()
        pose, command = self._current_pose(), self._command
        assert command is not None
        missing = self._missing_input()
        if missing or pose is None or self._costs is None:
            return PlanResult(PlanOutcome.NOT_READY, reason=missing)
        return self._plan_between(self._costs, pose, planar_pose(command.goal))

    def _plan_between(self, costs: CostMap, start: Pose, goal: Pose) -> PlanResult:
        leaves = self.config.in_keepout == "leave"
        return self._planner.plan(costs, start, goal, may_leave_keepout=leaves)

    def _replan(self) -> None:
        result = self._plan_now()
        self._result = None if result.outcome is PlanOutcome.NOT_READY else result
        self._publish(result)

    def _improve(self, longer: bool = False) -> None:
        """Replace the path by one that is clearly cheaper and, unless `longer`, shorter."""
        pose, costs, result = self._current_pose(), self._costs, self._result
        if pose is None or costs is None or result is None or result.route is None:
            return
        from_index, _ = nearest_pose(result.route, pose)
        left = result.route.length(from_index)
        if left < NEAR_GOAL_M:
            return
        new = self._plan_now()
        if new.route is None:
            return
        share, length = 1 - self.config.gain, new.route.length()
        cheaper = remaining_cost(costs, new.route) < share * remaining_cost(
            costs, result.route, from_index
        )
        if cheaper and (longer or length < share * left):
            self.log.info("took a better path: %.1f m instead of %.1f m", length, left)
            self._result = new
            self._publish(new)

    def _check_path(self) -> None:
        """Replan if the path is blocked or the robot has left it."""
        self._checked_at = self.clock.now()
        if self._waits_for_plan:
            self._replan()
            return
        pose, costs, result = self._current_pose(), self._costs, self._result
        if pose is None or costs is None or result is None or result.route is None:
            return
        from_index, deviation = nearest_pose(result.route, pose)
        if deviation > self.config.off_path:
            self.log.info("replanning: the robot is %.2f m off the path", deviation)
            self._replan()
        elif (at := first_blocked(costs, result.route, from_index)) is not None:
            x, y, _ = result.route.poses[at].tolist()
            self.log.info("replanning: the path is blocked at (%.2f, %.2f)", x, y)
            left = result.route.length(from_index)
            self._replan()
            self._remember_blockage(x, y, left)

    def _remember_blockage(self, x: float, y: float, left: float) -> None:
        """Remember longer what blocked a path of `left` [m], if it makes a detour necessary."""
        result, recent = self._result, self._scan_obstacles
        if result is None or result.route is None or recent is None:
            return
        if result.route.length() > left + DETOUR_M:
            until = self.clock.now() + round(self.config.avoided_s * SECOND)
            recent.remember_near(x, y, BLOCKAGE_RADIUS_M, until)

    def _publish(self, result: PlanResult) -> None:
        """Publish a result, except for the same failure as last time."""
        assert self._command is not None
        summary = (self._command.command_id, int(result.outcome), result.reason)
        if result.route is None and summary == self._published:
            return
        if result.route is None:
            self.log.info("no path: %s", result.reason)
        self._published = summary
        header = Header(stamp=from_ns(self.clock.now()), frame_id="map")
        self.plan.publish(plan_message(header, self._command.command_id, result))
        self.path.publish(path_message(header, result))


MAX_SHOWN_POSES = 500  # poses of a path for display


def plan_message(header: Header, command_id: int, result: PlanResult) -> Plan:
    """Return the result for a goal as a message."""
    nearest = result.nearest or (float("nan"), float("nan"))
    message = Plan(
        header=header,
        command_id=command_id,
        outcome=int(result.outcome),
        reason=result.reason,
        nearest_x=nearest[0],
        nearest_y=nearest[1],
    )
    route = result.route
    if route is None:
        return message
    return replace(message, length=route.length(), poses=packed_poses(route.poses))


def path_message(header: Header, result: PlanResult, most: int = MAX_SHOWN_POSES) -> Path:
    """Return the poses of a result, evenly chosen if there are more than `most`.

    The message has no poses without a path.
    """
    if result.route is None:
        return Path(header=header)
    poses = result.route.poses
    indices = np.linspace(0, len(poses) - 1, min(len(poses), most)).astype(np.int64)
    return Path(
        header=header,
        poses=tuple(
            PoseStamped(header=header, pose=pose_message((x, y, theta)))
            for x, y, theta in poses[indices].tolist()
        ),
    )
