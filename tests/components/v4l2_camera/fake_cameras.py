"""Fake cameras in place of `VideoDevice` and `VideoStream`, controlled by the test."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cairn.components.v4l2_camera import videodev
from cairn.components.v4l2_camera.controls import STANDARD, CameraControl
from cairn.components.v4l2_camera.decoding import ImageLayout
from cairn.components.v4l2_camera.device import FilledBuffer
from cairn.components.v4l2_camera.format_negotiation import CaptureFormat, FrameSize
from cairn.driver.errors import DeviceError, LinkLost
from tests.patience import LIMIT_S

WIDTH, HEIGHT, RATE = 64, 48, 25.0
_POLL_S = 0.01
LEFT, RIGHT = "/dev/left", "/dev/right"
ONE: Mapping[str, Any] = {"device": LEFT, "width": WIDTH, "height": HEIGHT, "format": "GREY"}
"""Parameters of a driver for the left camera alone; `TWO`: for both."""
TWO: Mapping[str, Any] = {**ONE, "right_device": RIGHT}


class FakeCamera:
    """A camera that sends what the test requests."""

    def __init__(self, gain_maximum: int = 255) -> None:
        self.plugged = True
        self.size = (WIDTH, HEIGHT)
        self.values = {"gain": 10, "exposure_time_absolute": 100}
        self.maxima = {"gain": gain_maximum, "exposure_time_absolute": 2000}
        self.inactive: set[str] = set()
        self.rejected_values: set[int] = set()
        self.damages_all = False
        self.opened = 0
        self.streams: list[str] = []
        self.events: queue.Queue[FilledBuffer | Exception | Callable[[], None]] = queue.Queue()
        self._sequence = 0

    def send(
        self, gray: int = 0, *, captured: int | None = -1, short: int = 0, is_damaged: bool = False
    ) -> None:
        """Send an image of one gray level, captured [ns] now by default."""
        data = bytes([gray]) * (self.size[0] * self.size[1] - short)
        reported = time.monotonic_ns() if captured == -1 else captured
        self.events.put(FilledBuffer(data, self._sequence, reported, False, is_damaged))
        self._sequence += 1

    def lose(self, count: int) -> None:
        """Lose frames."""
        self._sequence += count

    def fail(self, error: Exception | None = None) -> None:
        """Make its stream fail."""
        self.events.put(error or DeviceError("/dev/it: its stream failed: Input/output error"))

    def hang(self) -> threading.Event:
        """Block its reader until the returned event is set."""
        blocked, released = threading.Event(), threading.Event()

        def block() -> None:
            blocked.set()
            released.wait()

        self.events.put(block)
        assert blocked.wait(LIMIT_S), "the camera is not read"
        return released

    def await_closed_stream(self) -> None:
        """Wait until its stream is closed."""
        deadline = time.monotonic() + LIMIT_S
        while self.streams[-1:] != ["close"]:
            assert time.monotonic() < deadline, f"its stream is not closed: {self.streams}"
            time.sleep(_POLL_S)

    def unplug(self) -> None:
        """Unplug it."""
        self.plugged = False
        self.events.put(LinkLost("/dev/it has disappeared: it was unplugged"))

    def plug_in(self) -> None:
        """Plug it in, in the state after power-on."""
        while not self.events.empty():
            self.events.get()
        self.values = {"gain": 10, "exposure_time_absolute": 100}
        self._sequence = 0
        self.plugged = True


class FakeCameras:
    """The cameras of a computer, by path."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.cameras: dict[str, FakeCamera] = {}
        module = "cairn.components.v4l2_camera.camera"
        patch.setattr(f"{module}.find_camera", self._find)
        patch.setattr(f"{module}.VideoDevice", self._open)
        patch.setattr(f"{module}.VideoStream", _Stream)

    def add(self, path: str, **options: int) -> FakeCamera:
        """Plug in another camera."""
        self.cameras[path] = FakeCamera(**options)
        return self.cameras[path]

    def _find(self, name: str) -> Path:
        if name not in self.cameras or not self.cameras[name].plugged:
            raise LinkLost(f"{name}: there is no such camera")
        return Path(name)

    def _open(self, path: Path) -> FakeDevice:
        return FakeDevice(path, self.cameras[str(path)])


class FakeDevice:
    card, bus = "Fake", "usb-1"

    def __init__(self, path: Path, camera: FakeCamera) -> None:
        self.path, self.camera = path, camera
        camera.opened += 1

    def close(self) -> None:
        self.camera.opened -= 1

    def formats(self) -> list[str]:
        return ["YUYV", "GREY"]

    def sizes(self, _: str) -> list[FrameSize]:
        return [FrameSize(WIDTH, HEIGHT, (RATE,))]

    def set_format(self, name: str, width: int, height: int, rate: float) -> CaptureFormat:
        return CaptureFormat(ImageLayout(*self.camera.size, name), RATE)

    def controls(self) -> dict[str, CameraControl]:
        return {
            name: CameraControl(
                STANDARD[name], name, videodev.CTRL_TYPE_INTEGER, 0, maximum, 1, 0, 0
            )
            for name, maximum in self.camera.maxima.items()
        }

    def is_inactive(self, control: CameraControl) -> bool:
        return control.name in self.camera.inactive

    def control(self, control: CameraControl) -> int:
        return self.camera.values[control.name]

    def set_control(self, control: CameraControl, value: int) -> None:
        if not self.camera.plugged:
            raise LinkLost(f"{self.path} is gone")
        if value in self.camera.rejected_values:
            raise DeviceError(f"{self.path}: setting {control.name} = {value}: Input/output error")
        self.camera.values[control.name] = value


class _Stream:
    def __init__(self, device: FakeDevice, _buffers: int) -> None:
        self._camera = device.camera

    def start(self) -> None:
        self._camera.streams.append("start")

    def stop(self) -> None:
        self._camera.streams.append("stop")

    def close(self) -> None:
        self._camera.streams.append("close")

    def newest(self, timeout_s: float) -> Sequence[FilledBuffer]:
        if self._camera.damages_all:
            self._camera.send(is_damaged=True)
        try:
            event = self._camera.events.get(timeout=timeout_s)
        except queue.Empty:
            return []
        if isinstance(event, Exception):
            raise event
        if not isinstance(event, FilledBuffer):
            event()
            return []
        return [event]


def level(image: object) -> int:
    """Return the gray level of a uniform image."""
    [found] = np.unique(np.asarray(image.data))  # type: ignore[attr-defined]
    return int(found)
