"""Controls by name, checked against the bounds of the camera."""

import pytest

from cairn.components.v4l2_camera import videodev
from cairn.components.v4l2_camera.controls import (
    STANDARD,
    CameraControl,
    ControlRejected,
    assign_controls,
    plain_name,
)

GAIN = CameraControl(STANDARD["gain"], "gain", videodev.CTRL_TYPE_INTEGER, 0, 100, 5, 0, 0)
AUTO = CameraControl(
    STANDARD["auto_exposure"],
    "exposure_auto",  # as kernels until 5.15 call it
    videodev.CTRL_TYPE_MENU,
    0,
    3,
    1,
    3,
    0,
    {1: "Manual Mode", 3: "Aperture Priority Mode"},
)
EXPOSURE = CameraControl(
    STANDARD["exposure_time_absolute"], "exposure_absolute", videodev.CTRL_TYPE_INTEGER,
    3, 2047, 1, 250, videodev.CTRL_FLAG_INACTIVE,
)  # fmt: skip
LED = CameraControl(0x0A046D05, "led1_mode", videodev.CTRL_TYPE_INTEGER, 0, 3, 1, 3, 0)
BITS = CameraControl(1, "bits", videodev.CTRL_TYPE_BITMASK, 0, -(2**31) + 1, 0, 0, 0)
READ_ONLY = CameraControl(
    2, "power", videodev.CTRL_TYPE_INTEGER, 0, 9, 1, 0, videodev.CTRL_FLAG_READ_ONLY
)
CAMERA = {one.name: one for one in (EXPOSURE, GAIN, AUTO, LED, BITS, READ_ONLY)}


def test_automatic_modes_are_set_before_the_controls_they_own() -> None:
    requested = {"led1_mode": 1, "exposure_time_absolute": 157, "auto_exposure": 1}

    assert assign_controls(CAMERA, requested) == [(AUTO, 1), (EXPOSURE, 157), (LED, 1)]


def test_old_control_names_are_accepted() -> None:
    assert assign_controls(CAMERA, {"exposure_auto": 3}) == [(AUTO, 3)]


@pytest.mark.parametrize(
    ("requested", "message"),
    [
        ({"gain": 101}, "gain = 101.* 0 to 100 .* 5"),
        ({"gain": -1}, "gain = -1.* 0 to 100 .* 5"),
        ({"gain": 7}, "gain = 7.* 0 to 100 .* 5"),
        ({"auto_exposure": 0}, r"accepts 1 \(Manual Mode\), 3 \(Aperture Priority Mode\)"),
        ({"gamma": 1}, "gamma.* bits, exposure_absolute, exposure_auto, gain"),
        ({"bits": 2}, "bits = 2.* 0x80000001"),
        ({"power": 1}, "power is read-only"),
    ],
)
def test_invalid_value_is_rejected_with_its_bounds(requested: dict[str, int], message: str) -> None:
    with pytest.raises(ControlRejected, match=message):
        assign_controls(CAMERA, requested)


def test_bitmask_value_is_accepted() -> None:
    assert assign_controls(CAMERA, {"bits": 0x80000001}) == [(BITS, 0x80000001)]


@pytest.mark.parametrize(
    ("name", "plain"),
    [
        ("Exposure Time, Absolute", "exposure_time_absolute"),
        ("White Balance, Automatic", "white_balance_automatic"),
        ("LED1 Mode", "led1_mode"),
    ],
)
def test_names_equal_those_of_v4l2_ctl(name: str, plain: str) -> None:
    assert plain_name(name) == plain
