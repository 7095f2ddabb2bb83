"""Motion control on a bus in virtual time, driving a robot in a small world."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from cairn import LATCHED, RELIABLE, SECOND, SENSOR, Qos, from_ns
from cairn.components.motion_control.component import MotionControl
from cairn.planar.messages import packed_poses, pose_message
from cairn.planar.poses import Pose, compose, wrap
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate, MotionStatus, NavCommand, Plan
from cairn.schemas.geometry_msgs import (
    PoseWithCovariance,
    Twist,
    TwistWithCovariance,
    Vector3,
)
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from tests.cairn.runtime.running import Lockstep, taken
from tests.components.motion_control.world import Array, Robot, World

BEGIN = 1000 * SECOND
STEP = 20_000_000  # [ns] of the base


class Stage:
    """Publishes the messages of the other components; `muted` topics are silent.

    With `simulated_time` the component gets a clock, which may be `set_back`.
    """

    def __init__(
        self, world: World, robot: Robot, *, simulated_time: bool = False, **parameters: Any
    ) -> None:
        self.lockstep = Lockstep()
        self.back = 0
        self.world, self.robot = world, robot
        self.muted: set[str] = set()
        self.beams = 360
        self.mount: Pose = (0.0, 0.0, 0.0)
        self.health = LocalizationEstimate(located=True, health=0.9)
        self.nav_command = NavCommand()
        self.commands: list[tuple[int, float, float]] = []
        self.statuses: list[MotionStatus] = []
        self.clearance = math.inf
        self.random = np.random.default_rng(0)
        self._cmd_vel = self.lockstep.read("cmd_vel", Twist, SENSOR)
        self._status = self.lockstep.read("motion_status", MotionStatus)
        self._tick = 0
        self._command = (0.0, 0.0)
        self._writers: dict[str, Any] = {}
        self.lockstep.run_until(BEGIN)
        self.part = self.lockstep.add(
            MotionControl, parameters=parameters, simulated_time=simulated_time
        )
        self.part.activate()

    @property
    def now(self) -> int:
        """Virtual time [ns]."""
        return BEGIN + self._tick * STEP

    def set_back(self, seconds: float) -> None:
        """Set back all clocks."""
        self.back += round(seconds * SECOND)

    @property
    def status(self) -> MotionStatus:
        """The newest status."""
        return self.statuses[-1]

    def want(
        self, goal_id: int, behavior: int, goal: Pose = (0.0, 0.0, 0.0), distance: float = 0.0
    ) -> None:
        """Command something from now on."""
        self.nav_command = NavCommand(
            goal_id=goal_id, behavior=behavior, goal=pose_message(goal), distance=distance
        )
        self._send("nav_command", self.nav_command, LATCHED)

    def plan(self, goal_id: int, *points: tuple[float, float], **fields: Any) -> None:
        """Publish a path through these points."""
        poses = packed_poses(np.array([(x, y, 0.0) for x, y in points]).reshape(-1, 3))
        self._send("plan", Plan(goal_id=goal_id, poses=poses, **fields), LATCHED)

    def wait(self, seconds: float, until: int | None = None) -> None:
        """Let time pass, or until there is a status with that state."""
        for _ in range(round(seconds * SECOND / STEP)):
            self._step()
            if until is not None and self.statuses and self.status.state == until:
                break

    def _step(self) -> None:
        stamp = from_ns(self.now - self.back)
        self._send("clock", Clock(clock=stamp), RELIABLE)
        if self._tick % 25 == 0:
            self._send("nav_command", self.nav_command, LATCHED)
        twist = Twist(linear=Vector3(x=self.robot.speed), angular=Vector3(z=self.robot.turn))
        self._send(
            "odom",
            Odometry(
                header=Header(stamp=stamp, frame_id="odom"),
                child_frame_id="base_link",
                pose=PoseWithCovariance(pose=pose_message(self.robot.odom)),
                twist=TwistWithCovariance(twist=twist),
            ),
            RELIABLE,
        )
        if self._tick % 5 == 0:
            self._look(stamp)
        self.lockstep.run_until(self.now + STEP - 1)
        for command in taken(self._cmd_vel):
            self._command = (command.linear.x, command.angular.z)
            self.commands.append((self.now, *self._command))
        self.statuses += taken(self._status)
        self.robot.move(self._command, STEP / SECOND)
        self._tick += 1
        self.clearance = min(
            self.clearance, self.world.distance(self._seconds, *self.robot.pose[:2]) - 0.22
        )

    @property
    def _seconds(self) -> float:
        return self._tick * STEP / SECOND

    def _look(self, stamp: Any) -> None:
        noise = self.random.normal(0.0, 0.005, self.beams)
        step = 2 * math.pi / self.beams
        angles: Array = np.arange(self.beams, dtype=np.float64) * step - math.pi
        scanner = compose(self.robot.pose, self.mount)
        ranges = self.world.ranges(self._seconds, scanner, angles, noise)
        self._send(
            "scan",
            LaserScan(
                header=Header(stamp=stamp, frame_id="laser"),
                angle_min=float(np.float32(angles[0])),
                angle_max=float(np.float32(angles[-1])),
                angle_increment=float(np.float32(step)),
                range_max=10.0,
                ranges=ranges.astype(np.float32),
            ),
            SENSOR,
        )
        x, y, theta = self.robot.pose
        dx, dy, turned = self.random.normal(0.0, 0.01, 3)
        seen = pose_message((x + dx, y + dy, wrap(theta + turned)))
        header = Header(stamp=stamp, frame_id="map")
        estimate = replace(self.health, header=header, pose=PoseWithCovariance(pose=seen))
        self._send("localization", estimate, RELIABLE)

    def _send(self, topic: str, message: Any, qos: Qos) -> None:
        if topic in self.muted:
            return
        if topic not in self._writers:
            self._writers[topic] = self.lockstep.observer.advertise(
                f"/robot/{topic}", type(message), qos
            )
        self._writers[topic].publish(message)
