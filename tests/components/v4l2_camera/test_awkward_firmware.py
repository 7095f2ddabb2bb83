"""Cameras whose firmware does not answer for all that it offers are used as far as it does."""

from __future__ import annotations

import ctypes
import errno
from pathlib import Path
from typing import Any

import pytest

from cairn.components.v4l2_camera import listing, videodev
from cairn.components.v4l2_camera.controls import STANDARD
from cairn.components.v4l2_camera.device import VideoDevice
from cairn.components.v4l2_camera.names import CameraNode
from cairn.driver.errors import DeviceError, LinkLost

BRIGHTNESS, GAIN, EXPOSURE = (
    STANDARD[name] for name in ("brightness", "gain", "exposure_time_absolute")
)


class Firmware:
    """A camera behind the system's call, with some controls; fails to answer for some of them."""

    def __init__(self, *controls: int) -> None:
        self.controls = sorted(controls)
        self.no_description: dict[int, int] = {}
        self.no_value: dict[int, int] = {}

    def ioctl(self, _descriptor: int, number: int, by_reference: Any) -> int:
        """Answer a request as Linux does: 0, or -1 with an error in `errno`."""
        argument = by_reference._obj
        fault = errno.ENOTTY
        if number == videodev.QUERYCAP:
            argument.capabilities = videodev.CAP_VIDEO_CAPTURE | videodev.CAP_STREAMING
            fault = 0
        if number == videodev.QUERYCTRL:
            fault = self._describe(argument)
        if number == videodev.G_CTRL:
            argument.value = 5
            fault = self.no_value.get(argument.id, 0)
        ctypes.set_errno(fault)
        return -1 if fault else 0

    def _describe(self, query: videodev.ControlQuery) -> int:
        asked = query.id & ~videodev.CTRL_FLAG_NEXT_CTRL
        wants_next = asked != query.id
        found = [one for one in self.controls if (one > asked if wants_next else one == asked)]
        if not found:
            return errno.EINVAL
        if found[0] in self.no_description:
            return self.no_description[found[0]]
        query.id, query.type, query.maximum = found[0], videodev.CTRL_TYPE_INTEGER, 9
        query.name = f"Control {found[0]:x}".encode()
        return 0


@pytest.fixture
def firmware(monkeypatch: pytest.MonkeyPatch) -> Firmware:
    camera = Firmware(BRIGHTNESS, GAIN, EXPOSURE)
    monkeypatch.setattr("cairn.components.v4l2_camera.device._IOCTL", camera.ioctl)
    return camera


@pytest.fixture
def device(firmware: Firmware) -> VideoDevice:
    return VideoDevice(Path("/dev/null"))


def numbers(device: VideoDevice) -> list[int]:
    return [control.id for control in device.controls().values()]


def test_all_controls_are_found(device: VideoDevice) -> None:
    assert numbers(device) == [BRIGHTNESS, GAIN, EXPOSURE]


def test_controls_behind_one_that_is_not_described_are_found(
    firmware: Firmware, device: VideoDevice
) -> None:
    firmware.no_description = {GAIN: errno.EIO}

    assert numbers(device) == [BRIGHTNESS, EXPOSURE]


def test_a_camera_that_is_unplugged_meanwhile_is_not_one_with_fewer_controls(
    firmware: Firmware, device: VideoDevice
) -> None:
    firmware.no_description = {GAIN: errno.EIO, EXPOSURE: errno.ENODEV}

    with pytest.raises(LinkLost):
        device.controls()


def test_a_value_that_is_not_told_does_not_spoil_the_list(
    firmware: Firmware, monkeypatch: pytest.MonkeyPatch
) -> None:
    firmware.no_value = {GAIN: errno.EPIPE}
    node = CameraNode(Path("/dev/null"), "Awkward")
    monkeypatch.setattr(listing, "video_nodes", lambda: [node])

    [camera] = listing.listed()

    assert camera["fault"] == ""
    told = "\n".join(listing.as_lines(camera))
    assert f"control_{BRIGHTNESS:x} = 5: 0 to 9" in told
    assert f"control_{GAIN:x} = unknown: 0 to 9" in told


def test_what_is_no_camera_is_told_as_such() -> None:
    with pytest.raises(DeviceError, match=r"/dev/null: .*; it is no camera: `cairn driver probe"):
        VideoDevice(Path("/dev/null"))
