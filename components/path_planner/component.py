"""The component PathPlanner: paths past what map and scanner show, or why there are none."""

from __future__ import annotations

from cairn import (
    LATCHED,
    RELIABLE,
    SECOND,
    SENSOR,
    Component,
    Config,
    In,
    Out,
    every,
    from_ns,
    on,
    to_ns,
)
from cairn.components.path_planner.config import PathPlannerConfig
from cairn.components.path_planner.cost_map import CostMap
from cairn.components.path_planner.hindrances import Hindrances
from cairn.components.path_planner.messages import path_message, plan_message
from cairn.components.path_planner.planning import (
    Answer,
    Outcome,
    Planner,
    cost_left,
    obstructed,
    remaining,
)
from cairn.components.path_planner.sightings import RecentObstacles
from cairn.components.path_planner.whereabouts import Moved, Whereabouts
from cairn.planar.grid import OccupancyCells, grid_of
from cairn.planar.messages import planar_pose
from cairn.planar.poses import Pose
from cairn.planar.scans import beams_of
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate, MotionStatus, NavCommand, Plan
from cairn.schemas.map_msgs import OccupancyGridUpdate
from cairn.schemas.nav_msgs import OccupancyGrid, Odometry, Path
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header

# Nearer to the goal than this [m] a path is not exchanged for a better one.
NEAR_M = 0.5
# A path so much longer than what was left [m] is another way; what the scanner saw this near [m] to
# where the last one was blocked is remembered longer, or it would be taken again once out of view.
OTHER_M, AROUND_M = 1.0, 1.0
# The robot stands so far [m] before where it does not get on.
BEFORE_M = 0.4


class PathPlanner(Component):
    """Plans the path to the goal of the nav_command wanted, and plans anew when that is due.

    Due: what is in the way is seen or mapped, the robot has left the path, or another path has
    become clearly better.
    """

    config: PathPlannerConfig
    nav_command: In[NavCommand] = In(qos=LATCHED.with_depth(5))
    map: In[OccupancyGrid] = In(qos=LATCHED)
    map_updates: In[OccupancyGridUpdate] = In(qos=RELIABLE.with_depth(50))
    localization: In[LocalizationEstimate]
    odom: In[Odometry] = In(qos=RELIABLE.with_depth(1000))
    scan: In[LaserScan] = In(qos=SENSOR, optional=True)
    motion_status: In[MotionStatus] = In(optional=True)
    plan: Out[Plan] = Out(qos=LATCHED)
    path: Out[Path] = Out(qos=LATCHED)

    def on_configure(self) -> None:
        """Begin without a map, a pose and anything to do."""
        self._planner = Planner(self.config.step)
        self._costs: CostMap | None = None
        self._recent: RecentObstacles | None = None
        self._hindrances = Hindrances()
        self._whereabouts = Whereabouts()
        self._wanted: NavCommand | None = None
        self._answer: Answer | None = None
        self._planned_at = 0
        self._looked_at = 0
        self._checked_at = 0
        self._told: tuple[int, int, str] | None = None

    def on_parameters(self, new: Config) -> None:
        """Price the map anew where that is due; the next check of the path goes by it."""
        assert isinstance(new, PathPlannerConfig)
        self._planner = Planner(new.step)
        if self._costs is not None:
            self._price(self._costs.grid, new)

    @on("map")
    def use_map(self, message: OccupancyGrid) -> None:
        """Take a map."""
        grid = grid_of(message)
        if grid.values.size == 0:
            return
        if self._costs is None or not self._costs.take(grid):
            self._price(grid, self.config)
        self._check()

    @on("map_updates")
    def update_map(self, update: OccupancyGridUpdate) -> None:
        """Take what has changed in a window of the map."""
        if self._costs is None:
            return
        window = update.data.reshape(update.height, update.width)
        if not self._costs.update(update.y, update.x, window):
            self.log.warning(
                "a map update of %d x %d cells at column %d, row %d leaves the map: ignored",
                update.width, update.height, update.x, update.y,
            )  # fmt: skip
            return
        self._check()

    @on("odom")
    def follow(self, odom: Odometry) -> None:
        """Remember how the robot moves."""
        stamp = to_ns(odom.header.stamp)
        moved = self._whereabouts.move(stamp, planar_pose(odom.pose.pose))
        if moved is Moved.JUMPED:
            self.log.warning(
                "odometry on %s jumped: waiting for a pose since then", self.odom.topic
            )
        elif moved is Moved.SET_BACK:
            self.log.warning(
                "odometry on %s went back in time: what was seen is forgotten", self.odom.topic
            )
            self._planned_at = self._looked_at = self._checked_at = 0
            self._hindrances = Hindrances()
            if self._costs is not None:
                self._recent = RecentObstacles(self._costs.frame, self._costs.shape)
                self._costs.overlay(self._recent.cells())
                self._costs.hinder(())

    @on("localization")
    def on_localization(self, estimate: LocalizationEstimate) -> None:
        """Note where the robot is; plan if that was all that was missing."""
        if not estimate.located:
            return
        self._whereabouts.locate(to_ns(estimate.header.stamp), planar_pose(estimate.pose.pose))
        if self._due():
            self._check()

    @on("scan")
    def look(self, scan: LaserScan) -> None:
        """Take what the scanner sees as obstacles, and see whether the path is still free."""
        now, config = self.clock.now(), self.config
        if self._costs is None or self._recent is None or config.obstacle_memory_s == 0:
            return
        if self._wanted is None or now - self._looked_at < SECOND / config.check_hz - 1:
            return
        self._looked_at = now
        stamp = to_ns(scan.header.stamp)
        pose = self._whereabouts.at(stamp)
        estimate = self.localization.latest
        if pose is None or estimate is None or estimate.health < config.least_health:
            return
        mount = config.mount
        self._recent.see(
            stamp,
            pose,
            beams_of(scan, mount.pose),
            (config.radius, config.obstacle_range),
            round(config.obstacle_memory_s * SECOND),
        )
        self._costs.overlay(self._recent.cells())
        self._check()

    @on("motion_status")
    def heed(self, status: MotionStatus) -> None:
        """Look for another way when motion control does not get on along the path."""
        pose, answer, wanted = self._now_at(), self._answer, self._wanted
        if wanted is None or status.goal_id != wanted.goal_id or pose is None:
            return
        if answer is None or answer.route is None or self._costs is None:
            return
        now = self.clock.now()
        if not self._hindrances.is_stuck(now, status, pose):
            return
        since, _ = remaining(answer.route, pose)
        x, y, _ = answer.route.poses[answer.route.further(since, BEFORE_M)].tolist()
        self.log.info("the robot does not get on at (%.2f, %.2f): avoiding it", x, y)
        self._hindrances.add((x, y), now + round(self.config.avoided_s * SECOND))
        self._costs.hinder(self._hindrances.places())
        self._improve(longer=True)

    @on("nav_command")
    def want(self, nav_command: NavCommand) -> None:
        """Plan at once for a new goal_id; a repeated want changes nothing."""
        if nav_command.behavior != NavCommand.FOLLOW:
            self._wanted, self._answer = None, None
            return
        wanted = self._wanted
        if wanted is None or (wanted.goal_id, wanted.goal) != (
            nav_command.goal_id,
            nav_command.goal,
        ):
            self._wanted, self._answer = nav_command, None
            self._replan()

    @every(hz=2)
    def reconsider(self) -> None:
        """Look for a better path, or for one where there is none."""
        now = self.clock.now()
        if self._wanted is None or now - self._planned_at < self.config.replan_s * SECOND - 1:
            return
        if self._answer is None or self._answer.route is None:
            self._replan()
        else:
            self._improve()

    def _due(self) -> bool:
        period = SECOND / self.config.check_hz - 1
        return self._waiting or self.clock.now() - self._checked_at >= period

    @property
    def _waiting(self) -> bool:
        return self._wanted is not None and self._answer is None

    def _price(self, grid: OccupancyCells, config: PathPlannerConfig) -> None:
        self._costs = CostMap(grid, config.costs())
        self._planner.prepare(self._costs)
        if self._recent is None or not self._recent.fits(grid.frame, self._costs.shape):
            self._recent = RecentObstacles(grid.frame, self._costs.shape)
        self._costs.overlay(self._recent.cells())
        self._costs.hinder(self._hindrances.places())

    def _forget(self) -> None:
        """Forget what the scanner has not seen for too long, and what was avoided."""
        now = self.clock.now()
        self._hindrances.forget(now)
        if self._costs is not None:
            self._costs.hinder(self._hindrances.places())
        if self._recent is not None and self._costs is not None:
            self._recent.forget(now - round(self.config.obstacle_memory_s * SECOND))
            self._costs.overlay(self._recent.cells())

    def _missing(self) -> str:
        """What is still missing for a plan; nothing if all is there."""
        topic, estimate = self.localization.topic, self.localization.latest
        if self._costs is None:
            return f"no map has come on {self.map.topic} yet"
        if estimate is None:
            return f"no pose has come on {topic} yet"
        if not estimate.located:
            return f"the robot is not located: {estimate.reason or 'no reason given'}"
        if self._whereabouts.lost:
            return f"no pose on {topic} since odometry on {self.odom.topic} began anew"
        if self._now_at() is None:
            return f"no pose has come on {topic} yet"
        return ""

    def _now_at(self) -> Pose | None:
        return self._whereabouts.at(self.clock.now())

    def _fresh(self) -> Answer:
        """Plan from where the robot is now."""
        self._planned_at = self.clock.now()
        self._forget()
        pose, wanted = self._now_at(), self._wanted
        assert wanted is not None
        missing = self._missing()
        if missing or pose is None or self._costs is None:
            return Answer(Outcome.NOT_READY, reason=missing)
        return self._planner.plan(self._costs, pose, planar_pose(wanted.goal))

    def _replan(self) -> None:
        answer = self._fresh()
        self._answer = None if answer.outcome is Outcome.NOT_READY else answer
        self._tell(answer)

    def _improve(self, longer: bool = False) -> None:
        """Exchange the path for another that is clearly shorter, or may be `longer` but cheaper."""
        pose, costs, answer = self._now_at(), self._costs, self._answer
        if pose is None or costs is None or answer is None or answer.route is None:
            return
        since, _ = remaining(answer.route, pose)
        left = answer.route.length(since)
        if left < NEAR_M:
            return
        fresh = self._fresh()
        if fresh.route is None:
            return
        share, length = 1 - self.config.gain, fresh.route.length()
        cheaper = cost_left(costs, fresh.route) < share * cost_left(costs, answer.route, since)
        if cheaper and (longer or length < share * left):
            self.log.info("a path of %.1f m instead of %.1f m is taken", length, left)
            self._answer = fresh
            self._tell(fresh)

    def _check(self) -> None:
        """Plan anew if the path is blocked or the robot has left it."""
        self._checked_at = self.clock.now()
        if self._waiting:
            self._replan()
            return
        pose, costs, answer = self._now_at(), self._costs, self._answer
        if pose is None or costs is None or answer is None or answer.route is None:
            return
        since, off = remaining(answer.route, pose)
        if off > self.config.off_path:
            self.log.info("%.2f m off the path: planning anew", off)
            self._replan()
        elif (at := obstructed(costs, answer.route, since)) is not None:
            x, y, _ = answer.route.poses[at].tolist()
            self.log.info("the path is blocked at (%.2f, %.2f): planning anew", x, y)
            left = answer.route.length(since)
            self._replan()
            self._remember(x, y, left)

    def _remember(self, x: float, y: float, left: float) -> None:
        """Remember longer what blocked a path, `left` [m] long, if it has made another way due."""
        answer, recent = self._answer, self._recent
        if answer is None or answer.route is None or recent is None:
            return
        if answer.route.length() > left + OTHER_M:
            until = self.clock.now() + round(self.config.avoided_s * SECOND)
            recent.keep(x, y, AROUND_M, until)

    def _tell(self, answer: Answer) -> None:
        """Publish an answer, unless it is the last one's refusal again."""
        assert self._wanted is not None
        told = (self._wanted.goal_id, int(answer.outcome), answer.reason)
        if answer.route is None and told == self._told:
            return
        if answer.route is None:
            self.log.info("no path: %s", answer.reason)
        self._told = told
        header = Header(stamp=from_ns(self.clock.now()), frame_id="map")
        self.plan.publish(plan_message(header, self._wanted.goal_id, answer))
        self.path.publish(path_message(header, answer))
