"""The parameters of the object recognizer."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from cairn import Config, FromRobot, Mount, ReadPath
from cairn.vision.verification import LEAST


class ObjectRecognizerConfig(Config):
    """Parameters of the object recognizer."""

    map_file: ReadPath = Field(
        description="The visual map with the models of the objects to recognize (`cairn object "
        "teach`). Teach objects to this file, never to the map builder's working copy of it, which "
        "belongs to the robot. Objects taught while the robot runs are recognized a second later."
    )
    stereo: bool = Field(True, description="Whether there is a right camera.")
    mount: Annotated[Mount, FromRobot("mounts.camera")] = Field(
        Mount(), description="Pose of the left camera on the robot."
    )
    least_inliers: int = Field(
        LEAST,
        ge=LEAST,
        le=1000,
        description="Minimum number of matched features of a published object.",
    )
    nearest: float = Field(0.3, gt=0, le=100, description="Nearest object [m].")
    farthest: float = Field(5.0, gt=0, le=100, description="Farthest object [m].")
    bearing_sd: float = Field(
        0.005,
        ge=0,
        le=0.2,
        description="Standard deviation of the camera's direction while the robot turns, from its "
        "mount and stamps [rad].",
    )
    most_features: int = Field(
        2000,
        ge=0,
        le=100_000,
        description="Maximum number of features of an image, strongest first; 0: no limit.",
    )
    threads: int = Field(1, ge=1, le=64, description="Threads that OpenCV uses.")

    @model_validator(mode="after")
    def _check_range(self) -> ObjectRecognizerConfig:
        if not self.nearest < self.farthest:
            raise ValueError(f"farthest = {self.farthest} must be above nearest = {self.nearest}")
        return self
