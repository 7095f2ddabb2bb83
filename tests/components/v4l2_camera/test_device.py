"""Video nodes whose firmware does not answer every request are used as far as possible."""

from __future__ import annotations

import ctypes
import errno
import mmap
import os
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from cairn.components.v4l2_camera import probe_cli, videodev
from cairn.components.v4l2_camera.camera_names import CameraNode
from cairn.components.v4l2_camera.controls import STANDARD
from cairn.components.v4l2_camera.device import VideoDevice, VideoStream
from cairn.driver.errors import DeviceError, LinkLost
from tests.wording import words_in_order

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


def test_controls_after_a_failing_one_are_found(firmware: Firmware, device: VideoDevice) -> None:
    firmware.no_description = {GAIN: errno.EIO}

    assert numbers(device) == [BRIGHTNESS, EXPOSURE]


def test_unplugging_while_controls_are_listed_is_an_error(
    firmware: Firmware, device: VideoDevice
) -> None:
    firmware.no_description = {GAIN: errno.EIO, EXPOSURE: errno.ENODEV}

    with pytest.raises(LinkLost):
        device.controls()


def test_unreadable_value_does_not_prevent_the_list(
    firmware: Firmware, monkeypatch: pytest.MonkeyPatch
) -> None:
    firmware.no_value = {GAIN: errno.EPIPE}
    node = CameraNode(Path("/dev/null"), "Awkward")
    monkeypatch.setattr(probe_cli, "video_nodes", lambda: [node])

    [camera] = probe_cli.describe_cameras()

    assert camera["error"] == ""
    text = "\n".join(probe_cli.description_lines(camera))
    assert f"control_{BRIGHTNESS:x} = 5: 0 to 9" in text
    assert f"control_{GAIN:x} = unknown: 0 to 9" in text


def test_device_that_is_not_a_camera_is_named_as_such() -> None:
    with pytest.raises(DeviceError, match=words_in_order("/dev/null", "not a camera", "`cairn")):
        VideoDevice(Path("/dev/null"))


class SharedBuffers:
    """A device whose buffers lie in a memory file; the test fills them."""

    path = Path("/dev/video0")

    def __init__(self, size: int) -> None:
        self._size = size
        self._memory = os.memfd_create("buffers")
        self._filled: list[tuple[int, int, int]] = []

    def fill(self, index: int, data: bytes, flags: int = 0) -> None:
        os.pwrite(self._memory, data, index * self._size)
        self._filled.append((index, len(data), flags))

    def fileno(self) -> int:
        return self._memory

    def request(self, number: int, argument: Any, _action: str) -> None:
        if number == videodev.REQBUFS:
            os.ftruncate(self._memory, argument.count * self._size)
        if number == videodev.QUERYBUF:
            argument.length, argument.m.offset = self._size, argument.index * self._size

    def ioctl(self, number: int, argument: Any) -> None:
        if number == videodev.DQBUF:
            if not self._filled:
                raise OSError(errno.EAGAIN, "no buffer is filled")
            argument.index, argument.bytesused, argument.flags = self._filled.pop(0)


def test_good_image_is_read_although_a_damaged_one_follows() -> None:
    device = SharedBuffers(mmap.PAGESIZE)
    with closing(VideoStream(device, 4)) as stream:  # type: ignore[arg-type] # all that it uses
        stream.start()
        device.fill(0, b"old")
        device.fill(1, b"good")
        device.fill(2, b"bad", videodev.BUF_FLAG_ERROR)
        buffers = stream.newest(0.0)

    assert [buffer.data for buffer in buffers] == [None, b"good", None]
    assert [buffer.is_damaged for buffer in buffers] == [False, False, True]
