"""The parameters of motion control."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from cairn import Config, FromRobot, Mount
from cairn.components.motion_control.velocity_limits import MotionLimits


class Timeouts(Config):
    """Ages of inputs above which the robot stands still."""

    scan: float = Field(0.5, gt=0, le=10, description="Maximum age of the newest scan [s].")
    odom: float = Field(0.3, gt=0, le=10, description="Maximum age of the newest odometry [s].")
    localization: float = Field(
        1.0, gt=0, le=10, description="Maximum age of the newest localization estimate [s]."
    )
    nav_command: float = Field(
        1.5, gt=0, le=10, description="Maximum age of the navigation command [s]."
    )
    velocity_gate_status: float = Field(
        3.0,
        gt=0,
        le=30,
        description="Maximum age of the velocity gate's status, if there is a gate [s].",
    )


class MotionControlConfig(Config):
    """Parameters of motion control."""

    # At most 1: the scan memory knows the ground up to 1.6 m from the robot's center.
    radius: Annotated[float, FromRobot("shape.radius_m")] = Field(
        0.22, gt=0.05, le=1, description="Radius of the round robot [m]."
    )
    margin: float = Field(
        0.05, ge=0.01, le=1, description="Free space that is kept around the robot [m]."
    )
    stop_distance: float = Field(
        0.12,
        ge=0,
        le=2,
        description="Additional distance to an obstacle on the path at which the robot stops [m].",
    )
    full_speed_clearance: float = Field(
        0.2, gt=0, le=2, description="Clearance beside the robot that full speed requires [m]."
    )
    speed: Annotated[float, FromRobot("limits.speed_m_s")] = Field(
        0.6, gt=0, le=3, description="Maximum speed [m/s]."
    )
    creep_speed: float = Field(
        0.15, gt=0, le=1, description="Speed when only the margin is free beside the robot [m/s]."
    )
    turn_speed: Annotated[float, FromRobot("limits.turn_rad_s")] = Field(
        1.5, gt=0, le=6, description="Maximum turn rate [rad/s]."
    )
    acceleration: Annotated[float, FromRobot("limits.acceleration_m_s2")] = Field(
        0.8, gt=0, le=10, description="Acceleration of velocity commands [m/s^2]."
    )
    turn_acceleration: Annotated[float, FromRobot("limits.turn_acceleration_rad_s2")] = Field(
        3.0, gt=0, le=30, description="Angular acceleration of velocity commands [rad/s^2]."
    )
    braking: float = Field(
        0.6,
        gt=0,
        le=10,
        description="Deceleration on which stopping distances rely; less than the robot can "
        "[m/s^2].",
    )
    turn_braking: float = Field(
        2.0,
        gt=0,
        le=30,
        description="Angular deceleration on which stopping angles rely [rad/s^2].",
    )
    latency: float = Field(
        0.15, ge=0, le=1, description="Delay from a measurement to the base's reaction [s]."
    )
    lookahead: float = Field(
        1.2,
        gt=0.1,
        le=5,
        description="Distance of the point on the path that the robot pursues, as driving time "
        "[s].",
    )
    memory: float = Field(
        3.0,
        ge=0,
        le=30,
        description="How long obstacles outside the field of view are remembered [s].",
    )
    health_limit: float = Field(
        0.3, ge=0, le=1, description="Least localization health for following a path [1]."
    )
    timeouts: Timeouts = Timeouts()
    mount: Annotated[Mount, FromRobot("mounts.scanner")] = Mount()

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        """Reject combinations that the robot cannot satisfy."""
        for least, most in (
            ("creep_speed", "speed"),
            ("braking", "acceleration"),
            ("turn_braking", "turn_acceleration"),
        ):
            low, high = getattr(self, least), getattr(self, most)
            if low > high:
                raise ValueError(
                    f"{least} {low:g} is more than {most} {high:g}: "
                    f"lower {least} to {high:g} or less, or raise {most}"
                )
        if self.full_speed_clearance <= self.margin:
            raise ValueError(
                f"full_speed_clearance {self.full_speed_clearance:g} is not more than margin "
                f"{self.margin:g}: raise full_speed_clearance, or lower margin"
            )
        return self

    def limits(self) -> MotionLimits:
        """Return the parameters as the algorithms use them."""
        return MotionLimits(
            radius=self.radius,
            margin=self.margin,
            stop_distance=self.stop_distance,
            full_speed_clearance=self.full_speed_clearance,
            speed=self.speed,
            creep_speed=self.creep_speed,
            turn_speed=self.turn_speed,
            acceleration=self.acceleration,
            turn_acceleration=self.turn_acceleration,
            braking=self.braking,
            turn_braking=self.turn_braking,
            latency=self.latency,
            lookahead=self.lookahead,
        )
