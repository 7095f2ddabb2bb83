"""The component MotionControl: drives the robot along plans and never into obstacles."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

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
    BehaviorInput,
    BehaviorResult,
    Explore,
    Follow,
    LookAround,
    MotionState,
    Reverse,
)
from cairn.components.motion_control.config import MotionControlConfig
from cairn.components.motion_control.followed_path import FollowedPath
from cairn.components.motion_control.local_planner import OBSTACLE_RANGE_M
from cairn.components.motion_control.moving_obstacles import MovingObstacleTracker
from cairn.components.motion_control.safety_stop import SafetyStop
from cairn.components.motion_control.scan_memory import (
    MAX_RANGE_M,
    NearbyObstacles,
    ScanMemory,
)
from cairn.components.motion_control.velocity_limits import STAND, Command, CommandLimiter
from cairn.components.motion_control.zone_limits import ZoneLimits, slowed
from cairn.planar.messages import packed_poses, planar_pose, planar_poses, twist_message
from cairn.planar.odometry import OdometryChange, time_went_back
from cairn.planar.pose_tracker import PoseTracker
from cairn.planar.poses import Pose, compose, relative
from cairn.planar.scans import rays_of
from cairn.planar.waiting_scans import WaitingScans
from cairn.schemas.cairn_nav_msgs import (
    PLAN_REASON_CODES,
    LocalizationEstimate,
    MotionStatus,
    NavCommand,
    Plan,
    ReasonCode,
    VelocityGateStatus,
    Zones,
)
from cairn.schemas.geometry_msgs import PoseArray, Twist
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header

# After a break in odometry or time the robot stands for so long [ns], until scans have arrived:
# five at 10 Hz.
_PAUSE_NS = SECOND // 2
# The timed command is skipped if a scan has triggered one within this share of the period.
_RECENT_SHARE = 0.5
# Minimum rates: the base stops if no command arrives for 0.3 s (six periods), AutoMove if no status
# arrives for 2 s (ten).
_COMMAND_HZ, _STATUS_HZ = 20.0, 5.0
# The robot is assumed to keep its velocity for so long [s] after the newest odometry: by default it
# stands then (`timeouts.odom`).
_EXTRAPOLATION_S = 0.3
# A step of odometry faster than this multiple [1] of the robot's limits is a jump.
_JUMP_FACTOR = 2.0
_HORIZON_S = 5.0  # of odometry
_OBSTRUCTED = (MotionState.BLOCKED, MotionState.STOPPED)
_EXTERNAL = "external"  # source of a VelocityGateStatus: another program


class MotionControl(Component):
    """Drive the robot along plans among obstacles, and report the progress.

    It does not drive into keepout zones of the map, and in slow zones at most at their speed.
    The robot stands still, and reports the reason, when an input is stale or the robot is lost.
    """

    config: MotionControlConfig
    nav_command: In[NavCommand] = In(qos=LATCHED.with_depth(5))
    plan: In[Plan] = In(qos=LATCHED)
    zones: In[Zones] = In(qos=LATCHED, optional=True)
    localization: In[LocalizationEstimate]
    odom: In[Odometry] = In(qos=RELIABLE.with_depth(1000))
    scan: In[LaserScan] = In(qos=SENSOR)
    velocity_gate_status: In[VelocityGateStatus] = In(qos=LATCHED, optional=True)
    cmd_vel: Out[Twist] = Out(qos=SENSOR)
    motion_status: Out[MotionStatus]
    moving_obstacles: Out[PoseArray]

    @classmethod
    def check_neighbors(
        cls, config: Config, neighbors: Mapping[str, Mapping[str, Config]]
    ) -> Iterator[tuple[str, str, str]]:
        """Yield parameters that the path planner has with another value.

        The planner would choose its ways by another speed than the robot's, or passages that the
        robot does not drive through.
        """
        assert isinstance(config, MotionControlConfig)
        # The planner compares its speed only to that of slow zones.
        shared = ("margin", "speed") if neighbors["zones"] else ("margin",)
        for key in shared:
            own = getattr(config, key)
            for name, planner in neighbors["plan"].items():
                planned = getattr(planner, key, None)
                if isinstance(planned, float) and planned != own:
                    yield (
                        key,
                        f"{own:g} is not {key} {planned:g} of {name}, whose paths it follows",
                        f"set {key} of {name} to {own:g}, or this one to {planned:g}",
                    )

    def on_configure(self) -> None:
        """Start without a command."""
        self._safety = SafetyStop(
            {
                "nav_command": self.nav_command.topic,
                "localization": self.localization.topic,
                "odom": self.odom.topic,
                "scan": self.scan.topic,
            }
        )
        self._command: NavCommand | None = None
        self._plan: Plan | None = None
        self._zones = Zones()
        self._in_keepout = ""
        self._behavior: Behavior | None = None
        self._done = False
        self._commanded_at = 0
        self._view = (0.0, math.pi)
        self._obstacles: NearbyObstacles | None = None
        self._result = BehaviorResult(
            state=MotionState.STANDING,
            reason="no navigation command yet",
            code=ReasonCode.NO_NAV_COMMAND,
        )
        self._logged: tuple[int, MotionState] | None = None
        self._gate: VelocityGateStatus | None = None
        self._gate_at = self._gate_blocks_since = 0
        fastest, fastest_turn = self.config.speed, self.config.turn_speed
        self._tracker = PoseTracker(
            _HORIZON_S, _JUMP_FACTOR * fastest, _JUMP_FACTOR * fastest_turn, _EXTRAPOLATION_S
        )
        self._waiting = WaitingScans()
        self._apply(self.config)

    def on_deactivate(self) -> None:
        """Stop the robot."""
        self.cmd_vel.publish(Twist())

    def on_parameters(self, new: Config) -> None:
        """Restart the current behavior with the new parameters."""
        assert isinstance(new, MotionControlConfig)
        self._apply(new)
        self._start_behavior()

    @on("nav_command")
    def on_nav_command(self, command: NavCommand) -> None:
        """Start the commanded behavior if it is new."""
        now = self.clock.now()
        self._safety.note("nav_command", now, now)
        last, self._command = self._command, command
        if last is None or (last.command_id, last.behavior) != (
            command.command_id,
            command.behavior,
        ):
            self._done = False
            self._start_behavior()
            self._drive()

    @on("plan")
    def on_plan(self, plan: Plan) -> None:
        """Take a path, or the information that there is none."""
        self._plan = plan
        self._follow_plan()

    @on("zones")
    def on_zones(self, message: Zones) -> None:
        """Obey the zones of the map from now on."""
        self._zones = message
        self._zone_limits = ZoneLimits(self._limits, message.zones)
        self._drive()

    @on("localization")
    def on_localization(self, estimate: LocalizationEstimate) -> None:
        """Take the pose in the map and its reliability."""
        stamp = to_ns(estimate.header.stamp)
        self._safety.note("localization", stamp, self.clock.now())
        self._safety.note_localization(estimate, self.config.health_limit)
        if estimate.located:
            self._tracker.set_pose(stamp, planar_pose(estimate.pose.pose))

    @on("odom")
    def on_odom(self, odom: Odometry) -> None:
        """Track the robot's motion; pause after a break in odometry."""
        stamp, now = to_ns(odom.header.stamp), self.clock.now()
        self._safety.note("odom", stamp, now)
        twist = odom.twist.twist
        change = self._tracker.add_odometry(
            stamp, planar_pose(odom.pose.pose), twist.linear.x, twist.angular.z
        )
        if change in (OdometryChange.JUMPED, OdometryChange.RESET):
            reason = f"odometry on {self.odom.topic} {self._tracker.change}"
            self._waiting.clear()
            self._restart(now, reason)
            self.log.warning("%s: pausing for %.1f s", reason, _PAUSE_NS / SECOND)
            self._drive()
        self._take_scans()

    @on("scan")
    def on_scan(self, scan: LaserScan) -> None:
        """Take the obstacles around the robot, and command at once, unless odometry is late."""
        self._waiting.add(scan)
        self._take_scans()

    def _take_scans(self) -> None:
        """Take the scans that odometry has reached."""
        for scan in self._waiting.release(self._tracker.newest, self.clock.now()):
            self._take_scan(scan)

    def _take_scan(self, scan: LaserScan) -> None:
        stamp = to_ns(scan.header.stamp)
        sweep = self._tracker.sweep(scan)
        if sweep is None:
            return
        rays = rays_of(scan, self._mount, sweep.motion).placed(sweep.end)
        if rays.informative:
            self._safety.note("scan", stamp, self.clock.now())
        elif self._safety.scan_informative:
            self.log.warning("invalid scan on %s: its beams measure nothing", self.scan.topic)
        self._safety.scan_informative = rays.informative
        self._memory.add(stamp, sweep.start, rays)
        self._memory.set_predictions(self._movers.add_scan(stamp, rays, self._tracker.turn))
        if self.moving_obstacles.has_subscribers:
            header = Header(stamp=scan.header.stamp, frame_id="odom")
            moving = packed_poses(self._movers.moving())
            self.moving_obstacles.publish(PoseArray(header=header, poses=moving))
        self._view = _field_of_view(scan, self._mount)
        self._drive()

    @on("velocity_gate_status")
    def on_velocity_gate_status(self, status: VelocityGateStatus) -> None:
        """Take whether the gate between this component and the base holds the robot."""
        before, now = self._gate, self.clock.now()
        if before is None or not (before.stopped and before.reason_code == ReasonCode.OBSTACLE):
            self._gate_blocks_since = now
        self._gate, self._gate_at = status, now

    @every(hz=_COMMAND_HZ)
    def publish_command(self) -> None:
        """Command even if no scan arrives."""
        since = self.clock.now() - self._commanded_at
        if since < 0 or since > _RECENT_SHARE * SECOND / _COMMAND_HZ:
            self._drive()

    @every(hz=_STATUS_HZ)
    def publish_status(self) -> None:
        """Publish the progress."""
        nearest = self._obstacles.nearest if self._obstacles is not None else OBSTACLE_RANGE_M
        self.motion_status.publish(
            MotionStatus(
                header=Header(stamp=from_ns(self.clock.now()), frame_id="base_link"),
                command_id=self._command_id,
                state=int(self._result.state),
                reason=self._result.reason,
                reason_code=int(self._result.code),
                distance_left=max(0.0, self._result.left),
                speed=self._tracker.speed,
                clearance=max(0.0, nearest - self.config.radius),
            )
        )

    @property
    def _command_id(self) -> int:
        return self._command.command_id if self._command is not None else 0

    def _apply(self, config: MotionControlConfig) -> None:
        self._limits = config.limits()
        self._mount: Pose = config.mount.pose
        self._limiter = CommandLimiter(self._limits)
        self._movers = MovingObstacleTracker()
        self._memory = ScanMemory(round(config.memory * SECOND), config.radius)
        self._zone_limits = ZoneLimits(self._limits, self._zones.zones)

    def _restart(self, now: int, reason: str) -> None:
        """Forget the obstacles, pause, and restart the behavior."""
        self._safety.pause(now + _PAUSE_NS, reason)
        self._commanded_at = self._gate_at = self._gate_blocks_since = now
        self._memory.forget()
        self._movers.forget()
        self._start_behavior()

    def _start_behavior(self) -> None:
        """Start the commanded behavior from its beginning."""
        command = self._command if self._command is not None else NavCommand()
        self._behavior = None
        if command.behavior == NavCommand.BACK_OFF:
            self._behavior = BackOff(self._limits)
        elif command.behavior == NavCommand.LOOK_AROUND:
            self._behavior = LookAround(self._limits)
        elif command.behavior == NavCommand.EXPLORE:
            self._behavior = Explore(self._limits, command.distance)
        elif command.behavior == NavCommand.TURN:
            self._behavior = LookAround(self._limits, command.angle, command.speed)
        elif command.behavior == NavCommand.REVERSE:
            self._behavior = Reverse(self._limits, command.distance, command.speed)
        elif command.behavior == NavCommand.FOLLOW:
            self._follow_plan()

    def _follow_plan(self) -> None:
        """Follow the plan if it belongs to the commanded goal."""
        command, plan = self._command, self._plan
        if command is None or command.behavior != NavCommand.FOLLOW:
            return
        if plan is None or plan.command_id != command.command_id:
            return
        if plan.outcome != Plan.FOUND:
            self._behavior = None
            return
        path = FollowedPath(planar_poses(plan.poses), planar_pose(command.goal))
        if isinstance(self._behavior, Follow):
            self._behavior.path = path
            return
        self._behavior = Follow(
            self._limits, path, command.position_tolerance, command.heading_tolerance
        )

    def _drive(self) -> None:
        """Publish the next velocity command, and log and publish a change of state."""
        now = self.clock.now()
        if time_went_back(self._commanded_at, now):
            self._restart(now, "time was set back")
        self._commanded_at = now
        self._result, command = self._next(now)
        if command is STAND:
            self._limiter.stop(now)
        self.cmd_vel.publish(twist_message(*command))
        if self._logged != (self._command_id, self._result.state):
            before, state = self._logged, self._result.state
            self._logged = (self._command_id, state)
            reason = f": {self._result.reason}" if self._result.reason else ""
            # A robot drives for weeks: what every goal repeats, AutoMove logs once.
            continues = state is MotionState.MOVING and before and before[1] in _OBSTRUCTED
            level = logging.INFO if state in _OBSTRUCTED or continues else logging.DEBUG
            self.log.log(level, "%s%s", state.name.lower(), reason)
            self.publish_status()

    def _next(self, now: int) -> tuple[BehaviorResult, Command]:
        """Return the result of the current behavior and the velocity command."""
        self._take_edges_of_zones(now)
        standing = self._must_stand(now)
        if standing is not None:
            return standing, STAND
        if self._behavior is None:
            return self._without_plan(), STAND
        if self._in_keepout and (waiting := self._waits_in_keepout()):
            return waiting, STAND
        odometry = self._tracker.odometry_at(now)
        if odometry is None:  # its first stamp is in the future
            reason = f"no odom yet on {self.odom.topic}"
            return _stopped(ReasonCode.NO_ODOMETRY, reason), STAND
        speed, turn = self._tracker.speed, self._tracker.turn
        obstacles = self._memory.around(odometry, OBSTACLE_RANGE_M, speed, self._limits.speed)
        self._obstacles = obstacles
        pose = self._tracker.pose_at(now)
        result = self._behavior.step(
            BehaviorInput(now, odometry, speed, turn, pose, self._memory, obstacles, self._view)
        )
        if result.state is MotionState.DONE:
            self._done = True
            return result, STAND
        if pose is not None:
            result = self._within_zones(result, pose, obstacles)
        if result.state is MotionState.MOVING and self._gate_blocks(now):
            assert self._gate is not None
            result = replace(
                result,
                state=MotionState.BLOCKED,
                reason=f"stopped by the velocity gate: {self._gate.reason}",
                code=ReasonCode.OBSTACLE,
            )
        late_s = self._tracker.late_s(now)
        return result, self._limiter.command(result.target, now, (speed, turn), obstacles, late_s)

    def _must_stand(self, now: int) -> BehaviorResult | None:
        """Return the state of a robot that must stand still; None if it may move."""
        command, timeouts = self._command, self.config.timeouts
        stale = self._safety.stale_command(now, timeouts)
        if stale or command is None:
            return _stopped(ReasonCode.NO_NAV_COMMAND, stale)
        if command.behavior == NavCommand.STAND:
            return BehaviorResult(
                state=MotionState.STANDING,
                reason=f"in keepout zone {self._in_keepout}" if self._in_keepout else "",
                code=ReasonCode.IN_KEEPOUT if self._in_keepout else ReasonCode.NONE,
            )
        if self._done:
            last = self._result
            return BehaviorResult(state=MotionState.DONE, reason=last.reason, code=last.code)
        follows = command.behavior == NavCommand.FOLLOW
        pose_known = not follows or self._tracker.pose_at(now) is not None
        code, reason = self._safety.reason(now, timeouts, follows, pose_known)
        if not reason:
            code, reason = self._held_by_gate(now)
        return _stopped(code, reason) if reason else None

    def _take_edges_of_zones(self, now: int) -> None:
        """Take where keepout zones are, as the robot is now."""
        pose = self._tracker.pose_at(now) if self._zones.zones else None
        odometry = self._tracker.odometry_at(now)
        if pose is None or odometry is None:
            self._in_keepout = ""
            self._memory.set_edges(np.empty((0, 2)))
            return
        before, self._in_keepout = self._in_keepout, self._zone_limits.enter(pose)
        if self._in_keepout and not before:
            self.log.warning("the robot is in keepout zone %s", self._in_keepout)
        elif before and not self._in_keepout:
            self.log.info("the robot has left keepout zone %s", before)
        edges = self._zone_limits.edges_near(pose, MAX_RANGE_M)
        x, y, theta = compose(odometry, relative(pose, (0.0, 0.0, 0.0)))  # of the map
        cosine, sine = math.cos(theta), math.sin(theta)
        self._memory.set_edges(edges @ np.array([[cosine, sine], [-sine, cosine]]) + (x, y))

    def _waits_in_keepout(self) -> BehaviorResult | None:
        """Return the state of a robot that must not move in a keepout zone; None if it may.

        It follows a plan that was made with this zone, and nothing else.
        """
        where = f"in keepout zone {self._in_keepout}"
        if isinstance(self._behavior, LookAround):
            return None
        if not isinstance(self._behavior, Follow):
            return _blocked(f"{where}: only a plan leads out of it")
        plan = self._plan
        if plan is None or to_ns(plan.header.stamp) < to_ns(self._zones.header.stamp):
            return _blocked(f"{where}: no plan since the zones changed yet")
        return None

    def _within_zones(
        self, result: BehaviorResult, pose: Pose, obstacles: NearbyObstacles
    ) -> BehaviorResult:
        """Return a result with the speed that zones allow; name the zone that blocks the robot."""
        target = slowed(result.target, self._zone_limits.speed_at(pose))
        result = replace(result, target=target)
        if result.code == ReasonCode.OBSTACLE:
            name, apart = self._zone_limits.nearest(pose)
            if apart <= obstacles.nearest:
                gap = max(0.0, apart - self.config.radius)
                reason = f"keepout zone {name} is in the way, {gap:.2f} m from the robot"
                result = replace(result, reason=reason, code=ReasonCode.KEEPOUT_ZONE)
        return result

    def _held_by_gate(self, now: int) -> tuple[int, str]:
        """Return why the velocity gate does not let this component drive; "" if it does."""
        status = self._gate
        if status is None:  # the deployment has no gate, or it has not started yet
            return ReasonCode.NONE, ""
        age = (now - self._gate_at) / SECOND
        if age > self.config.timeouts.velocity_gate_status:
            topic = self.velocity_gate_status.topic
            return ReasonCode.NO_GATE_STATUS, f"no status of the velocity gate on {topic}"
        if status.stopped and status.reason_code != ReasonCode.OBSTACLE:
            return status.reason_code, f"stopped by the velocity gate: {status.reason}"
        if status.operator:
            driver = f"operator {status.operator} drives"
        elif status.source == _EXTERNAL:
            driver = "commands of another program drive the robot"
        else:
            return ReasonCode.NONE, ""
        return ReasonCode.OPERATOR_DRIVES, f"stopped by the velocity gate: {driver}"

    def _gate_blocks(self, now: int) -> bool:
        """Return whether the gate has seen an obstacle for so long that the robot is blocked."""
        status = self._gate
        if status is None or not status.stopped or status.reason_code != ReasonCode.OBSTACLE:
            return False
        return now - self._gate_blocks_since >= Follow.PATIENCE_NS

    def _without_plan(self) -> BehaviorResult:
        plan = self._plan
        code = int(ReasonCode.NO_PLAN)
        if plan is None or plan.command_id != self._command_id:
            reason = f"no plan of this goal yet on {self.plan.topic}"
        else:
            code = PLAN_REASON_CODES[plan.outcome]
            reason = f"there is no path: {plan.reason}"
            if plan.outcome == Plan.START_IN_KEEPOUT:
                return _stopped(code, plan.reason)
        return BehaviorResult(state=MotionState.BLOCKED, reason=reason, code=code)


def _stopped(code: int, reason: str) -> BehaviorResult:
    return BehaviorResult(state=MotionState.STOPPED, reason=reason, code=code)


def _blocked(reason: str) -> BehaviorResult:
    return BehaviorResult(state=MotionState.BLOCKED, reason=reason, code=ReasonCode.IN_KEEPOUT)


def _field_of_view(scan: LaserScan, mount: Pose) -> tuple[float, float]:
    """Return the scanned part of a circle around the robot: middle and half the width [rad]."""
    middle = mount[2] + 0.5 * (scan.angle_min + scan.angle_max)
    return middle, 0.5 * abs(scan.angle_max - scan.angle_min)
