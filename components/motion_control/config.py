"""The parameters of motion control."""

from __future__ import annotations

from typing import Self

from pydantic import Field, model_validator

from cairn import Config, Mount
from cairn.components.motion_control.limits import Limits


class Timeouts(Config):
    """Ages of inputs from which the robot stands still."""

    scan: float = Field(0.5, gt=0, le=10, description="Age of the newest scan [s].")
    odom: float = Field(0.3, gt=0, le=10, description="Age of the newest odometry [s].")
    localization: float = Field(
        1.0, gt=0, le=10, description="Age of the newest localization estimate [s]."
    )
    nav_command: float = Field(1.5, gt=0, le=10, description="Age of what is wanted [s].")


class MotionControlConfig(Config):
    """Parameters of motion control."""

    # What was seen is looked at up to 1.6 m from the robot's center.
    radius: float = Field(0.22, gt=0.05, le=1, description="Radius of the round robot [m].")
    margin: float = Field(
        0.05, ge=0.01, le=1, description="Space around the robot that is kept free [m]."
    )
    stop_distance: float = Field(
        0.12,
        ge=0,
        le=2,
        description="Further space before what blocks the path, where the robot stops [m].",
    )
    full_speed_clearance: float = Field(
        0.2, gt=0, le=2, description="Space beside the robot that it needs for full speed [m]."
    )
    speed: float = Field(0.6, gt=0, le=3, description="Fastest speed ahead [m/s].")
    creep_speed: float = Field(
        0.15, gt=0, le=1, description="Speed where there is only the margin beside the robot [m/s]."
    )
    turn_speed: float = Field(1.5, gt=0, le=6, description="Fastest turn [rad/s].")
    acceleration: float = Field(0.8, gt=0, le=10, description="Acceleration of commands [m/s^2].")
    turn_acceleration: float = Field(
        3.0, gt=0, le=30, description="Angular acceleration of commands [rad/s^2]."
    )
    braking: float = Field(
        0.6,
        gt=0,
        le=10,
        description="Deceleration that the robot is relied on for; less than it can [m/s^2].",
    )
    turn_braking: float = Field(
        2.0, gt=0, le=30, description="Angular deceleration relied on [rad/s^2]."
    )
    latency: float = Field(
        0.15, ge=0, le=1, description="Time from what is seen to when the base follows [s]."
    )
    lookahead: float = Field(
        1.2, gt=0.1, le=5, description="How far ahead on the path the robot aims [s]."
    )
    memory: float = Field(
        3.0, ge=0, le=30, description="How long what left the scanner's view still counts [s]."
    )
    health_limit: float = Field(
        0.3, ge=0, le=1, description="Health of the localization below which no path is followed."
    )
    timeouts: Timeouts = Timeouts()
    mount: Mount = Mount()

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        """Refuse what the robot cannot do, rather than do something else."""
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

    def limits(self) -> Limits:
        """The parameters as the algorithm takes them."""
        return Limits(
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
