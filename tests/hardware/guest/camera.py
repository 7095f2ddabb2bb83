"""Shared by the tests of cameras: vivid's cameras and their faults, a loopback."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from cairn.components.v4l2_camera import videodev
from cairn.components.v4l2_camera.camera_names import find_camera, video_nodes
from cairn.components.v4l2_camera.device import VideoDevice
from tests.hardware.guest.modules import run, settle

# Pictures that need little time of the emulated guest.
SMALL: Mapping[str, Any] = {"format": "GREY", "width": 320, "height": 180, "rate": 25}
LEFT, RIGHT = "name:vivid-000-vid-cap", "name:vivid-001-vid-cap"
_DRIVER = Path("/sys/bus/platform/drivers/vivid")
_OUTPUT = 2  # V4L2_BUF_TYPE_VIDEO_OUTPUT


def unload(module: str) -> None:
    """Unload a module; none of its devices may be open."""
    run("modprobe", "-r", module)


def load(module: str, *options: str) -> None:
    """Load a module with options; returns when its devices exist."""
    run("modprobe", module, *options)
    settle()


def load_cameras() -> None:
    """Load vivid: two webcams, `LEFT` and `RIGHT`."""
    load("vivid", "n_devs=2", "node_types=0x1,0x1")


def unplug_cameras() -> None:
    """Remove both, while processes have them open."""
    (_DRIVER / "unbind").write_text("vivid.0")


def plug_in_cameras() -> None:
    """Create both again."""
    (_DRIVER / "bind").write_text("vivid.0")


@contextmanager
def disconnected(camera: str) -> Iterator[None]:
    """Disconnect one; vivid keeps its device node, but the node cannot be opened."""
    device = VideoDevice(
        find_camera(camera)
    )  # the camera is disconnected while a process has it open
    try:
        Knobs(camera).turn("disconnect")
        yield
    finally:
        device.close()


def value_of(camera: str, control: str) -> int:
    """The value of a camera's control, as another program sees it."""
    device = VideoDevice(find_camera(camera))
    try:
        return device.control(device.controls()[control])
    finally:
        device.close()


class Knobs:
    """vivid's buttons and settings that make one of its cameras fail."""

    _NUMBERS = {  # drivers/media/test-drivers/vivid/vivid-ctrls.c
        "timestamp_source": 0x00F0F018,
        "wrap_sequence_number": 0x00F0F026,
        "wrap_timestamp": 0x00F0F027,
        "percentage_of_dropped_buffers": 0x00F0F040,
        "disconnect": 0x00F0F041,
        "inject_v4l2_buf_flag_error": 0x00F0F042,
        "inject_vidioc_reqbufs_error": 0x00F0F043,
        "inject_vidioc_qbuf_error": 0x00F0F044,
        "inject_vidioc_streamon_error": 0x00F0F045,
        "inject_fatal_streaming_error": 0x00F0F046,
    }

    def __init__(self, camera: str) -> None:
        self._camera = camera

    def turn(self, name: str, value: int = 1) -> None:
        """Press a button, or set a value."""
        device = VideoDevice(find_camera(self._camera))
        try:
            device.ioctl(
                videodev.S_CTRL, videodev.ControlValue(id=self._NUMBERS[name], value=value)
            )
        finally:
            device.close()


class Loopback:
    """A camera whose pictures the test writes, one for each `write`."""

    def __init__(self, name: str, pixel_format: str, width: int, height: int, size: int) -> None:
        """`size` [bytes] is the maximum size of a picture."""
        [self.path] = [node.path for node in video_nodes() if node.name == name]
        self._descriptor = os.open(self.path, os.O_RDWR)
        asked = videodev.Format(type=_OUTPUT)
        pix = asked.fmt.pix
        pix.width, pix.height, pix.sizeimage = width, height, size
        pix.pixelformat, pix.field = videodev.fourcc(pixel_format), videodev.FIELD_NONE
        device = VideoDevice.__new__(VideoDevice)
        device.path, device._descriptor = Path(self.path), self._descriptor
        device.ioctl(videodev.S_FMT, asked)

    def write(self, data: bytes) -> None:
        """Send a picture."""
        assert os.write(self._descriptor, data) == len(data)

    def close(self) -> None:
        """Stop sending."""
        os.close(self._descriptor)
