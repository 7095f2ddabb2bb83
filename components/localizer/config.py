"""The parameters of the localizer."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field

from cairn.component.parameters import Config
from components.localizer.localization import Settings
from components.localizer.motion import MotionModel


class StartPose(Config):
    """The robot's pose in the map at the origin of the odometry frame."""

    x: float = Field(description="x [m].")
    y: float = Field(description="y [m].")
    theta: float = Field(ge=-2 * math.pi, le=2 * math.pi, description="Heading [rad].")
    position_sd: float = Field(0.05, gt=0, le=5, description="Standard deviation of x and y [m].")
    heading_sd: float = Field(0.03, gt=0, le=3, description="Standard deviation of theta [rad].")


class BaseModel(Config):
    """How the base follows the commanded velocities."""

    lag_s: float = Field(0.17, ge=0, le=1, description="Delay of the base behind a command [s].")
    forward_gain: float = Field(
        0.95, gt=0, le=2, description="Distance performed per distance commanded [1]."
    )
    turn_gain: float = Field(
        0.93, gt=0, le=2, description="Angle performed per angle commanded [1]."
    )
    forward_noise: float = Field(
        0.025, ge=0, le=1, description="Random walk of the distance while moving [m/sqrt(s)]."
    )
    turn_noise: float = Field(
        0.04, ge=0, le=1, description="Random walk of the heading while moving [rad/sqrt(s)]."
    )


class LocalizerConfig(Config):
    """Parameters of the localizer."""

    start: StartPose | None = Field(
        None, description="Known start; none: find the robot by the objects that it sees."
    )
    particles: int = Field(
        400, ge=50, le=20_000, description="Poses of a cloud while the robot is located [1]."
    )
    judges: int = Field(
        16, ge=0, le=256, description="Objects that are judged by a cloud without them [1]."
    )
    search_particles: int = Field(
        20_000, ge=1000, le=500_000, description="Poses drawn to find a robot anywhere [1]."
    )
    independence: float = Field(
        0.15,
        gt=0,
        le=1,
        description="Share of a sighting's log-likelihood that counts, as the errors of "
        "successive sightings repeat [1].",
    )
    mode: Literal["lr", "paper"] = Field(
        "lr", description="Similarity by likelihood ratio, or by new samples as in the paper."
    )
    ring_samples: int = Field(
        300, ge=50, le=10_000, description="New samples around an object in mode paper [1]."
    )
    healthy_spread: float = Field(
        0.35, gt=0, le=5, description="Position deviation up to which objects are judged [m]."
    )
    hold_s: float = Field(
        1.5, ge=0, le=5, description="How long a sighting waits for odometry to reach it [s]."
    )
    base: BaseModel = BaseModel()

    def settings(self) -> Settings:
        """The parameters as the algorithm takes them."""
        return Settings(
            particles=self.particles,
            judges=self.judges,
            search_particles=self.search_particles,
            independence=self.independence,
            mode=self.mode,
            ring_samples=self.ring_samples,
            healthy_spread_m=self.healthy_spread,
            motion=MotionModel(**self.base.model_dump()),
        )
