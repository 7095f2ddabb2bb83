"""What the cameras have agreed to give, judged by their calibrations and by one another."""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence

from cairn import SECOND
from cairn.components.v4l2_camera.config import V4l2StereoCameraConfig
from cairn.components.v4l2_camera.device import Setup
from cairn.components.v4l2_camera.offers import is_same_rate
from cairn.driver.errors import DeviceError
from cairn.schemas.sensor_msgs import CameraInfo


class Agreement:
    """Takes cameras for those of a deployment, or refuses them.

    They come when they are there, in any order, each on the thread that opens it, and may be
    others when they come back. `infos` are those of calibrated cameras, left first, None of others.
    """

    def __init__(
        self,
        config: V4l2StereoCameraConfig,
        infos: Sequence[CameraInfo | None],
        log: logging.Logger,
    ) -> None:
        self._config = config
        self._infos = infos
        self._log = log
        self._setups: dict[int, Setup] = {}
        self._one_by_one = threading.Lock()

    def accept(self, side: int, setup: Setup) -> None:
        """Take the left (0) or the right (1) camera with what it gives.

        Raises `DeviceError` if that is of another size than its calibration, than the other
        camera's, or than it was before. What merely is not what was asked for is logged.
        """
        with self._one_by_one:
            self._judge_former(side, setup)
            self._judge_calibrations(side, setup)
            self._judge_other(side, setup)
            if self._setups.get(side) != setup:
                self._tell_difference(side, setup)
            self._setups[side] = setup

    def half_period(self) -> int:
        """Half the time between two pictures of the slower camera [ns]."""
        with self._one_by_one:
            rates = [setup.rate or self._config.rate for setup in self._setups.values()]
        return round(0.5 * SECOND / min(rates, default=self._config.rate))

    def _judge_former(self, side: int, setup: Setup) -> None:
        former = self._setups.get(side, setup)
        if _size(former) != _size(setup):
            raise DeviceError(
                f"{self._config.devices()[side]} gives {_told(setup)} pixels now, but gave "
                f"{_told(former)}: is it another camera?"
            )

    def _judge_calibrations(self, side: int, setup: Setup) -> None:
        width, height = _size(setup)
        files = (self._config.left_calibration, self._config.right_calibration)
        sides = [side]
        if self._config.side_by_side:
            width, sides = width // 2, [0, 1]
        for one in sides:
            info = self._infos[one]
            if info is not None and (info.width, info.height) != (width, height):
                raise DeviceError(
                    f"{files[one]} is of images of {info.width} x {info.height} pixels, but the "
                    f"camera gives {width} x {height}: calibrate with such images, or ask for "
                    "others by width and height"
                )

    def _judge_other(self, side: int, setup: Setup) -> None:
        other = self._setups.get(1 - side, setup)
        if _size(other) != _size(setup):
            told = " and ".join(sorted((_told(setup), _told(other))))
            raise DeviceError(f"the cameras give pictures of {told} pixels: ask for a size of both")

    def _tell_difference(self, side: int, setup: Setup) -> None:
        config, device = self._config, self._config.devices()[side]
        if _size(setup) != (config.width, config.height):
            self._log.warning(
                "%s gives %s pixels, not %d x %d as was asked for",
                device, _told(setup), config.width, config.height,
            )  # fmt: skip
        if not is_same_rate(setup.rate, config.rate):
            self._log.warning(
                "%s gives %.4g pictures a second, not %g as was asked for",
                device, setup.rate, config.rate,
            )  # fmt: skip


def _size(setup: Setup) -> tuple[int, int]:
    return setup.layout.width, setup.layout.height


def _told(setup: Setup) -> str:
    return f"{setup.layout.width} x {setup.layout.height}"
