"""Controls by name, judged by the camera's own bounds."""

import pytest

from cairn.components.v4l2_camera import videodev
from cairn.components.v4l2_camera.controls import (
    STANDARD,
    Control,
    ControlRefused,
    assigned,
    plain_name,
)

GAIN = Control(STANDARD["gain"], "gain", videodev.CTRL_TYPE_INTEGER, 0, 100, 5, 0, 0)
AUTO = Control(
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
EXPOSURE = Control(
    STANDARD["exposure_time_absolute"], "exposure_absolute", videodev.CTRL_TYPE_INTEGER,
    3, 2047, 1, 250, videodev.CTRL_FLAG_INACTIVE,
)  # fmt: skip
LED = Control(0x0A046D05, "led1_mode", videodev.CTRL_TYPE_INTEGER, 0, 3, 1, 3, 0)
BITS = Control(1, "bits", videodev.CTRL_TYPE_BITMASK, 0, -(2**31) + 1, 0, 0, 0)
READ_ONLY = Control(
    2, "power", videodev.CTRL_TYPE_INTEGER, 0, 9, 1, 0, videodev.CTRL_FLAG_READ_ONLY
)
CAMERA = {one.name: one for one in (EXPOSURE, GAIN, AUTO, LED, BITS, READ_ONLY)}


def test_automatics_are_set_before_what_they_hold() -> None:
    wanted = {"led1_mode": 1, "exposure_time_absolute": 157, "auto_exposure": 1}

    assert assigned(CAMERA, wanted) == [(AUTO, 1), (EXPOSURE, 157), (LED, 1)]


def test_old_names_are_known_too() -> None:
    assert assigned(CAMERA, {"exposure_auto": 3}) == [(AUTO, 3)]


@pytest.mark.parametrize(
    ("wanted", "told"),
    [
        ({"gain": 101}, "gain = 101: the camera takes 0 to 100 in steps of 5"),
        ({"gain": -1}, "gain = -1: the camera takes 0 to 100 in steps of 5"),
        ({"gain": 7}, "gain = 7: the camera takes 0 to 100 in steps of 5"),
        ({"auto_exposure": 0}, r"takes 1 \(Manual Mode\), 3 \(Aperture Priority Mode\)"),
        ({"gamma": 1}, "no control gamma; it has bits, exposure_absolute, exposure_auto, gain"),
        ({"bits": 2}, "bits = 2: the camera takes bits of 0x80000001"),
        ({"power": 1}, "power can only be read"),
    ],
)
def test_what_the_camera_does_not_take_is_refused_with_its_bounds(
    wanted: dict[str, int], told: str
) -> None:
    with pytest.raises(ControlRefused, match=told):
        assigned(CAMERA, wanted)


def test_bits_are_taken() -> None:
    assert assigned(CAMERA, {"bits": 0x80000001}) == [(BITS, 0x80000001)]


@pytest.mark.parametrize(
    ("told", "plain"),
    [
        ("Exposure Time, Absolute", "exposure_time_absolute"),
        ("White Balance, Automatic", "white_balance_automatic"),
        ("LED1 Mode", "led1_mode"),
    ],
)
def test_names_are_written_as_v4l2_ctl_writes_them(told: str, plain: str) -> None:
    assert plain_name(told) == plain
