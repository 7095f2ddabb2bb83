"""Cameras in software, in place of `VideoDevice` and `Stream`."""

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
from cairn.components.v4l2_camera.controls import STANDARD, Control
from cairn.components.v4l2_camera.device import Setup
from cairn.components.v4l2_camera.offers import PictureSize
from cairn.components.v4l2_camera.pixels import PictureLayout
from cairn.components.v4l2_camera.stream import Capture
from cairn.driver.errors import DeviceError, LinkLost
from tests.patience import LIMIT_S

WIDTH, HEIGHT, RATE = 64, 48, 25.0
LEFT, RIGHT = "/dev/left", "/dev/right"
ONE: Mapping[str, Any] = {"device": LEFT, "width": WIDTH, "height": HEIGHT, "format": "GREY"}
"""A driver's parameters for the left camera alone, and below for both."""
TWO: Mapping[str, Any] = {**ONE, "right_device": RIGHT}


class FakeCamera:
    """A camera that gives what the test orders."""

    def __init__(self, gain_maximum: int = 255) -> None:
        self.plugged = True
        self.size = (WIDTH, HEIGHT)
        self.values = {"gain": 10, "exposure_time_absolute": 100}
        self.maxima = {"gain": gain_maximum, "exposure_time_absolute": 2000}
        self.held: set[str] = set()
        self.refused_values: set[int] = set()
        self.spoils = False
        self.opened = 0
        self.streams: list[str] = []
        self.events: queue.SimpleQueue[Capture | Exception | Callable[[], None]] = (
            queue.SimpleQueue()
        )
        self._sequence = 0

    def send(
        self, gray: int = 0, *, taken: int | None = -1, short: int = 0, is_damaged: bool = False
    ) -> None:
        """Have it give a picture of one gray level, taken [ns] now unless told otherwise."""
        data = bytes([gray]) * (self.size[0] * self.size[1] - short)
        told = time.monotonic_ns() if taken == -1 else taken
        self.events.put(Capture(data, self._sequence, told, False, is_damaged))
        self._sequence += 1

    def lose(self, count: int) -> None:
        """Have it lose so many pictures."""
        self._sequence += count

    def fail(self, error: Exception | None = None) -> None:
        """Have its stream break off."""
        self.events.put(error or DeviceError("/dev/it: its stream broke off: Input/output error"))

    def hang(self) -> threading.Event:
        """Have it hold up who reads it, until what is given is set."""
        begun, over = threading.Event(), threading.Event()

        def held_up() -> None:
            begun.set()
            over.wait()

        self.events.put(held_up)
        assert begun.wait(LIMIT_S), "nobody reads the camera"
        return over

    def unplug(self) -> None:
        """Take it away."""
        self.plugged = False
        self.events.put(LinkLost("/dev/it is gone: it was unplugged"))

    def plug_in(self) -> None:
        """Give it back, as it is after power-on."""
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
        patch.setattr(f"{module}.Stream", _Stream)

    def add(self, path: str, **how: int) -> FakeCamera:
        """Plug in one more."""
        self.cameras[path] = FakeCamera(**how)
        return self.cameras[path]

    def _find(self, wanted: str) -> Path:
        if wanted not in self.cameras or not self.cameras[wanted].plugged:
            raise LinkLost(f"{wanted}: there is no such camera")
        return Path(wanted)

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

    def sizes(self, _: str) -> list[PictureSize]:
        return [PictureSize(WIDTH, HEIGHT, (RATE,))]

    def set_up(self, name: str, width: int, height: int, rate: float) -> Setup:
        return Setup(PictureLayout(*self.camera.size, name), RATE)

    def controls(self) -> dict[str, Control]:
        return {
            name: Control(STANDARD[name], name, videodev.CTRL_TYPE_INTEGER, 0, most, 1, 0, 0)
            for name, most in self.camera.maxima.items()
        }

    def is_held(self, control: Control) -> bool:
        return control.name in self.camera.held

    def control(self, control: Control) -> int:
        return self.camera.values[control.name]

    def set_control(self, control: Control, value: int) -> None:
        if not self.camera.plugged:
            raise LinkLost(f"{self.path} is gone")
        if value in self.camera.refused_values:
            raise DeviceError(f"{self.path}: set {control.name} = {value}: Input/output error")
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

    def newest(self, limit_s: float) -> Sequence[Capture]:
        if self._camera.spoils:
            self._camera.send(is_damaged=True)
        try:
            event = self._camera.events.get(timeout=limit_s)
        except queue.Empty:
            return []
        if isinstance(event, Exception):
            raise event
        if not isinstance(event, Capture):
            event()
            return []
        return [event]


def level(image: object) -> int:
    """The gray level of an image that has one only."""
    [found] = np.unique(np.asarray(image.data))  # type: ignore[attr-defined]
    return int(found)
