"""The parameters of the simulated stereo camera."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field

from cairn import Config, Mount

Fault = Literal["none", "left_missing", "right_missing", "frozen", "right_frozen", "swapped"]
Coefficient = Annotated[float, Field(ge=-10, le=10)]


class LightConfig(Config):
    """How light it is."""

    level: float = Field(1.0, ge=0, le=20, description="Of all lamps; 0 switches them off [1].")
    drift: float = Field(
        0.1, ge=0, le=2, description="Deviation of the logarithm of the level, as time passes [1]."
    )
    drift_s: float = Field(20.0, ge=0.1, le=1e5, description="How fast it drifts [s].")
    spread: float = Field(
        0.15, ge=0, le=0.9, description="How much lighter and darker places are [1]."
    )


class SensorConfig(Config):
    """What the camera makes of light."""

    exposure_s: float = Field(
        0.004, gt=0, le=0.5, description="How long it exposes: brightness and motion blur [s]."
    )
    gain: float = Field(
        1.0, ge=0, le=100, description="Brightness; at 1 and 4 ms white is almost saturated [1]."
    )
    vignetting: float = Field(
        0.2, ge=0, le=1, description="How much less light comes to the corners [1]."
    )
    defocus: float = Field(0.6, ge=0, le=20, description="Deviation of the lens's blur [px].")
    read_noise: float = Field(
        1.5, ge=0, le=100, description="Deviation of reading a pixel [gray levels]."
    )
    shot_noise: float = Field(
        0.02, ge=0, le=10, description="Variance per gray level of light [gray levels]."
    )


class SimulatedStereoCameraConfig(Config):
    """A level stereo camera; `light`, `sensor` and `fault` may be changed while it runs."""

    width: int = Field(640, ge=32, le=4096, description="Width of an image [px].")
    height: int = Field(480, ge=32, le=4096, description="Height of an image [px].")
    field_of_view: float = Field(
        math.radians(60), ge=0.1, le=2.6, description="Horizontal field of view [rad]."
    )
    baseline: float = Field(
        0.09, gt=0, le=2, description="How far the right camera is from the left [m]."
    )
    rate: float = Field(5.0, gt=0, le=100, description="Pairs a second [1/s].")
    delay_s: float = Field(
        0.03, ge=0, le=1, description="From the exposure until the images are there [s]."
    )
    mount: Mount = Field(Mount(), description="Where the left camera sits on the robot.")
    z: float = Field(1.0, ge=0.05, le=10, description="How high above the floor [m].")
    distortion: Annotated[list[Coefficient], Field(max_length=5)] = Field(
        [], description="Of both lenses: k1, k2, p1, p2, k3 of plumb_bob [1]; none: ideal lenses."
    )
    light: LightConfig = Field(LightConfig(), description="How light it is.")
    sensor: SensorConfig = Field(SensorConfig(), description="What the camera makes of light.")
    fault: Fault = Field("none", description="What is wrong with the camera.")


LIVE = ("light", "sensor", "fault")
"""Parameters that may be changed while the camera runs."""
