"""Parameters of a camera or stereo camera behind V4L2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from cairn import Config, FromRobot, ReadPath, SensorFrame
from cairn.components.v4l2_camera.camera_names import find_camera, is_name
from cairn.components.v4l2_camera.decoding import FORMATS
from cairn.driver.device_names import NamesDevice

_Value = Annotated[int, Field(ge=-(2**31), le=2**32 - 1)]
_Setting = _Value | None
_Camera = Annotated[str, NamesDevice(find_camera)]

_NAMING = "path, name:NAME, usb:VENDOR:PRODUCT[:SERIAL] or port:PORT"


@dataclass(frozen=True)
class CameraSettings:
    """Which camera, and what is requested of it: size [px], rate [1/s], formats by preference.

    `silence_s` [s] is the time without an image after which the stream is restarted.
    """

    device: str
    formats: tuple[str, ...]
    width: int
    height: int
    rate: float
    buffers: int
    silence_s: float


class ControlsConfig(Config):
    """Controls of the camera; those that are not set stay as they are.

    Each camera has its own bounds; a value outside them is rejected, and the bounds are reported.
    """

    auto_exposure: _Setting = Field(
        None, description="0 automatic, 1 manual, 2 and 3 priority of shutter and of aperture."
    )
    exposure_time_absolute: _Setting = Field(None, description="Manual exposure [100 us].")
    exposure_dynamic_framerate: _Setting = Field(
        None, description="1: lower the rate in the dark [0 or 1]."
    )
    gain_automatic: _Setting = Field(None, description="1: the camera chooses its gain [0 or 1].")
    gain: _Setting = Field(None, description="Gain of the sensor [camera's own unit].")
    brightness: _Setting = Field(None, description="Added to all pixels [camera's own unit].")
    contrast: _Setting = Field(None, description="Contrast [camera's own unit].")
    saturation: _Setting = Field(None, description="Saturation of colors [camera's own unit].")
    gamma: _Setting = Field(None, description="Gamma [camera's own unit, mostly 0.01].")
    sharpness: _Setting = Field(None, description="Sharpness of edges [camera's own unit].")
    backlight_compensation: _Setting = Field(
        None, description="Backlight compensation [camera's own unit]."
    )
    power_line_frequency: _Setting = Field(
        None, description="Filter against flicker of lamps: 0 off, 1 50 Hz, 2 60 Hz, 3 automatic."
    )
    white_balance_automatic: _Setting = Field(
        None, description="1: the camera balances colors [0 or 1]."
    )
    white_balance_temperature: _Setting = Field(
        None, description="Color temperature of the light [K]."
    )
    focus_automatic_continuous: _Setting = Field(
        None, description="1: the camera focuses, which spoils its calibration [0 or 1]."
    )
    focus_absolute: _Setting = Field(None, description="Distance of focus [camera's own unit].")
    other: dict[str, _Value] = Field(
        {}, description="Other controls by the names that `cairn driver probe camera` lists."
    )

    def values(self) -> dict[str, int]:
        """Return the controls that are set, by name."""
        named = self.model_dump(exclude={"other"}, exclude_none=True)
        return {**named, **self.other}


class V4l2StereoCameraConfig(Config):
    """Which camera, what is requested of it, and its pose on the robot.

    `controls` and `stamp_delay_s` may be changed while it runs.
    """

    device: _Camera = Field(
        description=f"The left camera, the only one, or the side-by-side one: {_NAMING}."
    )
    right_device: _Camera | None = Field(None, description=f"The right camera: {_NAMING}.")
    side_by_side: bool = Field(
        False, description="An image of the device holds those of both cameras side by side."
    )
    right_comes_first: bool = Field(
        False, description="The left half of a side-by-side image is that of the right camera."
    )
    width: int = Field(
        640,
        ge=16,
        le=16384,
        description="Width of a device's images; side by side, of both together [px].",
    )
    height: int = Field(480, ge=16, le=16384, description="Height of the images of a device [px].")
    rate: float = Field(25.0, gt=0, le=1000, description="Images per second [1/s].")
    format: Literal["auto", "GREY", "YUYV", "MJPG"] = Field(
        "auto", description="Pixel format; auto: the first of these with this size at this rate."
    )
    buffers: int = Field(4, ge=2, le=32, description="Buffers that the kernel fills in turn [1].")
    silence_s: float = Field(
        1.0,
        ge=0.1,
        le=60,
        description="Time without an image until the stream is restarted [s].",
    )
    stamp_delay_s: float = Field(
        0.0,
        ge=-1,
        le=1,
        description="How long after the middle of the exposure it is stamped [s].",
    )
    left_calibration: ReadPath | None = Field(
        None, description="camera_info YAML file of the left camera, or of the only one."
    )
    right_calibration: ReadPath | None = Field(
        None, description="camera_info YAML file of the right camera."
    )
    mount_frame: Annotated[SensorFrame, FromRobot("mounts.camera.frame")] = Field(
        "camera",
        description="Frame on the robot at the left camera, which looks along its x axis; the "
        "optical frames are published in it.",
    )
    controls: ControlsConfig = Field(
        ControlsConfig(), description="Exposure, gain and other controls of both cameras."
    )

    @property
    def is_stereo(self) -> bool:
        """Whether there is a right camera."""
        return self.side_by_side or self.right_device is not None

    def devices(self) -> list[str]:
        """Return the names of the devices, left first."""
        return [self.device] if self.right_device is None else [self.device, self.right_device]

    def settings_of(self, device: str) -> CameraSettings:
        """Return what is requested of one device."""
        formats = FORMATS if self.format == "auto" else (self.format,)
        return CameraSettings(
            device, formats, self.width, self.height, self.rate, self.buffers, self.silence_s
        )

    @model_validator(mode="after")
    def _check(self) -> Self:
        for key in ("device", "right_device"):
            name = getattr(self, key)
            if name is not None and not is_name(name):
                raise ValueError(f"{key} = {name!r} does not name a camera; use {_NAMING}")
        if self.side_by_side and self.right_device is not None:
            raise ValueError("side_by_side cameras are one device; leave right_device out")
        if self.device == self.right_device:
            raise ValueError(f"device and right_device are both {self.device!r}; name two cameras")
        if self.side_by_side and self.width % 2:
            raise ValueError(f"width = {self.width} is odd; side_by_side needs an even width")
        if self.right_comes_first and not self.side_by_side:
            raise ValueError("right_comes_first is for side_by_side cameras; exchange the devices")
        if self.right_calibration is not None and not self.is_stereo:
            raise ValueError("right_calibration is set, but there is no right camera; leave it out")
        return self


LIVE = ("controls", "stamp_delay_s")
"""Parameters that may be changed while the camera runs."""
