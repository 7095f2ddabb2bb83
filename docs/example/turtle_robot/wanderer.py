"""The task component that wanders: ahead until something is in the way, then elsewhere."""

import math

from cairn import SECOND, SENSOR, Component, Config, In, Out, ParameterRejected, every, on
from cairn.schemas.geometry_msgs import Point, Twist, Vector3
from cairn.schemas.nav_msgs import Odometry
from pydantic import Field

from turtle_robot.messages import BaseState


class WandererConfig(Config):
    """Parameters of the wanderer."""

    speed: float = Field(0.5, gt=0, le=1, description="Speed ahead [m/s].")
    turn_speed: float = Field(2.0, gt=0, le=6, description="Speed of turning on the spot [rad/s].")
    distance: float = Field(20.0, gt=0, le=1e5, description="Way after which it has done [m].")


class Wanderer(Component):
    """Goes straight on, turns by a random angle at a wall, and ends after a given way."""

    config: WandererConfig

    odom: In[Odometry] = In(qos=SENSOR)
    base_state: In[BaseState]
    cmd_vel: Out[Twist] = Out(qos=SENSOR)

    def on_configure(self) -> None:
        """Begin with no way behind it."""
        self._traveled_m = 0.0
        self._last: Point | None = None

    def on_activate(self) -> None:
        """Set out straight ahead."""
        self._turning = False

    def on_deactivate(self) -> None:
        """Leave the robot standing."""
        self.cmd_vel.publish(Twist())

    def on_parameters(self, new: Config) -> None:
        """Refuse a way that is behind it already."""
        assert isinstance(new, WandererConfig)
        if new.distance < self._traveled_m:
            raise ParameterRejected(f"{self._traveled_m:.1f} m are behind the turtle already")

    @on("odom")
    def follow(self, odom: Odometry) -> None:
        """Add up the way; end when it is long enough."""
        place, last = odom.pose.pose.position, self._last
        self._last = place
        step_m = 0.0 if last is None else math.hypot(place.x - last.x, place.y - last.y)
        if step_m < 0.2:  # else the base began anew at its origin
            self._traveled_m += step_m
        if self._traveled_m >= self.config.distance:
            self.finish(f"{self._traveled_m:.1f} m traveled")

    @on("base_state")
    def avoid(self, state: BaseState) -> None:
        """Turn by a random angle when the way is blocked."""
        if state.blocked and not self._turning:
            self._turning = True
            angle = self.random.uniform(0.5, 1.5) * math.pi
            self.log.info("a wall: turning by %.0f degrees", math.degrees(angle))
            seconds = angle / self.config.turn_speed
            self.schedule(self.clock.now() + round(seconds * SECOND), self._go_on)

    @every(hz=10)
    def command(self) -> None:
        """Tell the base what to do, again and again, so that it knows we live."""
        if self._turning:
            self.cmd_vel.publish(Twist(angular=Vector3(z=self.config.turn_speed)))
        else:
            self.cmd_vel.publish(Twist(linear=Vector3(x=self.config.speed)))

    def _go_on(self) -> None:
        self._turning = False
