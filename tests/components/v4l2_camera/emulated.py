"""The driver as a plugin, on cameras in software that stream by themselves.

A camera is plugged in as long as the file that it is named after is there.
"""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cairn.components.v4l2_camera.component import V4l2StereoCamera
from cairn.components.v4l2_camera.device import Setup
from cairn.components.v4l2_camera.stream import Capture
from cairn.driver.errors import LinkLost
from tests.components.v4l2_camera.fakes import HEIGHT, WIDTH, FakeCamera, FakeDevice

RATE = 10.0
_PERIOD_S = 1.0 / RATE


class EmulatedStereoCamera(V4l2StereoCamera):
    """The driver of cameras behind V4L2, on emulated ones."""

    def on_configure(self) -> None:
        """Put emulated cameras in the place of the kernel's."""
        patch = pytest.MonkeyPatch()  # never undone: the process is this driver's alone
        patch.setattr("cairn.components.v4l2_camera.camera.VideoDevice", _Device)
        patch.setattr("cairn.components.v4l2_camera.camera.Stream", _Stream)
        super().on_configure()


class _Device(FakeDevice):
    def __init__(self, path: Path) -> None:
        _check_plugged(path)
        super().__init__(path, FakeCamera())

    def set_up(self, name: str, width: int, height: int, rate: float) -> Setup:
        return replace(super().set_up(name, width, height, rate), rate=RATE)


class _Stream:
    """A picture of noise at each whole period, so that two cameras are synchronized."""

    def __init__(self, device: _Device, _buffers: int) -> None:
        self._path = device.path
        self._number = 0
        self._never = threading.Event()

    def start(self) -> None:
        self._number = int(time.monotonic() / _PERIOD_S) + 1

    def stop(self) -> None:
        _check_plugged(self._path)

    def close(self) -> None:
        """There is nothing to let go of."""

    def newest(self, limit_s: float) -> list[Capture]:
        taken_s = self._number * _PERIOD_S
        wait_s = taken_s - time.monotonic()
        self._never.wait(max(0.0, min(wait_s, limit_s)))
        _check_plugged(self._path)
        if wait_s > limit_s:
            return []
        noise = np.random.default_rng(self._number).integers(0, 256, WIDTH * HEIGHT, np.uint8)
        self._number += 1
        return [Capture(noise.tobytes(), self._number, round(1e9 * taken_s), False, False)]


def _check_plugged(path: Path) -> None:
    if not path.exists():
        raise LinkLost(f"{path} is gone")
