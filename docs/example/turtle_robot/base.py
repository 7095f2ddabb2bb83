"""The driver of the turtle's base: receives commands, publishes odometry and state."""

import math

from cairn import SECOND, SENSOR, Component, Config, In, Out, every, from_ns, has_passed, on
from cairn.schemas.geometry_msgs import (
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    Twist,
    TwistWithCovariance,
    Vector3,
)
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.std_msgs import Header
from pydantic import Field

from turtle_robot.messages import BaseState
from turtle_robot.wheels import WheelJamError, Wheels


class TurtleBaseConfig(Config):
    """Parameters of the base."""

    pen_m: float = Field(2.0, gt=0.2, le=100, description="Width of the square pen [m].")
    used_per_m: float = Field(0.01, ge=0, le=1, description="Charge used per distance [1/m].")
    jams_per_m: float = Field(0.0, ge=0, le=10, description="Wheel jams per distance [1/m].")
    command_timeout_s: float = Field(
        0.5, gt=0, le=5, description="Age of a command beyond which the wheels stop [s]."
    )


class TurtleBase(Component):
    """Drives the turtle: executes velocity commands, and stops when they cease."""

    config: TurtleBaseConfig

    cmd_vel: In[Twist] = In(qos=SENSOR, optional=True, exclusive=True)
    odom: Out[Odometry] = Out(qos=SENSOR)
    base_state: Out[BaseState]

    def on_configure(self) -> None:
        """Start the wheels' controller."""
        self._wheels = Wheels(self.config.pen_m, self.config.jams_per_m, self.random)
        self._command, self._commanded_at = Twist(), 0

    def on_activate(self) -> None:
        """Start measuring time."""
        self._moved_at = self.clock.now()

    def on_error(self, error: Exception) -> bool:
        """Recover from a jam by a new start; leave other errors to the supervisor."""
        return isinstance(error, WheelJamError)

    @on("cmd_vel")
    def on_cmd_vel(self, command: Twist) -> None:
        """Keep the command for the next steps."""
        self._command, self._commanded_at = command, self.clock.now()

    @every(hz=20)
    def move(self) -> None:
        """Execute the last command while it is fresh; publish odometry and state."""
        now = self.clock.now()
        command = self._command
        if has_passed(self.config.command_timeout_s, self._commanded_at, now):
            command = Twist()  # the safe stop: the sender may be dead or hung
        seconds, self._moved_at = max(0.0, (now - self._moved_at) / SECOND), now
        forward, turn = command.linear.x, command.angular.z
        self._wheels.advance(seconds, forward, turn, self.config.used_per_m)
        self._publish(now, forward, turn)

    def _publish(self, now: int, forward: float, turn: float) -> None:
        wheels = self._wheels
        half = wheels.theta / 2
        pose = Pose(
            position=Point(x=wheels.x, y=wheels.y),
            orientation=Quaternion(z=math.sin(half), w=math.cos(half)),
        )
        twist = Twist(linear=Vector3(x=forward), angular=Vector3(z=turn))
        self.odom.publish(
            Odometry(
                header=Header(stamp=from_ns(now), frame_id="odom"),
                child_frame_id="base_link",
                pose=PoseWithCovariance(pose=pose),
                twist=TwistWithCovariance(twist=twist),
            )
        )
        header = Header(stamp=from_ns(now), frame_id="base_link")
        self.base_state.publish(
            BaseState(header=header, charge=wheels.charge, blocked=wheels.blocked)
        )
