"""The parameters of a camera or stereo camera behind V4L2."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from cairn import Config, Mount, ReadPath
from cairn.components.v4l2_camera.camera import CameraSettings
from cairn.components.v4l2_camera.names import find_camera, is_name
from cairn.components.v4l2_camera.pixels import FORMATS
from cairn.driver.device_names import NamesDevice

_Value = Annotated[int, Field(ge=-(2**31), le=2**32 - 1)]
_Setting = _Value | None
_Camera = Annotated[str, NamesDevice(find_camera)]

_HOW = "path, name:NAME, usb:VENDOR:PRODUCT[:SERIAL] or port:PORT"


class ControlsConfig(Config):
    """Controls of the camera; those that are not given stay as they are.

    Each camera has its own bounds, and tells them if a value is beyond.
    """

    auto_exposure: _Setting = Field(
        None, description="0 automatic, 1 manual, 2 and 3 priority of shutter and of aperture."
    )
    exposure_time_absolute: _Setting = Field(None, description="Manual exposure [100 us].")
    exposure_dynamic_framerate: _Setting = Field(
        None, description="1: fewer pictures a second in the dark [0 or 1]."
    )
    gain_automatic: _Setting = Field(None, description="1: the camera chooses its gain [0 or 1].")
    gain: _Setting = Field(None, description="Of the sensor [camera's own unit].")
    brightness: _Setting = Field(None, description="Added to all pixels [camera's own unit].")
    contrast: _Setting = Field(None, description="[camera's own unit].")
    saturation: _Setting = Field(None, description="Of colors [camera's own unit].")
    gamma: _Setting = Field(None, description="[camera's own unit, mostly 0.01].")
    sharpness: _Setting = Field(None, description="Of edges [camera's own unit].")
    backlight_compensation: _Setting = Field(None, description="[camera's own unit].")
    power_line_frequency: _Setting = Field(
        None, description="Against flicker of lamps: 0 nothing, 1 50 Hz, 2 60 Hz, 3 automatic."
    )
    white_balance_automatic: _Setting = Field(
        None, description="1: the camera balances colors [0 or 1]."
    )
    white_balance_temperature: _Setting = Field(None, description="Of the light [K].")
    focus_automatic_continuous: _Setting = Field(
        None, description="1: the camera focuses, which spoils its calibration [0 or 1]."
    )
    focus_absolute: _Setting = Field(None, description="Where it focuses [camera's own unit].")
    other: dict[str, _Value] = Field(
        {}, description="Further ones by the names that `cairn driver probe camera` lists."
    )

    def given(self) -> dict[str, int]:
        """The controls that are given, by name."""
        named = self.model_dump(exclude={"other"}, exclude_none=True)
        return {**named, **self.other}


class V4l2StereoCameraConfig(Config):
    """Which camera, what is asked of it, and where it sits; `controls` may be changed while it
    runs, and so may `stamp_delay_s`.
    """

    device: _Camera = Field(
        description=f"The left camera, the only one, or the side-by-side one: {_HOW}."
    )
    right_device: _Camera | None = Field(None, description=f"The right camera: {_HOW}.")
    side_by_side: bool = Field(
        False, description="A picture of the device holds both cameras' side by side."
    )
    right_comes_first: bool = Field(
        False, description="Of a side-by-side picture the left half is the right camera's."
    )
    width: int = Field(
        640, ge=16, le=16384, description="Of what a device sends, side by side both together [px]."
    )
    height: int = Field(480, ge=16, le=16384, description="Of what a device sends [px].")
    rate: float = Field(25.0, gt=0, le=1000, description="Pictures a second [1/s].")
    format: Literal["auto", "GREY", "YUYV", "MJPG"] = Field(
        "auto", description="Of pixels; auto: the first of these that has the size at the rate."
    )
    buffers: int = Field(4, ge=2, le=32, description="That the kernel fills in turn [1].")
    silence_s: float = Field(
        1.0, ge=0.1, le=60, description="Without a picture, until it is started anew [s]."
    )
    stamp_delay_s: float = Field(
        0.0, ge=-1, le=1, description="How long after the exposure's middle it is stamped [s]."
    )
    left_calibration: ReadPath | None = Field(
        None, description="camera_info YAML file of the left camera, or of the only one."
    )
    right_calibration: ReadPath | None = Field(
        None, description="camera_info YAML file of the right camera."
    )
    mount: Mount = Field(Mount(), description="Where the left camera sits on the robot.")
    z: float = Field(1.0, ge=0.0, le=10, description="How high above the floor [m].")
    controls: ControlsConfig = Field(
        ControlsConfig(), description="Exposure, gain and the like, of both cameras."
    )

    @property
    def is_stereo(self) -> bool:
        """Whether there is a right camera."""
        return self.side_by_side or self.right_device is not None

    def devices(self) -> list[str]:
        """The devices, left first."""
        return [self.device] if self.right_device is None else [self.device, self.right_device]

    def settings_of(self, device: str) -> CameraSettings:
        """What is asked of one of them."""
        formats = FORMATS if self.format == "auto" else (self.format,)
        return CameraSettings(
            device, formats, self.width, self.height, self.rate, self.buffers, self.silence_s
        )

    @model_validator(mode="after")
    def _whole(self) -> Self:
        for key in ("device", "right_device"):
            named = getattr(self, key)
            if named is not None and not is_name(named):
                raise ValueError(f"{key} = {named!r} is no name of a camera: give {_HOW}")
        if self.side_by_side and self.right_device is not None:
            raise ValueError("side_by_side cameras are one device: leave right_device out")
        if self.device == self.right_device:
            raise ValueError(f"device and right_device are both {self.device!r}")
        if self.side_by_side and self.width % 2:
            raise ValueError(f"side_by_side needs an even width, not {self.width}")
        if self.right_comes_first and not self.side_by_side:
            raise ValueError("right_comes_first is of side_by_side cameras; swap the devices")
        if self.right_calibration is not None and not self.is_stereo:
            raise ValueError("right_calibration is given, but there is no right camera")
        return self


LIVE = ("controls", "stamp_delay_s")
"""Parameters that may be changed while the camera runs."""
