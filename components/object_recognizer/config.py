"""Parameters of the object recognizer."""

from __future__ import annotations

from pydantic import Field, model_validator

from cairn import Config, Mount, ReadPath
from cairn.vision.verification import LEAST


class ObjectRecognizerConfig(Config):
    """What is recognized, and by which camera."""

    map_file: ReadPath = Field(
        description="The visual map whose taught objects are recognized (`cairn object teach`). "
        "Objects are taught to this file, never to the map builder's working copy of it, which is "
        "the robot's own; what is taught while the robot runs is recognized a second later."
    )
    stereo: bool = Field(True, description="Whether there is a right camera.")
    mount: Mount = Field(Mount(), description="Where the left camera sits on the robot.")
    least_inliers: int = Field(
        LEAST, ge=LEAST, le=1000, description="Matched features of an object that is told of."
    )
    nearest: float = Field(0.3, gt=0, le=100, description="Nearest object [m].")
    farthest: float = Field(5.0, gt=0, le=100, description="Farthest object [m].")
    bearing_sd: float = Field(
        0.005,
        ge=0,
        le=0.2,
        description="How well the camera's aim is known while the robot turns: mount and stamps "
        "[rad].",
    )
    most_features: int = Field(
        2000,
        ge=0,
        le=100_000,
        description="Features that are looked at in an image, at most, those that stand out most; "
        "0: all of them.",
    )
    threads: int = Field(1, ge=1, le=64, description="Threads that OpenCV uses.")

    @model_validator(mode="after")
    def _somewhere(self) -> ObjectRecognizerConfig:
        if not self.nearest < self.farthest:
            raise ValueError(f"farthest = {self.farthest} must be above nearest = {self.nearest}")
        return self
