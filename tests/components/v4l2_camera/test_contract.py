"""The driver fulfills the contract of a stereo camera, on cameras that can be unplugged."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import pytest

from cairn.testing.camera_contract import PicturesContract
from cairn.testing.driver_contract import ParametersContract, UnplugContract
from tests.components.v4l2_camera.emulated_cameras import RATE
from tests.patience import LIMIT_S


class Cables:
    """Two cameras, plugged in while their files are there."""

    def __init__(self, folder: Path) -> None:
        self._files = [folder / "left", folder / "right"]
        self.settings = {"left": str(self._files[0]), "right": str(self._files[1])}
        self.plug_in()

    def unplug(self) -> None:
        """Take both away."""
        for file in self._files:
            file.unlink()

    def plug_in(self) -> None:
        """Give both back."""
        for file in self._files:
            file.touch()


class TestEmulatedCameras(UnplugContract, ParametersContract, PicturesContract):
    deployment = """
settings: {left: "", right: ""}
components:
  camera:
    plugin: tests.components.v4l2_camera.emulated_cameras:EmulatedStereoCamera
    parameters:
      device: ${left}
      right_device: ${right}
      width: 64
      height: 48
      format: GREY
      rate: 10
"""
    rate_hz = RATE
    calibrated = False
    # On a busy machine it skips pictures, as it should.
    rate_tolerance, jitter, oldest_s = 0.4, 2.5, 10.0
    return_limit_s = report_limit_s = LIMIT_S
    live_parameters: ClassVar[Mapping[str, Any]] = {"controls.gain": 33, "stamp_delay_s": 0.01}

    @pytest.fixture(scope="class")
    @classmethod
    def device(cls, tmp_path_factory: pytest.TempPathFactory) -> Cables:
        """The cameras' cables."""
        return Cables(tmp_path_factory.mktemp("cameras"))
