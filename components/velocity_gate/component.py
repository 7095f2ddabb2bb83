"""The component VelocityGate: the only writer of the base's velocity commands."""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

from cairn import (
    LATCHED,
    RELIABLE,
    SECOND,
    SENSOR,
    CairnError,
    Component,
    Config,
    In,
    Out,
    RateLimitedLog,
    every,
    from_ns,
    has_passed,
    on,
    to_ns,
)
from cairn.components.velocity_gate.config import VelocityGateConfig
from cairn.components.velocity_gate.emergency_stop import EmergencyStop
from cairn.components.velocity_gate.limiter import STILL, Velocity, clamp
from cairn.components.velocity_gate.pipeline import CommandPipeline, GateOutput, Surroundings
from cairn.components.velocity_gate.recent_sweeps import RecentSweeps
from cairn.components.velocity_gate.sources import (
    EXTERNAL,
    NAVIGATOR,
    TELEOPERATION,
    OperatorLease,
    Selection,
    SourceSelector,
    velocity_of,
)
from cairn.planar.messages import planar_pose, twist_message
from cairn.planar.odometry import OdometryChange, time_went_back
from cairn.planar.pose_tracker import PoseTracker, Sweep
from cairn.planar.scans import Rays, rays_of
from cairn.planar.waiting_scans import WaitingScans
from cairn.schemas.cairn_nav_msgs import ReasonCode, TeleoperationCommand, VelocityGateStatus
from cairn.schemas.geometry_msgs import Point32, Polygon, PolygonStamped, Twist
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Bool, Header

_RAMP_HZ = 50.0
# The command is repeated so often [ns], as bases stop after 0.3 s; the status so often.
_REPEAT_S, _STATUS_S = 0.05, 0.5
# If nothing was called for so long [ns], this process was held up (the timer runs at 50 Hz); what
# arrives so soon [ns] afterward was queued.
_HELD_UP_NS, _QUEUED_NS = 3 * SECOND // 10, SECOND // 10
# A step of odometry faster than this multiple [1] of the robot's limits is a jump.
_JUMP_FACTOR = 2.0
# Odometry is kept for so long [s], and extrapolated for so long [s] after the newest: by default
# the robot stands then (`odometry_timeout`).
_HORIZON_S, _EXTRAPOLATION_S = 5.0, 0.3

_Hold = tuple[int, str]
"""Why the robot must stand: a `ReasonCode`, and words that are empty if it may drive."""
_FREE: _Hold = ReasonCode.NONE, ""


class VelocityGate(Component):
    """Passes the velocity commands of one source to the base, within limits and clear of obstacles.

    Sources are the navigator, an operator with a lease, and another program. An emergency stop
    stands above all of them until its explicit release. Requests: `stop` and `release_stop`;
    `acquire_lease`, `renew_lease`, `release_lease`, `take_over_lease`; `status`.
    """

    # With `scanner: false`, any program that may change them could drive.
    live_parameters = frozenset()
    config: VelocityGateConfig
    request_roles = MappingProxyType(
        {
            "stop": "operate",
            "release_stop": "operate",
            "acquire_lease": "operate",
            "renew_lease": "operate",
            "release_lease": "operate",
            "take_over_lease": "administer",
            "status": "view",
        }
    )
    urgent_requests = frozenset({"stop"})
    operator_inputs = frozenset({"teleoperation", "emergency_stop"})
    # Another operator could drive by the lease in these commands.
    confidential_inputs = frozenset({"teleoperation"})

    navigator_cmd_vel: In[Twist] = In(qos=SENSOR, optional=True, exclusive=True)
    teleoperation: In[TeleoperationCommand] = In(qos=SENSOR, optional=True)
    external_cmd_vel: In[Twist] = In(qos=SENSOR, optional=True)
    emergency_stop: In[Bool] = In(qos=LATCHED, optional=True)
    hardware_stop: In[Bool] = In(qos=LATCHED, optional=True, exclusive=True)
    scan: In[LaserScan] = In(qos=SENSOR, optional=True, exclusive=True)
    odom: In[Odometry] = In(qos=RELIABLE.with_depth(1000), optional=True, exclusive=True)
    cmd_vel: Out[Twist] = Out(qos=SENSOR, exclusive=True)
    velocity_gate_status: Out[VelocityGateStatus] = Out(qos=LATCHED)
    footprint: Out[PolygonStamped] = Out(qos=LATCHED)

    # Times [ns] of the newest scan, odometry and message of the button, None before them; stamp of
    # the operator's command.
    _scan_at: int | None = None
    _odometry_at: int | None = None
    _pressed_at: int | None = None
    _teleoperated_at = 0

    @classmethod
    def check_neighbors(
        cls, config: Config, neighbors: Mapping[str, Mapping[str, Config]]
    ) -> Iterator[tuple[str, str, str]]:
        """Yield limits lower than the navigator's, braking harder than the base's, missing sensors.

        The gate would reduce the navigator's commands without its knowledge, rely on a deceleration
        that the base does not reach, or never let the robot move.
        """
        assert isinstance(config, VelocityGateConfig)
        for port in ("scan", "odom"):
            if config.scanner and not neighbors[port]:
                yield (
                    "scanner",
                    f"no component publishes {port}, without which the robot stands",
                    f"add its publisher, list {port} under external_topics, or set scanner: false "
                    "for a robot without a scanner",
                )
        for key, limited in (
            ("speed", "speed"),
            ("turn_speed", "turn_speed"),
            ("acceleration", "acceleration"),
            ("deceleration", "acceleration"),
            ("turn_acceleration", "turn_acceleration"),
        ):
            own = getattr(config, key)
            for name, navigator in neighbors["navigator_cmd_vel"].items():
                wanted = getattr(navigator, limited, None)
                if isinstance(wanted, float) and wanted > own:
                    yield (
                        key,
                        f"{own:g} is less than {limited} {wanted:g} of {name}: the gate would "
                        "reduce its commands",
                        f"raise {key} to {wanted:g}, or lower {limited} of {name}",
                    )
        braking = config.braking
        for name, base in neighbors["cmd_vel"].items():
            reached = getattr(base, "acceleration", None)
            if isinstance(reached, float) and reached < braking:
                yield (
                    "braking",
                    f"{braking:g} is more than acceleration {reached:g} of {name}: the robot "
                    "would stop too late before obstacles",
                    f"lower braking to {reached:g}, or raise acceleration of {name}",
                )

    def on_configure(self) -> None:
        """Take the state of the emergency stop; start without commands."""
        try:
            self._stop = EmergencyStop(self.config.state_file, restarted=self.restarts > 0)
        except CairnError as error:
            raise CairnError(f"{self.name}: {error}") from error
        self._lease = OperatorLease(lambda: 1 + secrets.randbelow(2**63 - 1))
        self._warnings = RateLimitedLog(self.log)
        self._refused = dict.fromkeys(("lease", "late", "invalid", "disabled"), 0)
        self._clamped = 0
        self._pressed, self._pressed_at = False, None
        config = self.config
        self._sources = SourceSelector(config.sources())
        self._pipeline = CommandPipeline(config)
        self._speeds = config.speed_limits()
        self._tracker = PoseTracker(
            _HORIZON_S,
            _JUMP_FACTOR * max(config.speed, config.reverse_speed),
            _JUMP_FACTOR * config.turn_speed,
            _EXTRAPOLATION_S,
        )
        self._waiting = WaitingScans()
        self._scans = RecentSweeps(
            round(config.memory * SECOND), config.outline().reach, config.reach()
        )
        self._scan_at = self._odometry_at = None
        self._teleoperated_at = 0
        self._source = ""
        self._limits: set[str] = set()
        self._stepped_at = self._published_at = self.clock.now()
        self._status = VelocityGateStatus()
        self._status_at: int | None = None

    def on_activate(self) -> None:
        """Publish the first status, and the outline of the robot."""
        self._stepped_at = self._published_at = self.clock.now()
        corners = tuple(Point32(x=x, y=y) for x, y in self.config.outline().polygon())
        header = Header(stamp=from_ns(self._stepped_at), frame_id="base_link")
        self.footprint.publish(PolygonStamped(header=header, polygon=Polygon(points=corners)))
        if self._stop.problem:
            self._warnings.warn("file", self._stop.problem)
        if self._stop.engaged:
            self.log.warning(
                "emergency stop is engaged since an earlier run: %s; release it with "
                "`cairn stop --release`",
                self._stop.reason,
            )
        self._step()

    def on_deactivate(self) -> None:
        """Stop the robot."""
        self.cmd_vel.publish(Twist())

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Answer the requests that the class names."""
        now, given = self.clock.now(), dict(arguments)
        if verb == "stop" and set(given) <= {"reason"}:
            self._engage(str(given.get("reason", "requested")))
        elif verb == "release_stop" and not given:
            self._release()
        elif verb == "acquire_lease" and set(given) == {"operator", "seconds"}:
            operator, seconds = _text(given["operator"]), _number(given["seconds"])
            lease = self._lease.acquire(operator, seconds, now)
            self.log.info("operator's lease granted to %s for %.1f s", operator, seconds)
            return self._granted(lease)
        elif verb == "take_over_lease" and set(given) == {"operator", "seconds"}:
            operator, seconds = _text(given["operator"]), _number(given["seconds"])
            lease, before = self._lease.take_over(operator, seconds, now)
            self.log.warning("operator's lease taken over by %s from %s", operator, before or "-")
            return self._granted(lease)
        elif verb == "renew_lease" and set(given) == {"lease", "seconds"}:
            self._lease.renew(_lease(given["lease"]), _number(given["seconds"]), now)
        elif verb == "release_lease" and set(given) == {"lease"}:
            operator = self._lease.operator(now)
            self._lease.release(_lease(given["lease"]), now)
            self._sources.drop(TELEOPERATION)
            self.log.info("operator's lease released by %s", operator)
        elif verb != "status" or given:
            return super().on_request(verb, arguments)
        self._step()
        return {
            "emergency_stop": self._stop.engaged,
            "reason": self._stop.reason,
            "source": self._source,
            "operator": self._lease.operator(now),
        }

    @on("navigator_cmd_vel")
    def on_navigator(self, command: Twist) -> None:
        """Take a command of the navigator."""
        self._take(NAVIGATOR, command)

    @on("external_cmd_vel")
    def on_external(self, command: Twist) -> None:
        """Take a command of another program, if that is enabled."""
        if self.config.external.enabled:
            self._take(EXTERNAL, command)
        else:
            topic = self.external_cmd_vel.topic
            self._refuse(
                "disabled", f"commands on {topic}: the parameter external.enabled is false"
            )

    @on("teleoperation")
    def on_teleoperation(self, command: TeleoperationCommand) -> None:
        """Take a command of the operator who has the lease."""
        now = self.clock.now()
        if not self._lease.is_valid(command.lease, now):
            holder = self._lease.operator(now)
            state = f"{holder} has it" if holder else "it is free"
            self._refuse(
                "lease",
                f"teleoperation without the valid lease ({state}) on {self.teleoperation.topic}",
            )
            return
        stamp = to_ns(command.header.stamp)
        age_s = (now - stamp) / SECOND
        if abs(age_s) > self.config.teleoperation.timeout or stamp <= self._teleoperated_at:
            self._refuse(
                "late",
                f"teleoperation of {self._lease.operator(now)}: {age_s:.2f} s old, or out of order",
            )
            return
        self._teleoperated_at = stamp
        self._take(TELEOPERATION, command.twist)

    @on("emergency_stop")
    def on_emergency_stop(self, message: Bool) -> None:
        """Engage the emergency stop; False does not release it."""
        if message.data:
            self._engage(f"requested on {self.emergency_stop.topic}")
            self._step()

    @on("hardware_stop")
    def on_hardware_stop(self, message: Bool) -> None:
        """Engage the emergency stop while a button or bumper is pressed."""
        self._pressed, self._pressed_at = message.data, self.clock.now()
        if message.data:
            self._engage(f"pressed, on {self.hardware_stop.topic}")
            self._step()

    @on("odom")
    def on_odom(self, odom: Odometry) -> None:
        """Track the robot's motion; forget the scans after a break in odometry."""
        stamp = to_ns(odom.header.stamp)
        twist = odom.twist.twist
        change = self._tracker.add_odometry(
            stamp, planar_pose(odom.pose.pose), twist.linear.x, twist.angular.z
        )
        newest, now = self._tracker.newest, self.clock.now()
        self._odometry_at = None if newest is None else min(newest, now)
        if change in (OdometryChange.JUMPED, OdometryChange.RESET):
            self.log.warning(
                "odometry on %s %s: standing until the next scan",
                self.odom.topic,
                self._tracker.change,
            )
            self._scans.forget()
            self._waiting.clear()
            self._scan_at = None
        if self._waiting.waiting:
            self._take_scans()

    @on("scan")
    def on_scan(self, scan: LaserScan) -> None:
        """Take the points around the robot, and check the command at once."""
        self._waiting.add(scan)
        self._take_scans()
        self._step()

    def _take_scans(self) -> None:
        """Remember the scans that odometry has reached; of the others, take the points for now.

        So the robot stops at once before what a scan shows, although odometry is late.
        """
        for scan in self._waiting.release(self._tracker.newest, self.clock.now()):
            sweep, rays = self._placed(scan)
            if sweep is not None and rays is not None:
                mount = self.config.mount.pose
                self._scans.add(to_ns(scan.header.stamp), sweep.end, mount, scan, rays)
        for_now = [self._placed(scan)[1] for scan in self._waiting.waiting]
        self._scans.set_points_for_now([rays.points() for rays in for_now if rays is not None])

    def _placed(self, scan: LaserScan) -> tuple[Sweep | None, Rays | None]:
        """Return where a scan was taken, and its rays in the odometry frame; None if unknown."""
        sweep = self._tracker.sweep(scan)
        if sweep is None:
            return None, None
        rays = rays_of(scan, self.config.mount.pose, sweep.motion).placed(sweep.end)
        if not rays.informative:
            return sweep, None
        self._scan_at = min(to_ns(scan.header.stamp), self.clock.now())
        return sweep, rays

    @every(hz=_RAMP_HZ)
    def advance(self) -> None:
        """Continue ramps, and stop for stale inputs."""
        limit, now = self.config.hardware_stop_timeout, self.clock.now()
        heard_at = self._pressed_at
        if limit is not None and heard_at is not None and abs(now - heard_at) > limit * SECOND:
            self._engage(f"{self.hardware_stop.topic} has been silent for {limit:g} s")
        self._step()

    def _take(self, source: str, message: Twist) -> None:
        """Take a command of a source, unless the base cannot execute it."""
        velocity = velocity_of(message)
        if velocity is None:
            self._refuse("invalid", f"a command of {source} that moves sideways, up, or tilts")
            return
        self._notice_pause()
        self._clamped += clamp(velocity, self._speeds) != velocity
        if not self._sources.set(source, self.clock.now(), velocity):
            self._refuse("late", f"a command of {source} that was queued while the gate was paused")
            return
        self._step()

    def _refuse(self, kind: str, reason: str) -> None:
        self._refused[kind] = min(self._refused[kind] + 1, 2**32 - 1)
        self._warnings.warn(kind, f"refused {reason}")

    def _engage(self, reason: str) -> None:
        if self._stop.engaged:
            return
        # Before the file is written.
        self.cmd_vel.publish(twist_message(*self._pipeline.halt(0.02)))
        self._stop.engage(reason)
        self.log.warning("emergency stop engaged: %s", self._stop.reason)
        if self._stop.problem:
            self._warnings.warn("file", self._stop.problem)

    def _release(self) -> None:
        if self._pressed:
            raise CairnError(
                f"{self.name}: the emergency stop cannot be released while a button is pressed "
                f"({self.hardware_stop.topic}); release the button first"
            )
        self._sources.drop_all()
        self._pressed_at = None
        if self._stop.release():
            self.log.warning("emergency stop released")
        if self._stop.problem:
            self._warnings.warn("file", self._stop.problem)

    def _granted(self, lease: int) -> dict[str, int]:
        self._sources.drop(TELEOPERATION)
        self._teleoperated_at = 0
        self._step()
        return {"lease": lease, "now_ns": self.clock.now()}

    def _notice_pause(self) -> None:
        """Drop all commands if this process was held up: what was queued arrives now."""
        now = self.clock.now()
        since = now - self._stepped_at
        if time_went_back(self._stepped_at, now) or since > _HELD_UP_NS:
            self._sources.drop_all(now + _QUEUED_NS)
            self._stepped_at = now

    def _step(self) -> None:
        """Publish the next command and status, if they are due."""
        self._notice_pause()
        now = self.clock.now()
        seconds = max(0.0, (now - self._stepped_at) / SECOND)
        self._stepped_at = max(now, self._stepped_at)
        operator = self._lease.operator(now)
        selection = self._sources.select(now, reserved=TELEOPERATION if operator else "")
        if selection is not None and selection.source == TELEOPERATION and not operator:
            self._sources.drop(TELEOPERATION)  # the lease is over
            selection = self._sources.select(now)
        before = self._pipeline.command
        code, held = self._hold(now)
        output = GateOutput(STILL)
        if held:
            output = GateOutput(self._pipeline.halt(seconds))
        else:
            desired = STILL if selection is None else selection.command
            output = self._pipeline.step(
                desired,
                seconds,
                self._surroundings(now),
                operator=selection is not None and selection.source == TELEOPERATION,
            )
            if output.blocked:
                code, held = ReasonCode.OBSTACLE, output.blocked
        self._limits.update(output.limits)
        due = has_passed(_REPEAT_S, self._published_at, now)
        active = selection is not None or self._stop.engaged or before != STILL
        if output.command != before or (active and due):
            self._published_at = now
            self.cmd_vel.publish(twist_message(*output.command))
        self._report(now, selection, operator, (code, held), output.command)

    def _surroundings(self, now: int) -> Surroundings | None:
        robot = self._tracker.odometry_at(now)
        if not self.config.scanner or self._scan_at is None or robot is None:
            return None
        age_s = max(0.0, (now - self._scan_at) / SECOND)
        measured = self._tracker.speed, self._tracker.turn
        return Surroundings(self._scans, robot, age_s, measured, self._tracker.late_s(now))

    def _hold(self, now: int) -> _Hold:
        """Return why the robot must stand, whatever is commanded."""
        if self._stop.engaged:
            return ReasonCode.EMERGENCY_STOP, f"emergency stop: {self._stop.reason}"
        if self.config.hardware_stop_timeout is not None and self._pressed_at is None:
            return ReasonCode.EMERGENCY_STOP, f"{self.hardware_stop.topic} is silent yet"
        if not self.config.scanner:
            return _FREE
        limits = self.config.odometry_timeout, self.config.scan_timeout
        if late := _stale("odometry", self.odom.topic, self._odometry_at, now, limits[0]):
            return ReasonCode.NO_ODOMETRY, late
        if late := _stale("valid scan", self.scan.topic, self._scan_at, now, limits[1]):
            return ReasonCode.NO_SCAN, late
        return _FREE

    def _report(
        self,
        now: int,
        selection: Selection | None,
        operator: str,
        hold: _Hold,
        command: Velocity,
    ) -> None:
        """Publish the status when it changes, and periodically; log what an operator must know."""
        source = "" if selection is None else selection.source
        requested = STILL if selection is None else selection.command
        if source != self._source:
            self.log.info("source changed from %s to %s", self._source or "none", source or "none")
            self._source = source
        last = self._status
        stopped = bool(hold[1])
        changed = (
            (source, operator, self._stop.engaged, stopped, int(hold[0]))
            != (last.source, last.operator, last.emergency_stop, last.stopped, last.reason_code)
        )  # fmt: skip
        due = self._status_at is None or has_passed(_STATUS_S, self._status_at, now)
        if not changed and not due:
            return
        if stopped and hold[0] != last.reason_code and requested != STILL:
            self._warnings.warn("hold", f"holding the robot: {hold[1]}")
        self._status_at = now
        self.report_state(_state(source, operator, hold, stands=requested == command == STILL))
        self._status = VelocityGateStatus(
            header=Header(stamp=from_ns(now), frame_id="base_link"),
            source=source,
            operator=operator,
            emergency_stop=self._stop.engaged,
            stopped=stopped,
            reason=hold[1],
            reason_code=int(hold[0]),
            limits=tuple(sorted(self._limits)),
            requested_speed=requested[0],
            requested_turn=requested[1],
            speed=command[0],
            turn=command[1],
            refused_lease=self._refused["lease"],
            refused_late=self._refused["late"],
            refused_invalid=self._refused["invalid"],
            refused_disabled=self._refused["disabled"],
            clamped=min(self._clamped, 2**32 - 1),
        )
        self._limits.clear()
        self.velocity_gate_status.publish(self._status)


def _state(source: str, operator: str, hold: _Hold, *, stands: bool) -> str:
    """Return the state of the gate for `cairn ps`."""
    held = hold[1]
    lease = f"{operator} has the operator's lease" if operator else ""
    if not held and source and stands:
        drives = f"{source} commands standstill"
    elif not held:
        drives = f"{source or 'no source'} drives"
    elif held.startswith("emergency stop"):
        drives = held
    else:
        drives = f"holds {source or 'the robot'}: {held}"
    return "; ".join(filter(None, (drives, lease)))


def _stale(what: str, topic: str, at: int | None, now: int, limit_s: float) -> str:
    """Return why an input is too old; "" if it is not."""
    if at is None:
        return f"no {what} yet on {topic}"
    if 0 <= now - at <= limit_s * SECOND:
        return ""
    return f"no {what} for more than {limit_s:g} s on {topic}"


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise CairnError(f"seconds: {value!r} is not a number; give the duration of the lease [s]")
    return float(value)


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise CairnError(f"operator: {value!r} is not a text; give the operator's name")
    return value


def _lease(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise CairnError(f"lease: {value!r} is not the id of a lease; use the one that was granted")
    return value
