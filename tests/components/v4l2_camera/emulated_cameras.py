"""The driver as a plugin, on emulated cameras that stream by themselves.

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
from cairn.components.v4l2_camera.device import FilledBuffer
from cairn.components.v4l2_camera.format_negotiation import CaptureFormat
from cairn.driver.errors import LinkLost
from tests.components.v4l2_camera.fake_cameras import HEIGHT, WIDTH, FakeCamera, FakeDevice

RATE = 10.0
_PERIOD_S = 1.0 / RATE


class EmulatedStereoCamera(V4l2StereoCamera):
    """The V4L2 driver with emulated cameras."""

    def on_configure(self) -> None:
        """Replace the kernel's cameras by emulated ones."""
        patch = pytest.MonkeyPatch()  # never undone: the process is this driver's alone
        patch.setattr("cairn.components.v4l2_camera.camera.VideoDevice", _Device)
        patch.setattr("cairn.components.v4l2_camera.camera.VideoStream", _Stream)
        super().on_configure()


class _Device(FakeDevice):
    def __init__(self, path: Path) -> None:
        _check_plugged(path)
        super().__init__(path, FakeCamera())

    def set_format(self, name: str, width: int, height: int, rate: float) -> CaptureFormat:
        return replace(super().set_format(name, width, height, rate), rate=RATE)


class _Stream:
    """An image of noise at each whole period, so that two cameras are synchronized.

    If it is read late, only the newest image is left, as in a camera.
    """

    def __init__(self, device: _Device, _buffers: int) -> None:
        self._path = device.path
        self._number = 0
        self._never = threading.Event()

    def start(self) -> None:
        self._number = int(time.monotonic() / _PERIOD_S) + 1

    def stop(self) -> None:
        _check_plugged(self._path)

    def close(self) -> None:
        """Do nothing: there are no buffers."""

    def newest(self, timeout_s: float) -> list[FilledBuffer]:
        self._number = max(self._number, int(time.monotonic() / _PERIOD_S))
        captured_s = self._number * _PERIOD_S
        wait_s = captured_s - time.monotonic()
        self._never.wait(max(0.0, min(wait_s, timeout_s)))
        _check_plugged(self._path)
        if wait_s > timeout_s:
            return []
        noise = np.random.default_rng(self._number).integers(0, 256, WIDTH * HEIGHT, np.uint8)
        self._number += 1
        return [FilledBuffer(noise.tobytes(), self._number, round(1e9 * captured_s), False, False)]


def _check_plugged(path: Path) -> None:
    if not path.exists():
        raise LinkLost(f"{path} is gone")
