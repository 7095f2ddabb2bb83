"""The driver of the simulated base: wheel dynamics, encoder errors, the component."""

from __future__ import annotations

import math
from collections import deque
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cairn import (
    RELIABLE,
    SECOND,
    SENSOR,
    Component,
    Config,
    FromRobot,
    In,
    Out,
    every,
    from_ns,
    on,
)
from cairn.planar.messages import transform_message, twist_message, with_covariance
from cairn.planar.poses import Pose, compose
from cairn.schemas.cairn_sim_msgs import WheelMotion
from cairn.schemas.geometry_msgs import Twist, TwistWithCovariance
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage


class DriveConfig(Config):
    """Dynamics of a differential-drive base."""

    speed: Annotated[float, FromRobot("limits.speed_m_s")] = Field(
        0.6, gt=0, le=5, description="Maximum speed [m/s]."
    )
    turn: Annotated[float, FromRobot("limits.turn_rad_s")] = Field(
        1.5, gt=0, le=10, description="Maximum turn rate [rad/s]."
    )
    acceleration: Annotated[float, FromRobot("limits.acceleration_m_s2")] = Field(
        0.8, gt=0, le=20, description="Acceleration [m/s^2]."
    )
    turn_acceleration: Annotated[float, FromRobot("limits.turn_acceleration_rad_s2")] = Field(
        3.0, gt=0, le=50, description="Angular acceleration [rad/s^2]."
    )
    lag_s: float = Field(0.05, ge=0, le=1, description="Delay of a command [s].")
    command_timeout_s: float = Field(
        0.3, gt=0, le=5, description="Age of a command after which the wheels stop [s]."
    )


class SimulatedBaseConfig(DriveConfig):
    """Dynamics and encoder errors of a differential-drive base."""

    distance_scale_sd: float = Field(
        0.01,
        ge=0,
        le=0.5,
        description="Standard deviation of the distance scale, drawn once per run [1].",
    )
    turn_scale_sd: float = Field(
        0.02,
        ge=0,
        le=0.5,
        description="Standard deviation of the turn scale, drawn once per run [1].",
    )
    distance_error: float = Field(
        0.01, ge=0, le=1, description="Random walk of the distance [m/sqrt(m)]."
    )
    turn_error: float = Field(0.02, ge=0, le=1, description="Random walk of turns [rad/sqrt(rad)].")
    turn_per_meter: float = Field(
        0.01, ge=0, le=1, description="Random walk of the heading per distance [rad/sqrt(m)]."
    )
    odometry_delay_s: float = Field(
        0.0,
        ge=0,
        le=5,
        description="Maximum delay of odometry; each message has its own, so that they arrive out "
        "of order [s].",
    )
    odometry_loss: float = Field(
        0.0, ge=0, lt=1, description="Share of the messages of odometry that are lost [1]."
    )


class WheelDrive:
    """The current speeds of the wheels, `forward` [m/s] and `turn` [rad/s]."""

    def __init__(self, limits: DriveConfig) -> None:
        self.limits = limits
        self.forward = self.turn = 0.0
        self._pending: deque[tuple[float, float, float]] = deque()
        self._target = (0.0, 0.0)
        self._commanded_s = -math.inf

    def command(self, now_s: float, forward: float, turn: float) -> None:
        """Take a command [m/s, rad/s]; it takes effect after the lag, within the limits."""
        if now_s < self._commanded_s:  # the clock was set back: what waits would wait until then
            self._pending.clear()
        self._commanded_s = now_s
        limits = self.limits
        forward = min(limits.speed, max(-limits.speed, forward))
        turn = min(limits.turn, max(-limits.turn, turn))
        self._pending.append((now_s + limits.lag_s, forward, turn))

    def step(self, now_s: float, seconds: float) -> tuple[float, float]:
        """Let `seconds` pass until `now_s`; return the mean speeds [m/s, rad/s] in that time."""
        limits = self.limits
        # A command from the future: the clock was set back.
        if not 0.0 <= now_s - self._commanded_s <= limits.command_timeout_s:
            self._pending.clear()
            self._target = (0.0, 0.0)
        while self._pending and self._pending[0][0] <= now_s:
            _, forward, turn = self._pending.popleft()
            self._target = (forward, turn)
        before = self.forward, self.turn
        self.forward = _approach(before[0], self._target[0], limits.acceleration * seconds)
        self.turn = _approach(before[1], self._target[1], limits.turn_acceleration * seconds)
        return 0.5 * (before[0] + self.forward), 0.5 * (before[1] + self.turn)


def _approach(value: float, target: float, most: float) -> float:
    return value + min(most, max(-most, target - value))


Array = NDArray[np.float64]


class Encoders:
    """The pose that the encoders measure, integrated step by step, and its covariance."""

    def __init__(self, errors: SimulatedBaseConfig, random: np.random.Generator) -> None:
        self._errors = errors
        self._random = random
        drawn = random.standard_normal(2)
        self._scales = (
            1.0 + errors.distance_scale_sd * float(drawn[0]),
            1.0 + errors.turn_scale_sd * float(drawn[1]),
        )
        self.pose: Pose = (0.0, 0.0, 0.0)
        # Over x, y, heading and the two scale errors, which are constant.
        self._full = np.diag([0.0, 0.0, 0.0, errors.distance_scale_sd**2, errors.turn_scale_sd**2])

    @property
    def covariance(self) -> Array:
        """Return the pose's covariance (3, 3) over x, y [m], heading [rad]."""
        return self._full[:3, :3]

    def speeds(self, forward: float, turn: float) -> tuple[float, float]:
        """Return the measured speeds [m/s, rad/s] for these true speeds."""
        return self._scales[0] * forward, self._scales[1] * turn

    def measure(self, distance: float, angle: float) -> None:
        """Integrate a step of the wheels: `distance` [m] on an arc that turns by `angle` [rad]."""
        if not (distance or angle):
            return
        errors = self._errors
        noise = self._random.standard_normal(2)
        distance_variance = errors.distance_error**2 * abs(distance)
        turn_variance = errors.turn_error**2 * abs(angle) + errors.turn_per_meter**2 * abs(distance)
        measured_distance = self._scales[0] * distance + math.sqrt(distance_variance) * float(
            noise[0]
        )
        measured_turn = self._scales[1] * angle + math.sqrt(turn_variance) * float(noise[1])
        self._propagate_covariance(
            measured_distance, measured_turn, distance_variance, turn_variance
        )
        half = (0.0, 0.0, 0.5 * measured_turn)
        self.pose = compose(compose(compose(self.pose, half), (measured_distance, 0.0, 0.0)), half)

    def _propagate_covariance(
        self, distance: float, angle: float, distance_variance: float, turn_variance: float
    ) -> None:
        """Propagate the covariance to first order."""
        middle = self.pose[2] + 0.5 * angle
        cosine, sine = math.cos(middle), math.sin(middle)
        # Jacobian of the pose with respect to this step's distance and angle.
        jacobian = np.array(
            [[cosine, -0.5 * distance * sine], [sine, 0.5 * distance * cosine], [0.0, 1.0]]
        )
        step = np.eye(5)
        step[0, 2], step[1, 2] = -distance * sine, distance * cosine
        step[:3, 3:] = jacobian * (distance, angle)
        self._full = step @ self._full @ step.T
        self._full[:3, :3] += (jacobian * (distance_variance, turn_variance)) @ jacobian.T


LONGEST_STEP_S = 0.1
"""A longer step [s] means that the process was delayed; the wheels stood in the rest of it."""

_ODOM, _BASE = "odom", "base_link"  # frames


class SimulatedBase(Component):
    """Carry out velocity commands in the simulated world; publish what the encoders measure.

    Publishes odometry and the transform from `odom` to `base_link`; stamps are the times of the
    measurements, also of messages that are delayed. The wheels stop when commands become stale.

    Simulated are limits, the delay of commands, and odometry with scale errors and random walks,
    late (`odometry_delay_s`) or lost (`odometry_loss`).
    """

    # The errors are drawn when the base is configured.
    live_parameters = frozenset()
    config: SimulatedBaseConfig

    cmd_vel: In[Twist] = In(qos=SENSOR, exclusive=True)
    odom: Out[Odometry] = Out(qos=RELIABLE.with_depth(1000))
    tf: Out[TFMessage]
    wheel_motion: Out[WheelMotion] = Out(qos=RELIABLE.with_depth(200))

    def on_configure(self) -> None:
        """Draw this base's scale errors."""
        self._wheels = WheelDrive(self.config)
        self._encoders = Encoders(self.config, self.random)
        self._stepped_at: int | None = None

    @on("cmd_vel")
    def on_cmd_vel(self, command: Twist) -> None:
        """Take a velocity command."""
        self._wheels.command(self.clock.now() / SECOND, command.linear.x, command.angular.z)

    @every(hz=50)
    def step(self) -> None:
        """Turn the wheels; publish their true motion and the odometry."""
        now = self.clock.now()
        last, self._stepped_at = self._stepped_at, now
        if last is None or now <= last:
            return
        seconds = min((now - last) / SECOND, LONGEST_STEP_S)
        forward, turn = self._wheels.step(now / SECOND, seconds)
        self._encoders.measure(forward * seconds, turn * seconds)
        stamp = from_ns(now)
        self.wheel_motion.publish(
            WheelMotion(
                header=Header(stamp=stamp),
                seconds=seconds,
                forward=forward,
                turn=turn,
                robot=self.robot,
            )
        )
        twist = twist_message(*self._encoders.speeds(forward, turn))
        header = Header(stamp=stamp, frame_id=_ODOM)
        odometry = Odometry(
            header=header,
            child_frame_id=_BASE,
            pose=with_covariance(self._encoders.pose, self._encoders.covariance),
            twist=TwistWithCovariance(twist=twist),
        )
        transform = transform_message(header, _BASE, self._encoders.pose)
        self._send(now, odometry, TFMessage(transforms=(transform,)))

    def _send(self, now: int, odometry: Odometry, transform: TFMessage) -> None:
        """Publish what was measured at `now` [ns], at once or delayed, unless it is lost."""
        config = self.config
        if config.odometry_loss and self.random.random() < config.odometry_loss:
            return

        def publish() -> None:
            self.odom.publish(odometry)
            self.tf.publish(transform)

        if config.odometry_delay_s:
            delay_s = config.odometry_delay_s * float(self.random.random())
            self.schedule(now + round(delay_s * SECOND), publish)
        else:
            publish()
