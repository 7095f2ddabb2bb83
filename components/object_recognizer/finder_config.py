"""The parameters of the object finder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from cairn import Config, FromRobot, Mount, ReadPath


class ObjectFinderConfig(Config):
    """Parameters of the object finder."""

    map_file: ReadPath = Field(
        description="The visual map with the models of the objects that the recognizer knows; the "
        "model of an accepted thing is added to it. It is never the map builder's working copy."
    )
    proposals_file: Path = Field(
        description="A visual map of its own with the proposals, which are landmarks of "
        "reliability 0.5, and with the rejected things, of reliability 0. It is made if needed."
    )
    accept: Literal["on_request", "automatically"] = Field(
        "on_request",
        description="Whether a proposal becomes an object when an operator accepts it, or at once.",
    )
    mount: Annotated[Mount, FromRobot("mounts.camera")] = Field(
        Mount(), description="Pose of the left camera on the robot."
    )
    nearest: float = Field(0.4, gt=0, le=100, description="Nearest thing [m].")
    farthest: float = Field(3.5, gt=0, le=100, description="Farthest thing [m].")
    images_per_s: float = Field(
        1.0,
        gt=0,
        le=30,
        description="Maximum rate of images that are searched, in which the robot has moved [1/s].",
    )
    least_poses: int = Field(
        6,
        ge=3,
        le=40,
        description="Minimum number of robot poses from which a proposed thing was recognized.",
    )
    least_visits: int = Field(
        2,
        ge=1,
        le=100,
        description="How often the robot must have come to a thing that is proposed: what stands "
        "there once may be gone the next time.",
    )
    away_s: float = Field(
        20.0,
        ge=1,
        le=604_800,
        description="A visit begins when a thing was not recognized for this long [s].",
    )
    least_health: float = Field(
        0.6, ge=0, le=1, description="Minimum health of the pose at an image [1]."
    )
    most_spread: float = Field(
        0.15, gt=0, le=1, description="Largest standard deviation of its position [m]."
    )
    bearing_sd: float = Field(
        0.005,
        ge=0,
        le=0.2,
        description="Standard deviation of the camera's direction while the robot turns, from its "
        "mount and stamps [rad].",
    )
    most_features: int = Field(
        2000,
        ge=100,
        le=100_000,
        description="Maximum number of features of an image, strongest first.",
    )
    threads: int = Field(1, ge=1, le=64, description="Threads that OpenCV uses.")

    @model_validator(mode="after")
    def _check_range(self) -> ObjectFinderConfig:
        if not self.nearest < self.farthest:
            raise ValueError(f"farthest = {self.farthest} must be above nearest = {self.nearest}")
        return self
