"""Negotiation of pixel format, size and rate: what to request, and whether the answer is usable."""

from __future__ import annotations

import logging
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cairn import SECOND
from cairn.components.v4l2_camera.config import V4l2StereoCameraConfig
from cairn.components.v4l2_camera.decoding import ImageLayout
from cairn.driver.errors import DeviceError
from cairn.schemas.sensor_msgs import CameraInfo

# Rates are reported as fractions of small numbers: 30 images per second may be 29.97.
_SAME_RATE = 0.99


@dataclass(frozen=True)
class CaptureFormat:
    """What a camera agreed to send: the layout of its images, and how many per second.

    `rate` is 0 if the camera does not report it.
    """

    layout: ImageLayout
    rate: float

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self.layout.width, self.layout.height

    @property
    def size_text(self) -> str:
        """Width and height as text."""
        return f"{self.layout.width} x {self.layout.height}"


@dataclass(frozen=True)
class FrameSize:
    """An image size that a camera offers for a format [px], and its rates [1/s].

    For a range (`is_range`) it is the largest size, and the rates of that.
    """

    width: int
    height: int
    rates: tuple[float, ...]
    is_range: bool = False

    def fits(self, width: int, height: int, rate: float) -> bool:
        """Return whether it is that size, at least at that rate, as far as the camera reports."""
        if self.is_range:
            return width <= self.width and height <= self.height
        fast = not self.rates or max(self.rates) >= _SAME_RATE * rate
        return (self.width, self.height) == (width, height) and fast

    def __str__(self) -> str:
        size = f"{'up to ' if self.is_range else ''}{self.width} x {self.height}"
        rates = ", ".join(f"{rate:.4g}" for rate in sorted(self.rates, reverse=True))
        return f"{size} at {rates}/s" if rates else size


def best_format(
    offers: Mapping[str, Sequence[FrameSize]],
    accepted: Sequence[str],
    size: tuple[int, int],
    rate: float,
) -> str | None:
    """Return the first of the `accepted` pixel formats that is offered in this size at this rate.

    `offers` are all sizes by format, none where the camera does not report them. If no format fits,
    return the first that is offered at all: the camera then chooses the nearest size. Return None
    if it offers none of them.
    """
    offered = [name for name in accepted if name in offers]
    fitting = [
        name
        for name in offered
        if not offers[name] or any(frame_size.fits(*size, rate) for frame_size in offers[name])
    ]
    return next(iter(fitting + offered), None)


def is_same_rate(actual: float, requested: float) -> bool:
    """Return whether a rate is as good as the requested one; 0 is one that is not reported."""
    return actual == 0.0 or _SAME_RATE <= actual / requested <= 1.0 / _SAME_RATE


class FormatCheck:
    """Accepts or rejects what cameras send, by their calibrations and by one another.

    Cameras arrive when they are plugged in, in any order, each on the thread that opens it, and may
    be others when they come back. `infos` are those of calibrated cameras, left first, None for
    others.
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
        self._accepted: dict[int, CaptureFormat] = {}
        self._lock = threading.Lock()

    def accept(self, side: int, capture_format: CaptureFormat) -> None:
        """Accept the left (0) or the right (1) camera with what it sends.

        Raises `DeviceError` if the size differs from its calibration, from the other camera, or
        from what it was before. A difference from the requested size or rate is only logged.
        """
        with self._lock:
            self._check_earlier(side, capture_format)
            self._check_calibrations(side, capture_format)
            self._check_other(side, capture_format)
            if self._accepted.get(side) != capture_format:
                self._log_differences(side, capture_format)
            self._accepted[side] = capture_format

    def half_period(self) -> int:
        """Return half the time between two images of the slower camera [ns]."""
        with self._lock:
            rates = [accepted.rate or self._config.rate for accepted in self._accepted.values()]
        return round(0.5 * SECOND / min(rates, default=self._config.rate))

    def _check_earlier(self, side: int, capture_format: CaptureFormat) -> None:
        earlier = self._accepted.get(side, capture_format)
        if earlier.size != capture_format.size:
            raise DeviceError(
                f"{self._config.devices()[side]} sends {capture_format.size_text} pixels now, but "
                f"sent {earlier.size_text} before; is it another camera?"
            )

    def _check_calibrations(self, side: int, capture_format: CaptureFormat) -> None:
        width, height = capture_format.size
        files = (self._config.left_calibration, self._config.right_calibration)
        sides = [side]
        if self._config.side_by_side:
            width, sides = width // 2, [0, 1]
        for checked in sides:
            info = self._infos[checked]
            if info is not None and (info.width, info.height) != (width, height):
                raise DeviceError(
                    f"{files[checked]} is for images of {info.width} x {info.height} pixels, but "
                    f"the camera sends {width} x {height}; calibrate with such images, or change "
                    "width and height"
                )

    def _check_other(self, side: int, capture_format: CaptureFormat) -> None:
        other = self._accepted.get(1 - side, capture_format)
        if other.size != capture_format.size:
            sizes = " and ".join(sorted((capture_format.size_text, other.size_text)))
            raise DeviceError(
                f"the cameras send images of {sizes} pixels; set width and height to a size that "
                "both have"
            )

    def _log_differences(self, side: int, capture_format: CaptureFormat) -> None:
        config, device = self._config, self._config.devices()[side]
        if capture_format.size != (config.width, config.height):
            self._log.warning(
                "%s sends %s pixels instead of the requested %d x %d",
                device, capture_format.size_text, config.width, config.height,
            )  # fmt: skip
        if not is_same_rate(capture_format.rate, config.rate):
            self._log.warning(
                "%s sends %.4g images per second instead of the requested %g",
                device, capture_format.rate, config.rate,
            )  # fmt: skip
