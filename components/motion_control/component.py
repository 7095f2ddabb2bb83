"""The component MotionControl: drives the base along plans, and never into what is seen."""

from __future__ import annotations

import math

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
from cairn.components.motion_control.behaviors import (
    BackOff,
    Behavior,
    Explore,
    Follow,
    LookAround,
    Motion,
    Situation,
    State,
)
from cairn.components.motion_control.config import MotionControlConfig
from cairn.components.motion_control.freshness import Freshness
from cairn.components.motion_control.local_planner import LOOK
from cairn.components.motion_control.movers import Movers
from cairn.components.motion_control.route import Route
from cairn.components.motion_control.seen_space import SeenSpace, Surroundings
from cairn.components.motion_control.steering import STAND, Command, Steering
from cairn.components.motion_control.whereabouts import Whereabouts
from cairn.planar.messages import planar_pose, planar_poses
from cairn.planar.odometry import began_anew
from cairn.planar.poses import Pose, relative
from cairn.planar.scans import rays_of, sweep_s
from cairn.schemas.cairn_nav_msgs import (
    PLAN_REASON_CODES,
    LocalizationEstimate,
    MotionStatus,
    NavCommand,
    Plan,
    ReasonCode,
)
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header

# After a break in odometry or time the robot stands for so long [ns].
_PAUSE_NS = SECOND // 2
# Health must be so much above the limit before a path is followed again.
_REGAINED = 0.05
# A timed command is left out when a scan has just brought one, within this share of the period.
_JUST_NOW = 0.5
_COMMAND_HZ, _STATUS_HZ = 20.0, 5.0  # at least


class MotionControl(Component):
    """Drives the robot along plans among obstacles, and tells how that goes.

    It stands still, and says why, when an input is stale or the robot is lost.
    """

    config: MotionControlConfig
    nav_command: In[NavCommand] = In(qos=LATCHED.with_depth(5))
    plan: In[Plan] = In(qos=LATCHED)
    localization: In[LocalizationEstimate]
    odom: In[Odometry] = In(qos=RELIABLE.with_depth(1000))
    scan: In[LaserScan] = In(qos=SENSOR)
    cmd_vel: Out[Twist] = Out(qos=SENSOR)
    motion_status: Out[MotionStatus]

    def on_configure(self) -> None:
        """Take memory; nothing is wanted yet."""
        self._freshness = Freshness()
        self._nav_command: NavCommand | None = None
        self._plan: Plan | None = None
        self._behavior: Behavior | None = None
        self._done = False
        self._lost = False
        self._paused_until, self._pause = 0, ""
        self._commanded_at = 0
        self._view = (0.0, math.pi)
        self._scan_told = True
        self._around: Surroundings | None = None
        self._motion = Motion(
            state=State.STANDING, reason="nothing is wanted yet", code=ReasonCode.NO_NAV_COMMAND
        )
        self._told: tuple[int, State] | None = None
        self._whereabouts = Whereabouts(self.config.speed, self.config.turn_speed)
        self._take(self.config)

    def on_deactivate(self) -> None:
        """Leave the robot standing."""
        self.cmd_vel.publish(Twist())

    def on_parameters(self, new: Config) -> None:
        """Go on with the new parameters; what was begun begins anew."""
        assert isinstance(new, MotionControlConfig)
        self._take(new)
        self._begin()

    @on("nav_command")
    def want(self, nav_command: NavCommand) -> None:
        """Take what is wanted now."""
        now = self.clock.now()
        self._freshness.note("nav_command", now, now)
        last, self._nav_command = self._nav_command, nav_command
        if last is None or (last.goal_id, last.behavior) != (
            nav_command.goal_id,
            nav_command.behavior,
        ):
            self._done = False
            self._begin()
            self._drive()

    @on("plan")
    def follow(self, plan: Plan) -> None:
        """Take a path, or that there is none."""
        self._plan = plan
        self._route()

    @on("localization")
    def on_localization(self, estimate: LocalizationEstimate) -> None:
        """Note where the robot is in the map, and whether that can be relied on."""
        stamp = to_ns(estimate.header.stamp)
        self._freshness.note("localization", stamp, self.clock.now())
        if estimate.located:
            self._whereabouts.locate(stamp, planar_pose(estimate.pose.pose))
        limit = self.config.health_limit
        if estimate.health < limit or not estimate.located:
            self._lost = True
        elif estimate.health >= min(1.0, limit + _REGAINED):
            self._lost = False

    @on("odom")
    def move(self, odom: Odometry) -> None:
        """Take how the robot moved."""
        stamp, now = to_ns(odom.header.stamp), self.clock.now()
        self._freshness.note("odom", stamp, now)
        twist = odom.twist.twist
        broken = self._whereabouts.move(
            stamp, planar_pose(odom.pose.pose), twist.linear.x, twist.angular.z
        )
        if broken:
            self._begin_anew(now, f"odometry on {self.odom.topic} {broken}")
            self.log.warning("%s: standing for a moment", self._pause)
            self._drive()

    @on("scan")
    def see(self, scan: LaserScan) -> None:
        """Take what is around, and command at once by it."""
        stamp = to_ns(scan.header.stamp)
        ended = stamp + round(sweep_s(scan) * SECOND)
        robot, end = self._whereabouts.odom(stamp), self._whereabouts.odom(ended)
        if robot is None or end is None:
            return
        rays = rays_of(scan, self._mount, relative(robot, end)).placed(end)
        if rays.informative:
            self._freshness.note("scan", stamp, self.clock.now())
        elif self._scan_told:
            self.log.warning("the beams of the scan on %s tell nothing", self.scan.topic)
        self._scan_told = rays.informative
        self._space.add(stamp, robot, rays)
        self._space.expect(self._movers.see(stamp, rays, self._whereabouts.turn))
        self._view = _view(scan, self._mount)
        self._drive()

    @every(hz=_COMMAND_HZ)
    def command(self) -> None:
        """Command even if no scan comes."""
        since = self.clock.now() - self._commanded_at
        if since < 0 or since > _JUST_NOW * SECOND / _COMMAND_HZ:
            self._drive()

    @every(hz=_STATUS_HZ)
    def tell(self) -> None:
        """Tell how it goes."""
        nearest = self._around.nearest if self._around is not None else LOOK
        self.motion_status.publish(
            MotionStatus(
                header=Header(stamp=from_ns(self.clock.now()), frame_id="base_link"),
                goal_id=self._nav_command.goal_id if self._nav_command is not None else 0,
                state=int(self._motion.state),
                reason=self._motion.reason,
                reason_code=int(self._motion.code),
                distance_left=max(0.0, self._motion.left),
                speed=self._whereabouts.speed,
                clearance=max(0.0, nearest - self.config.radius),
            )
        )

    def _take(self, config: MotionControlConfig) -> None:
        self._limits = config.limits()
        self._mount: Pose = config.mount.pose
        self._steering = Steering(self._limits)
        self._movers = Movers()
        self._space = SeenSpace(round(config.memory * SECOND), config.radius)

    def _begin_anew(self, now: int, why: str) -> None:
        """Forget what was seen, and stand for a moment."""
        self._pause, self._paused_until = why, now + _PAUSE_NS
        self._commanded_at = now
        self._space.forget()
        self._movers.forget()
        self._begin()

    def _begin(self) -> None:
        """Begin what is wanted anew, unless it is done."""
        nav_command = self._nav_command if self._nav_command is not None else NavCommand()
        wanted = nav_command.behavior
        self._behavior = None
        if wanted == NavCommand.BACK_OFF:
            self._behavior = BackOff(self._limits)
        elif wanted == NavCommand.LOOK_AROUND:
            self._behavior = LookAround(self._limits)
        elif wanted == NavCommand.EXPLORE:
            self._behavior = Explore(self._limits, nav_command.distance)
        elif wanted == NavCommand.FOLLOW:
            self._route()

    def _route(self) -> None:
        """Follow the plan if it is of the goal_id that is wanted."""
        nav_command, plan = self._nav_command, self._plan
        if nav_command is None or nav_command.behavior != NavCommand.FOLLOW:
            return
        if plan is None or plan.goal_id != nav_command.goal_id:
            return
        if plan.outcome != Plan.FOUND:
            self._behavior = None
            return
        poses = planar_poses(plan.poses)
        goal = planar_pose(nav_command.goal)
        route = Route(poses, goal)
        if isinstance(self._behavior, Follow):
            self._behavior.route = route
            return
        self._behavior = Follow(
            self._limits, route, nav_command.position_tolerance, nav_command.heading_tolerance
        )

    def _drive(self) -> None:
        """Command what is to be done now, and tell if that is something else than before."""
        now = self.clock.now()
        if began_anew(self._commanded_at, now):
            self._begin_anew(now, "time was set back")
        self._commanded_at = now
        self._motion, command = self._judge(now)
        if command is STAND:
            self._steering.stop(now)
        self.cmd_vel.publish(Twist(linear=Vector3(x=command[0]), angular=Vector3(z=command[1])))
        goal_id = self._nav_command.goal_id if self._nav_command is not None else 0
        if self._told != (goal_id, self._motion.state):
            self._told = (goal_id, self._motion.state)
            reason = f": {self._motion.reason}" if self._motion.reason else ""
            self.log.info("%s%s", self._motion.state.name.lower(), reason)
            self.tell()

    def _judge(self, now: int) -> tuple[Motion, Command]:
        stopped = self._stopped(now)
        if stopped is not None:
            return stopped, STAND
        if self._behavior is None:
            return self._no_plan(), STAND
        odom = self._whereabouts.odom(now)
        if odom is None:  # its first time is yet to come
            reason = f"no odom yet on {self.odom.topic}"
            return (
                Motion(state=State.STOPPED, reason=reason, code=ReasonCode.NO_ODOMETRY),
                STAND,
            )
        speed, turn = self._whereabouts.speed, self._whereabouts.turn
        around = self._space.around(odom, LOOK, speed, self._limits.speed)
        self._around = around
        pose = self._whereabouts.pose(now)
        situation = Situation(now, odom, speed, turn, pose, self._space, around, self._view)
        motion = self._behavior.step(situation)
        if motion.state is State.DONE:
            self._done = True
            return motion, STAND
        return motion, self._steering.command(motion.wish, now, (speed, turn), around)

    def _stopped(self, now: int) -> Motion | None:
        """Why it must stand still; None if it may move."""
        nav_command = self._nav_command
        timeouts = self.config.timeouts
        stale = self._freshness.complaint(
            "nav_command", self.nav_command.topic, timeouts.nav_command, now
        )
        if stale or nav_command is None:
            return Motion(state=State.STOPPED, reason=stale, code=ReasonCode.NO_NAV_COMMAND)
        if nav_command.behavior == NavCommand.STAND:
            return Motion(state=State.STANDING)
        if self._done:
            return Motion(state=State.DONE, reason=self._motion.reason, code=self._motion.code)
        code = int(ReasonCode.NO_ODOMETRY)
        stale = self._freshness.complaint("odom", self.odom.topic, timeouts.odom, now)
        if not stale:
            code = ReasonCode.NO_SCAN
            called = "scan" if self._scan_told else "scan that tells anything"
            stale = self._freshness.complaint("scan", self.scan.topic, timeouts.scan, now, called)
        if not stale and now < self._paused_until:
            code, stale = ReasonCode.ODOMETRY_RESET, self._pause
        if not stale and nav_command.behavior == NavCommand.FOLLOW:
            code, stale = self._unsure(now)
        return Motion(state=State.STOPPED, reason=stale, code=code) if stale else None

    def _unsure(self, now: int) -> tuple[int, str]:
        """Return why the pose in the map cannot be relied on; an empty reason if it can."""
        topic, estimate = self.localization.topic, self.localization.latest
        stale = self._freshness.complaint(
            "localization", topic, self.config.timeouts.localization, now
        )
        if not stale and self._lost and estimate is not None:
            return (
                estimate.reason_code,
                f"the robot is lost, health {estimate.health:.2f}: {estimate.reason}",
            )
        if not stale and self._whereabouts.pose(now) is None:
            stale = f"no pose on {topic} since odometry began"
        return ReasonCode.NO_LOCALIZATION, stale

    def _no_plan(self) -> Motion:
        nav_command, plan = self._nav_command, self._plan
        code = int(ReasonCode.NO_PLAN)
        if plan is None or plan.goal_id != (nav_command.goal_id if nav_command is not None else 0):
            reason = f"no plan of this goal_id yet on {self.plan.topic}"
        else:
            code = PLAN_REASON_CODES[plan.outcome]
            reason = f"there is no path: {plan.reason}"
        return Motion(state=State.BLOCKED, reason=reason, code=code)


def _view(scan: LaserScan, mount: Pose) -> tuple[float, float]:
    """The part of a circle around the robot that is seen: middle and half the width [rad]."""
    middle = mount[2] + 0.5 * (scan.angle_min + scan.angle_max)
    return middle, 0.5 * abs(scan.angle_max - scan.angle_min)
