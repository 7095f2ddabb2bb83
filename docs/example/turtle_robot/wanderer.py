"""The wanderer, a task component: drives ahead and turns at walls."""

import math

from cairn import SECOND, SENSOR, Component, Config, In, Out, ParameterRejected, every, on
from cairn.schemas.geometry_msgs import Point, Twist, Vector3
from cairn.schemas.nav_msgs import Odometry
from pydantic import Field

from turtle_robot.messages import BaseState


class WandererConfig(Config):
    """Parameters of the wanderer."""

    speed: float = Field(0.5, gt=0, le=1, description="Forward speed [m/s].")
    turn_speed: float = Field(2.0, gt=0, le=6, description="Turn rate on the spot [rad/s].")
    distance: float = Field(20.0, gt=0, le=1e5, description="Distance after which it ends [m].")


class Wanderer(Component):
    """Drives ahead, turns by a random angle at a wall, and ends after a given distance."""

    config: WandererConfig

    odom: In[Odometry] = In(qos=SENSOR)
    base_state: In[BaseState]
    cmd_vel: Out[Twist] = Out(qos=SENSOR)

    def on_configure(self) -> None:
        """Reset the traveled distance."""
        self._traveled_m = 0.0
        self._last: Point | None = None

    def on_activate(self) -> None:
        """Start straight ahead."""
        self._turning = False

    def on_deactivate(self) -> None:
        """Stop the robot."""
        self.cmd_vel.publish(Twist())

    def on_parameters(self, new: Config) -> None:
        """Reject a distance that the turtle has already traveled."""
        assert isinstance(new, WandererConfig)
        if new.distance < self._traveled_m:
            raise ParameterRejected(
                f"distance = {new.distance:g}: the turtle has already traveled "
                f"{self._traveled_m:.1f} m; set a larger distance"
            )

    @on("odom")
    def on_odom(self, odom: Odometry) -> None:
        """Add up the distance; end when it is reached."""
        position, last = odom.pose.pose.position, self._last
        self._last = position
        step_m = 0.0 if last is None else math.hypot(position.x - last.x, position.y - last.y)
        if step_m < 0.2:  # otherwise the base has restarted at its origin
            self._traveled_m += step_m
        if self._traveled_m >= self.config.distance:
            self.finish(f"{self._traveled_m:.1f} m traveled")

    @on("base_state")
    def on_base_state(self, state: BaseState) -> None:
        """Turn by a random angle when a wall blocks the turtle."""
        if state.blocked and not self._turning:
            self._turning = True
            angle = self.random.uniform(0.5, 1.5) * math.pi
            self.log.info("turning at a wall: %.0f degrees", math.degrees(angle))
            seconds = angle / self.config.turn_speed
            self.schedule(self.clock.now() + round(seconds * SECOND), self._drive_ahead)

    @every(hz=10)
    def publish_command(self) -> None:
        """Publish the velocity command; without new ones the base stops."""
        if self._turning:
            self.cmd_vel.publish(Twist(angular=Vector3(z=self.config.turn_speed)))
        else:
            self.cmd_vel.publish(Twist(linear=Vector3(x=self.config.speed)))

    def _drive_ahead(self) -> None:
        self._turning = False
