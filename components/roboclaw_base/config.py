"""Parameters of the base on a RoboClaw."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from cairn import Config, FromRobot
from cairn.components.roboclaw_base.drive_loop import DriveSettings
from cairn.components.roboclaw_base.kinematics import BaseLimits, MotorChannel, WheelGeometry
from cairn.components.roboclaw_base.odometry import OdometryNoise
from cairn.components.roboclaw_base.wheel_faults import WheelFaultLimits
from cairn.driver.device_names import SerialPort

_CYCLES = 4  # of the drive loop that must fit into the serial timeout
_RUNAWAY_S = 0.3  # how long a wheel may run away


class RoboclawBaseConfig(Config):
    """A differential base on a RoboClaw. The dimensions of wheels and encoders are required."""

    port: SerialPort = Field(
        "usb:03eb:2404",
        min_length=1,
        description="Serial port: /dev/serial/by-id/..., usb:VENDOR:PRODUCT[:SERIAL], or "
        "tcp:HOST:PORT of a serial device server.",
    )
    baud: int = Field(
        115200, ge=2400, le=460800, description="Speed of the line [bit/s]; ignored over USB."
    )
    address: int = Field(
        0x80, ge=0x80, le=0x87, description="Address of the RoboClaw, 128 to 135; any over USB."
    )
    wheel_radius: Annotated[float, FromRobot("drive.wheel_radius_m")] = Field(
        gt=0.005, le=1, description="Radius of the left wheel [m]."
    )
    radius_ratio: float = Field(
        1.0,
        gt=0.9,
        lt=1.1,
        description="Radius of the right wheel divided by that of the left one [1].",
    )
    wheel_separation: Annotated[float, FromRobot("drive.wheel_separation_m")] = Field(
        gt=0.02, le=3, description="Distance of the points where the wheels touch the floor [m]."
    )
    counts_per_turn: float = Field(
        gt=1,
        le=10_000_000,
        description="Encoder counts per turn of the wheel: lines x 4 x gear [1].",
    )
    left: MotorChannel = Field("m1", description="Channel of the left wheel's motor.")
    left_inverted: bool = Field(
        False, description="Whether the left wheel rolls backwards at positive speeds."
    )
    right_inverted: bool = Field(
        False, description="Whether the right wheel rolls backwards at positive speeds."
    )
    speed: Annotated[float, FromRobot("limits.speed_m_s")] = Field(
        0.6, gt=0, le=5, description="Highest speed [m/s]."
    )
    turn: Annotated[float, FromRobot("limits.turn_rad_s")] = Field(
        1.5, gt=0, le=10, description="Highest turn rate [rad/s]."
    )
    acceleration: Annotated[float, FromRobot("limits.acceleration_m_s2")] = Field(
        0.8, ge=0.05, le=20, description="Highest acceleration [m/s^2]."
    )
    turn_acceleration: Annotated[float, FromRobot("limits.turn_acceleration_rad_s2")] = Field(
        3.0, ge=0.1, le=50, description="Highest acceleration of turns [rad/s^2]."
    )
    rate: float = Field(
        50.0, ge=10, le=100, description="How often wheels are commanded and encoders read [Hz]."
    )
    command_timeout_s: float = Field(
        0.3, gt=0, le=5, description="Age of a command after which the wheels stop [s]."
    )
    device_timeout_s: float = Field(
        0.5,
        ge=0.1,
        le=5,
        multiple_of=0.1,
        description="Silence after which the RoboClaw stops the wheels by itself [s].",
    )
    stall_s: float = Field(
        0.8,
        ge=0.2,
        le=10,
        description="How long a commanded wheel may stand still before it counts as blocked [s].",
    )
    fault_speed: float = Field(
        0.05,
        ge=0.01,
        le=1,
        description="Commanded speed from which wheel faults are detected [m/s].",
    )
    battery_min_v: float | None = Field(
        None,
        ge=6,
        le=60,
        description="Voltage of the main battery below which the RoboClaw stops the motors [V].",
    )
    battery_max_v: float | None = Field(
        None,
        ge=6,
        le=80,
        description="Voltage of the main battery above which the RoboClaw stops the motors [V].",
    )
    distance_error: float = Field(
        0.01, ge=0, le=1, description="Odometry error of distances [m/sqrt(m)]."
    )
    turn_error: float = Field(
        0.02, ge=0, le=1, description="Odometry error of turns [rad/sqrt(rad)]."
    )
    turn_per_meter: float = Field(
        0.01, ge=0, le=1, description="Odometry error of the heading per distance [rad/sqrt(m)]."
    )

    @model_validator(mode="after")
    def _agree(self) -> RoboclawBaseConfig:
        if self.device_timeout_s < _CYCLES / self.rate:
            raise ValueError(
                f"device_timeout_s = {self.device_timeout_s:g} is less than {_CYCLES} periods of "
                f"rate = {self.rate:g} Hz: the wheels would stop at every delay; raise one of them"
            )
        if (self.battery_min_v is None) != (self.battery_max_v is None):
            raise ValueError(
                "battery_min_v and battery_max_v depend on each other; set both or neither"
            )
        if (
            self.battery_min_v is not None
            and self.battery_max_v is not None
            and self.battery_min_v >= self.battery_max_v
        ):
            raise ValueError(
                f"battery_min_v = {self.battery_min_v:g} is not below battery_max_v = "
                f"{self.battery_max_v:g}; exchange or correct them"
            )
        return self

    def drive_settings(self) -> DriveSettings:
        """Return the settings of the drive loop."""
        low, high = self.battery_min_v, self.battery_max_v
        return DriveSettings(
            address=self.address,
            baud=self.baud,
            rate_hz=self.rate,
            device_timeout_s=self.device_timeout_s,
            geometry=WheelGeometry(
                self.wheel_radius,
                self.radius_ratio,
                self.wheel_separation,
                self.counts_per_turn,
                self.left,
                self.left_inverted,
                self.right_inverted,
            ),
            limits=BaseLimits(self.speed, self.turn, self.acceleration, self.turn_acceleration),
            faults=WheelFaultLimits(self.fault_speed, self.stall_s, min(_RUNAWAY_S, self.stall_s)),
            main_voltages=None if low is None or high is None else (low, high),
        )

    def odometry_noise(self) -> OdometryNoise:
        """Return how fast the odometry's covariance grows."""
        return OdometryNoise(self.distance_error, self.turn_error, self.turn_per_meter)
