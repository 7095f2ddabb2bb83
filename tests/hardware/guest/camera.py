"""What the tests of cameras share: the driver on its real loop, vivid's cameras, a loopback."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Self

from cairn.bus.lockstep_bus import LockstepBus
from cairn.bus.qos import Qos
from cairn.clock import SystemClock
from cairn.component.lifecycle import Transition
from cairn.component.loop import ThreadLoop
from cairn.component.ports import ports_of
from cairn.component.runtime import Assignment, End, Runtime
from components.v4l2_camera import videodev
from components.v4l2_camera.component import V4l2StereoCamera
from components.v4l2_camera.device import VideoDevice
from components.v4l2_camera.names import find_camera, video_nodes
from tests.hardware.guest.modules import run, settle

LIMIT_S = 15.0
LEFT, RIGHT = "name:vivid-000-vid-cap", "name:vivid-001-vid-cap"
_ALL = Qos("reliable", "transient_local", 10_000)
_DRIVER = Path("/sys/bus/platform/drivers/vivid")
_OUTPUT = 2  # V4L2_BUF_TYPE_VIDEO_OUTPUT


class Driver:
    """The camera's driver, active, on a loop of its own; a context manager that shuts it down."""

    def __init__(self, **parameters: Any) -> None:
        """Configure and activate it; raises `CairnError` if it cannot be."""
        self.ends: list[End] = []
        self._loop = ThreadLoop()
        bus = LockstepBus()
        assignment = Assignment(name="camera", plugin="v4l2", parameters=parameters)
        self.runtime = Runtime(
            V4l2StereoCamera, assignment, bus, self._loop, SystemClock(), self.ends.append
        )
        self._came = threading.Event()
        test = bus.node("/robot/test", self.runtime.log.error)
        self._readers = {
            port.name: test.subscribe(f"/robot/{port.name}", port.message, _ALL, self._came.set)
            for port in ports_of(V4l2StereoCamera).values()
        }
        self._thread = threading.Thread(target=self._loop.run, daemon=True)
        self._thread.start()
        self.go("configure", "activate")

    def go(self, *steps: str) -> None:
        """Walk its life cycle."""
        for step in steps:
            self.ask(partial(self.runtime.transition, Transition(step)))

    def set(self, **changes: Any) -> None:
        """Change parameters; `controls__gain` is `controls.gain`."""
        named = {name.replace("__", "."): value for name, value in changes.items()}
        self.ask(lambda: self.runtime.set_parameters(named))

    def ask(self, call: Callable[[], None]) -> None:
        """Have a call made by its loop; raises what that raises."""
        done = threading.Event()
        failures: list[Exception] = []

        def made() -> None:
            try:
                call()
            except Exception as error:
                failures.append(error)
            done.set()

        self._loop.post(made)
        assert done.wait(LIMIT_S), "the driver's loop is held up"
        if failures:
            raise failures[0]

    def taken(self, port: str) -> list[Any]:
        """What it has sent since the last look."""
        messages = []
        while (message := self._readers[port].take()) is not None:
            messages.append(message)
        return messages

    def await_one(
        self, port: str, test: Callable[[Any], bool] = lambda _: True, limit_s: float = LIMIT_S
    ) -> Any:
        """Wait for a message that passes the test."""
        until = time.monotonic() + limit_s
        seen: list[Any] = []
        while (left_s := until - time.monotonic()) > 0:
            self._came.clear()
            for message in self.taken(port):
                seen.append(message)
                if test(message):
                    return message
            self._came.wait(left_s)
        raise AssertionError(f"no such message on {port} within {limit_s:g} s; {seen[-3:]}")

    def await_pictures(self, count: int) -> list[Any]:
        """Wait for so many left images from now on."""
        self.taken("left_image")
        return [self.await_one("left_image") for _ in range(count)]

    def values(self, index: int = 0) -> dict[str, str]:
        """What the next diagnostics tell: of the camera so numbered, or of the pair (2)."""
        self.taken("diagnostics")
        message = self.await_one("diagnostics")
        status = message.status[index]
        told = {value.key: value.value for value in status.values}
        return told | {"level": str(status.level), "message": status.message}

    def await_values(
        self, test: Callable[[dict[str, str]], bool], index: int = 0
    ) -> dict[str, str]:
        """Wait for diagnostics that pass the test."""
        until = time.monotonic() + LIMIT_S
        while not test(told := self.values(index)):
            assert time.monotonic() < until, f"diagnostics stay {told}"
        return told

    def __enter__(self) -> Self:
        """It is active already."""
        return self

    def __exit__(self, *_: object) -> None:
        """Shut it down, and wait for its end."""
        if not self.ends:
            self.go("shutdown")
        self._thread.join(LIMIT_S)
        assert not self._thread.is_alive()


def unload(module: str) -> None:
    """Unload a module; none of its devices may be open."""
    run("modprobe", "-r", module)


def load(module: str, *options: str) -> None:
    """Load a module with options; returns when its devices are there."""
    run("modprobe", module, *options)
    settle()


def load_cameras() -> None:
    """Load vivid: two webcams, `LEFT` and `RIGHT`."""
    load("vivid", "n_devs=2", "node_types=0x1,0x1")


def unplug_cameras() -> None:
    """Take both away, while whoever has them open has them open."""
    (_DRIVER / "unbind").write_text("vivid.0")


def plug_in_cameras() -> None:
    """Give them back."""
    (_DRIVER / "bind").write_text("vivid.0")


@contextmanager
def disconnected(camera: str) -> Iterator[None]:
    """Take one away; its node stays, as vivid has it, but cannot be opened."""
    device = VideoDevice(find_camera(camera))  # it is away as long as somebody has it open
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
        """`size` [bytes] is the most that a picture takes."""
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
