"""Motion control in virtual time, driving a simulated robot in a small world."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from cairn import SECOND, from_ns
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
from cairn.testing.lockstep import ComponentHarness
from tests.components.motion_control.world import Array, Robot, World

START_S = 1000.0
STEP = 20_000_000  # [ns] of the base


class SimulatedDrive:
    """Motion control and a robot that follows its commands; publishes the messages it needs.

    `muted` topics are silent. With `simulated_time` the component gets a clock, which
    `set_clocks_back` sets back. Odometry is delayed at random, within the limits
    `odometry_delay_s` [s], and a share of `odometry_loss` [1] is lost. `commands` holds time [ns],
    speed [m/s] and turn rate [rad/s].
    """

    def __init__(
        self, world: World, robot: Robot, *, simulated_time: bool = False, **parameters: Any
    ) -> None:
        self.world, self.robot = world, robot
        self.muted: set[str] = set()
        self.beams = 360
        self.odometry_delay_s = (0.0, 0.0)
        self.odometry_loss = 0.0
        self._delayed: list[tuple[int, Odometry]] = []
        self.mount: Pose = (0.0, 0.0, 0.0)
        self.localization = LocalizationEstimate(located=True, health=0.9)
        self.commands: list[tuple[int, float, float]] = []
        self.statuses: list[MotionStatus] = []
        self.clearance = math.inf
        self.random = np.random.default_rng(0)
        self._delays = np.random.default_rng(1)
        self._nav_command = NavCommand()
        self._clocks_behind = 0
        self._tick = 0
        self._command = (0.0, 0.0)
        self.motion_control = ComponentHarness(
            MotionControl, parameters, start_s=START_S, simulated_time=simulated_time
        )

    @property
    def now(self) -> int:
        """Virtual time [ns]."""
        return round(START_S * SECOND) + self._tick * STEP

    @property
    def status(self) -> MotionStatus:
        """The newest status."""
        return self.statuses[-1]

    def set_clocks_back(self, seconds: float) -> None:
        """Set back all clocks."""
        self._clocks_behind += round(seconds * SECOND)

    def command(
        self, command_id: int, behavior: int, goal: Pose = (0.0, 0.0, 0.0), distance: float = 0.0
    ) -> None:
        """Publish a navigation command, now and every half second."""
        self._nav_command = NavCommand(
            command_id=command_id, behavior=behavior, goal=pose_message(goal), distance=distance
        )
        self._publish("nav_command", self._nav_command)

    def publish_plan(self, command_id: int, *points: tuple[float, float], **fields: Any) -> None:
        """Publish a path through these points."""
        poses = packed_poses(np.array([(x, y, 0.0) for x, y in points]).reshape(-1, 3))
        self._publish("plan", Plan(command_id=command_id, poses=poses, **fields))

    def run_for(self, seconds: float, until: int | None = None) -> None:
        """Let time pass, at most until a status has the state `until`."""
        for _ in range(round(seconds * SECOND / STEP)):
            self._step()
            if until is not None and self.statuses and self.status.state == until:
                break

    def _step(self) -> None:
        stamp = from_ns(self.now - self._clocks_behind)
        self._publish("clock", Clock(clock=stamp))
        if self._tick % 25 == 0:
            self._publish("nav_command", self._nav_command)
        self._publish_odometry(stamp)
        if self._tick % 5 == 0:
            self._publish_scan(stamp)
            self._publish_localization(stamp)
        self.motion_control.run_to(self.now + STEP - 1)
        for command in self.motion_control.take("cmd_vel"):
            self._command = (command.linear.x, command.angular.z)
            self.commands.append((self.now, *self._command))
        self.statuses += self.motion_control.take("motion_status")
        self.robot.move(self._command, STEP / SECOND)
        self._tick += 1
        self.clearance = min(
            self.clearance, self.world.distance(self._seconds, *self.robot.pose[:2]) - 0.22
        )

    @property
    def _seconds(self) -> float:
        return self._tick * STEP / SECOND

    def _publish_odometry(self, stamp: Any) -> None:
        twist = Twist(linear=Vector3(x=self.robot.speed), angular=Vector3(z=self.robot.turn))
        odometry = Odometry(
            header=Header(stamp=stamp, frame_id="odom"),
            child_frame_id="base_link",
            pose=PoseWithCovariance(pose=pose_message(self.robot.odom)),
            twist=TwistWithCovariance(twist=twist),
        )
        delay_s = float(self._delays.uniform(*self.odometry_delay_s))
        if self._delays.random() >= self.odometry_loss:
            self._delayed.append((self.now + round(delay_s * SECOND), odometry))
        self._delayed.sort(key=lambda one: one[0])
        while self._delayed and self._delayed[0][0] <= self.now:
            self._publish("odom", self._delayed.pop(0)[1])

    def _publish_scan(self, stamp: Any) -> None:
        noise = self.random.normal(0.0, 0.005, self.beams)
        step = 2 * math.pi / self.beams
        angles: Array = np.arange(self.beams, dtype=np.float64) * step - math.pi
        scanner = compose(self.robot.pose, self.mount)
        ranges = self.world.ranges(self._seconds, scanner, angles, noise)
        self._publish(
            "scan",
            LaserScan(
                header=Header(stamp=stamp, frame_id="laser"),
                angle_min=float(np.float32(angles[0])),
                angle_max=float(np.float32(angles[-1])),
                angle_increment=float(np.float32(step)),
                range_max=10.0,
                ranges=ranges.astype(np.float32),
            ),
        )

    def _publish_localization(self, stamp: Any) -> None:
        x, y, theta = self.robot.pose
        dx, dy, turned = self.random.normal(0.0, 0.01, 3)
        pose = PoseWithCovariance(pose=pose_message((x + dx, y + dy, wrap(theta + turned))))
        header = Header(stamp=stamp, frame_id="map")
        self._publish("localization", replace(self.localization, header=header, pose=pose))

    def _publish(self, topic: str, message: Any) -> None:
        if topic not in self.muted:
            self.motion_control.publish(topic, message, handled=False)
