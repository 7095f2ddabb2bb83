"""A correct driver of a fictitious base, and drivers that differ from it by one mistake each."""

from __future__ import annotations

import math

from cairn import SECOND, SENSOR, Component, In, Out, every, from_ns, on
from cairn.schemas.geometry_msgs import (
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    Transform,
    TransformStamped,
    Twist,
    TwistWithCovariance,
    Vector3,
)
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage
from tests.cairn.testing.broken.periods import Periods

RATE_HZ = 20.0
TOP_SPEED = 0.5
TIMEOUT_S = 0.5


class CorrectBase(Component):
    """Has no mistake."""

    cmd_vel: In[Twist] = In(qos=SENSOR)
    odom: Out[Odometry]
    tf: Out[TFMessage]

    def on_activate(self) -> None:
        self.command, self.commanded_at = Twist(), 0
        self.x = self.y = self.theta = 0.0
        self.turns = Periods(self.clock.now(), RATE_HZ)
        self.moved_at = self.turns.ended

    @on("cmd_vel")
    def on_command(self, command: Twist) -> None:
        self.command, self.commanded_at = command, self.clock.now()

    @every(hz=RATE_HZ)
    def move(self) -> None:
        for _ in self.turns.completed(self.clock.now()):
            self.step(self.turns.ended)

    def step(self, now: int) -> None:
        seconds, self.moved_at = (now - self.moved_at) / SECOND, now
        forward, turn = self.target(now)
        self.theta += turn * seconds
        self.x += forward * seconds * math.cos(self.theta)
        self.y += forward * seconds * math.sin(self.theta)
        header = Header(stamp=from_ns(now), frame_id="odom")
        self.odom.publish(self.odometry(header, forward, turn))
        self.tf.publish(self.transform(header))

    def target(self, now: int) -> tuple[float, float]:
        if now - self.commanded_at > TIMEOUT_S * SECOND:
            return 0.0, 0.0
        forward = min(TOP_SPEED, max(-TOP_SPEED, self.command.linear.x))
        return forward, min(2.0, max(-2.0, self.command.angular.z))

    def odometry(self, header: Header, forward: float, turn: float) -> Odometry:
        pose = Pose(position=Point(x=self.x, y=self.y), orientation=self.rotation())
        twist = Twist(linear=Vector3(x=forward), angular=Vector3(z=turn))
        return Odometry(
            header=header,
            child_frame_id="base_link",
            pose=PoseWithCovariance(pose=pose),
            twist=TwistWithCovariance(twist=twist),
        )

    def transform(self, header: Header) -> TFMessage:
        pose = Transform(translation=Vector3(x=self.x, y=self.y), rotation=self.rotation())
        stamped = TransformStamped(header=header, child_frame_id="base_link", transform=pose)
        return TFMessage(transforms=(stamped,))

    def rotation(self) -> Quaternion:
        return Quaternion(z=math.sin(0.5 * self.theta), w=math.cos(0.5 * self.theta))


class NeverStops(CorrectBase):
    """Executes its last command forever."""

    def target(self, now: int) -> tuple[float, float]:
        self.commanded_at = now
        return super().target(now)


class RightIsLeft(CorrectBase):
    """Its motors and its encoders are swapped."""

    @on("cmd_vel")
    def on_command(self, command: Twist) -> None:
        turn = Vector3(z=-command.angular.z)
        self.command, self.commanded_at = Twist(command.linear, turn), self.clock.now()


class Unlimited(CorrectBase):
    """Drives at any commanded speed."""

    def target(self, now: int) -> tuple[float, float]:
        forward, turn = super().target(now)
        return (self.command.linear.x if forward else 0.0), turn


class TwistInDegrees(CorrectBase):
    """Publishes its turn rate in degrees per second."""

    def odometry(self, header: Header, forward: float, turn: float) -> Odometry:
        return super().odometry(header, forward, math.degrees(turn))


class TransformLags(CorrectBase):
    """Publishes the transform of the previous step."""

    def on_activate(self) -> None:
        super().on_activate()
        self.former = self.x, self.y

    def transform(self, header: Header) -> TFMessage:
        now, (self.x, self.y) = (self.x, self.y), self.former
        try:
            return super().transform(header)
        finally:
            self.former = self.x, self.y = now
