"""The driver of the simulated base."""

from __future__ import annotations

from pydantic import Field

from cairn import (
    RELIABLE,
    SECOND,
    SENSOR,
    Component,
    Config,
    In,
    Out,
    ParameterRejected,
    every,
    from_ns,
    on,
)
from cairn.components.simulation.encoders import EncoderErrors, Encoders
from cairn.components.simulation.wheels import BaseLimits, Wheels
from cairn.planar.messages import transform_message, with_covariance
from cairn.schemas.cairn_sim_msgs import WheelMotion
from cairn.schemas.geometry_msgs import Twist, TwistWithCovariance, Vector3
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage

# A step longer than this [s] was held up: meanwhile the wheels stood.
_LONGEST_S = 0.1
_ODOM, _BASE = "odom", "base_link"  # frames


class SimulatedBaseConfig(Config):
    """A differential base."""

    speed: float = Field(0.6, gt=0, le=5, description="Fastest [m/s].")
    turn: float = Field(1.5, gt=0, le=10, description="Fastest turn [rad/s].")
    acceleration: float = Field(0.8, gt=0, le=20, description="Acceleration [m/s^2].")
    turn_acceleration: float = Field(3.0, gt=0, le=50, description="Of turns [rad/s^2].")
    lag_s: float = Field(0.05, ge=0, le=1, description="Delay of a command [s].")
    command_timeout_s: float = Field(
        0.3, gt=0, le=5, description="Age of a command after which the wheels stop [s]."
    )
    way_scale_sd: float = Field(
        0.01, ge=0, le=0.5, description="Deviation of the scale of ways, drawn once a run [1]."
    )
    turn_scale_sd: float = Field(
        0.02, ge=0, le=0.5, description="Deviation of the scale of turns, drawn once a run [1]."
    )
    way: float = Field(0.01, ge=0, le=1, description="Error of ways [m/sqrt(m)].")
    turn_error: float = Field(0.02, ge=0, le=1, description="Error of turns [rad/sqrt(rad)].")
    turn_per_meter: float = Field(
        0.01, ge=0, le=1, description="Error of the heading on the way [rad/sqrt(m)]."
    )


class SimulatedBase(Component):
    """Carries out velocity commands in the simulated world; tells what its wheels measured.

    It tells that as odometry and as transform `odom` to `base_link`. The wheels stop when commands
    go stale.
    """

    config: SimulatedBaseConfig

    cmd_vel: In[Twist] = In(qos=SENSOR)
    odom: Out[Odometry] = Out(qos=RELIABLE.with_depth(1000))
    tf: Out[TFMessage]
    wheel_motion: Out[WheelMotion] = Out(qos=RELIABLE.with_depth(200))

    def on_configure(self) -> None:
        """Draw this base's errors of scale."""
        config = self.config
        self._wheels = Wheels(
            BaseLimits(
                config.speed,
                config.turn,
                config.acceleration,
                config.turn_acceleration,
                config.lag_s,
                config.command_timeout_s,
            )
        )
        errors = EncoderErrors(
            config.way_scale_sd,
            config.turn_scale_sd,
            config.way,
            config.turn_error,
            config.turn_per_meter,
        )
        self._encoders = Encoders(errors, self.random)
        self._stepped: int | None = None

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """A base stays the one that it is."""
        raise ParameterRejected("the simulated base takes its parameters when it is configured")

    @on("cmd_vel")
    def obey(self, command: Twist) -> None:
        """Take a command, to be carried out from now on."""
        self._wheels.command(self.clock.now() / SECOND, command.linear.x, command.angular.z)

    @every(hz=50)
    def step(self) -> None:
        """Turn the wheels; tell what they did and what they measured."""
        now = self.clock.now()
        last, self._stepped = self._stepped, now
        if last is None or now <= last:
            return
        seconds = min((now - last) / SECOND, _LONGEST_S)
        forward, turn = self._wheels.step(now / SECOND, seconds)
        self._encoders.measure(forward * seconds, turn * seconds)
        stamp = from_ns(now)
        self.wheel_motion.publish(
            WheelMotion(header=Header(stamp=stamp), seconds=seconds, forward=forward, turn=turn)
        )
        seen_forward, seen_turn = self._encoders.speeds(forward, turn)
        header = Header(stamp=stamp, frame_id=_ODOM)
        self.odom.publish(
            Odometry(
                header=header,
                child_frame_id=_BASE,
                pose=with_covariance(self._encoders.pose, self._encoders.covariance),
                twist=TwistWithCovariance(
                    twist=Twist(linear=Vector3(x=seen_forward), angular=Vector3(z=seen_turn))
                ),
            )
        )
        there = transform_message(header, _BASE, self._encoders.pose)
        self.tf.publish(TFMessage(transforms=(there,)))
