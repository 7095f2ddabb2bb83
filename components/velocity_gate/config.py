"""The parameters of the velocity gate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from cairn import Config, FromRobot, Mount
from cairn.components.velocity_gate.collision_monitor import (
    Corners,
    Footprint,
    StoppingAbility,
    convex_corners,
)
from cairn.components.velocity_gate.limiter import RampLimits, SpeedLimits
from cairn.components.velocity_gate.sources import (
    EXTERNAL,
    NAVIGATOR,
    TELEOPERATION,
    SourceSettings,
)

_PRIORITY = "Of the sources with fresh commands, the highest drives [1]."


class SourceConfig(Config):
    """When the commands of a source count; that of the navigator."""

    priority: int = Field(10, ge=0, le=100, description=_PRIORITY)
    timeout: float = Field(
        0.3, gt=0, le=2, description="Age of a command from which it is stale [s]."
    )


class ExternalConfig(SourceConfig):
    """Commands of another program, such as a ROS 2 node."""

    priority: int = Field(20, ge=0, le=100, description=_PRIORITY)
    enabled: bool = Field(False, description="Whether commands on external_cmd_vel count.")


class TeleoperationConfig(SourceConfig):
    """Commands of an operator."""

    priority: int = Field(30, ge=0, le=100, description=_PRIORITY)


class VelocityGateConfig(Config):
    """Parameters of the velocity gate."""

    navigator: SourceConfig = SourceConfig()
    external: ExternalConfig = ExternalConfig()
    teleoperation: TeleoperationConfig = TeleoperationConfig()
    radius: Annotated[float, FromRobot("shape.radius_m")] = Field(
        0.22, gt=0.05, le=2, description="Radius of the round robot [m]."
    )
    footprint: Corners = Field(
        (),
        max_length=12,
        description="Corners [x, y] of a robot that is not round, around its center [m]; it "
        "replaces radius.",
    )
    speed: Annotated[float, FromRobot("limits.speed_m_s")] = Field(
        0.6, gt=0, le=3, description="Maximum speed ahead [m/s]."
    )
    reverse_speed: Annotated[float, FromRobot("limits.reverse_speed_m_s")] = Field(
        0.3, ge=0, le=3, description="Maximum speed backward [m/s]."
    )
    blind_reverse_speed: float = Field(
        0.1,
        ge=0,
        le=1,
        description="Maximum speed backward, by teleoperation, onto ground that the scanner has "
        "not seen lately [m/s]; other sources do not drive there.",
    )
    turn_speed: Annotated[float, FromRobot("limits.turn_rad_s")] = Field(
        1.5, gt=0, le=6, description="Maximum turn rate [rad/s]."
    )
    acceleration: float = Field(1.0, gt=0, le=10, description="Maximum acceleration [m/s^2].")
    deceleration: float = Field(
        1.5, gt=0, le=20, description="Maximum deceleration, except in emergencies [m/s^2]."
    )
    jerk: float = Field(
        40.0, ge=1, le=1000, description="Maximum jerk, except in emergencies [m/s^3]."
    )
    turn_acceleration: float = Field(
        6.0, gt=0, le=60, description="Maximum angular acceleration and deceleration [rad/s^2]."
    )
    turn_jerk: float = Field(
        200.0, ge=1, le=5000, description="Maximum angular jerk, except in emergencies [rad/s^3]."
    )
    emergency_deceleration: float | None = Field(
        None,
        gt=0,
        le=100,
        description="Deceleration of commands in emergencies [m/s^2]; null: the command is zero at "
        "once, and the base brakes as hard as it can.",
    )
    braking: float = Field(
        0.7,
        gt=0,
        le=10,
        description="Deceleration of the base on which stopping distances rely [m/s^2].",
    )
    turn_braking: float = Field(
        2.0, gt=0, le=30, description="Angular deceleration on which stopping relies [rad/s^2]."
    )
    latency: float = Field(
        0.08, ge=0, le=1, description="Delay from a command to the base's reaction [s]."
    )
    stop_margin: float = Field(
        0.005, ge=0, le=0.5, description="Stop zone: this far around the footprint [m]."
    )
    slowdown_margin: float = Field(
        0.03, ge=0, le=1, description="Slow-down zone: this far around the footprint [m]."
    )
    slowdown_time: float = Field(
        0.5, ge=0, le=5, description="The slow-down zone extends by the way of this time [s]."
    )
    slowdown_speed: float = Field(
        0.3, gt=0, le=3, description="Maximum speed with a point in the slow-down zone [m/s]."
    )
    scanner: bool = Field(
        True, description="Whether the robot has a scanner; false: obstacles are not checked."
    )
    scan_timeout: float = Field(
        0.5, gt=0, le=5, description="Age of the newest scan from which the robot stands [s]."
    )
    odometry_timeout: float = Field(
        0.3, gt=0, le=5, description="Age of the newest odometry from which the robot stands [s]."
    )
    memory: float = Field(
        4.0,
        ge=0.5,
        le=30,
        description="How long points and free ground that the scanner does not see now count [s].",
    )
    hardware_stop_timeout: float | None = Field(
        None,
        gt=0,
        le=60,
        description="Silence of hardware_stop from which the emergency stop is engaged [s]; before "
        "its first message the robot stands. null: it may be silent.",
    )
    state_file: Path | None = Field(
        None,
        description="File of the emergency stop; without it, a gate that was restarted begins with "
        "the stop engaged.",
    )
    mount: Annotated[Mount, FromRobot("mounts.scanner")] = Mount()

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        """Reject combinations that make no sense."""
        convex_corners(self.footprint) if self.footprint else None
        priorities = {one.priority for one in (self.navigator, self.external, self.teleoperation)}
        if len(priorities) < 3:
            raise ValueError("two sources have the same priority: give each another one")
        if self.slowdown_margin < self.stop_margin:
            raise ValueError(
                f"slowdown_margin {self.slowdown_margin:g} is less than stop_margin "
                f"{self.stop_margin:g}: raise slowdown_margin, or lower stop_margin"
            )
        return self

    def sources(self) -> list[SourceSettings]:
        """Return the settings of the sources."""
        return [
            SourceSettings(name, one.priority, one.timeout)
            for name, one in (
                (NAVIGATOR, self.navigator),
                (EXTERNAL, self.external),
                (TELEOPERATION, self.teleoperation),
            )
        ]

    def outline(self) -> Footprint:
        """Return the footprint of the robot."""
        return Footprint(self.radius, convex_corners(self.footprint) if self.footprint else ())

    def speed_limits(self) -> SpeedLimits:
        """Return the limits on speed."""
        return SpeedLimits(self.speed, self.reverse_speed, self.turn_speed)

    def ramp_limits(self) -> tuple[RampLimits, RampLimits]:
        """Return the limits on acceleration and jerk, linear and angular."""
        turn = self.turn_acceleration
        return (
            RampLimits(self.acceleration, self.deceleration, self.jerk),
            RampLimits(turn, turn, self.turn_jerk),
        )

    def stopping_ability(self) -> StoppingAbility:
        """Return the decelerations on which the check relies."""
        return StoppingAbility(self.braking, self.turn_braking)

    def reach(self) -> float:
        """Return the distance [m] from the base's center up to which points count."""
        fastest = max(self.speed, self.reverse_speed)
        stops_in = fastest * (self.latency + self.scan_timeout) + fastest**2 / (2.0 * self.braking)
        return self.outline().reach + stops_in + 0.5
