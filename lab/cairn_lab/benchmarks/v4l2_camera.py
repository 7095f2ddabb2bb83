"""Processor time of the V4L2 stereo camera driver for one pair of images."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping

import cv2
import numpy as np
import simplejpeg

from cairn import In, every, on
from cairn.bus.qos import SENSOR
from cairn.components.v4l2_camera.component import V4l2StereoCamera
from cairn.components.v4l2_camera.decoding import ImageLayout
from cairn.runtime.component import Component
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn_lab.benchmarks.result import Metric
from cairn_lab.benchmarks.running import results, run_deployment

_HERE = "cairn_lab.benchmarks.v4l2_camera"
_WIDTH, _HEIGHT = 640, 480
_PAIRS = 200
_LIMIT_MS = 5.0


class FedCamera(V4l2StereoCamera):
    """The driver without the kernel: buffers are in its memory, and a timer delivers them."""

    def on_configure(self) -> None:
        """Create the buffers."""
        self._layout = ImageLayout(_WIDTH, _HEIGHT, self.config.format)
        self._buffers = [_buffer(self.config.format, seed) for seed in (0, 1)]
        self._infos = [CameraInfo(width=_WIDTH, height=_HEIGHT)] * 2
        self._times: list[tuple[float, float, float]] = []

    def on_activate(self) -> None:
        """Do nothing: there is no device."""

    def on_cleanup(self) -> None:
        """Do nothing: there is no device."""

    def publish_health(self) -> None:
        """Do nothing: there is no device."""

    @every(hz=50)
    def take(self) -> None:
        """Convert and publish a pair."""
        began = time.thread_time(), time.perf_counter()
        left, right = (self._layout.decode(buffer) for buffer in self._buffers)
        converted = time.thread_time()
        self._publish(self.clock.now(), (left, right))
        ended = time.thread_time(), time.perf_counter()
        self._times.append((ended[0] - began[0], converted - began[0], ended[1] - began[1]))
        if len(self._times) == _PAIRS:
            names = ("processor", "converting", "passed")
            measured = dict(zip(names, np.median(self._times, axis=0).tolist(), strict=True))
            measured["size"] = sum(map(len, self._buffers))
            self.log.info("RESULT %s", json.dumps(measured))
            self.finish("measured")


class ImageReader(Component):
    """Subscribes to all topics in another process: unread messages are not even encoded."""

    left_image: In[Image] = In(qos=SENSOR.with_depth(2))
    right_image: In[Image] = In(qos=SENSOR.with_depth(2))
    left_info: In[CameraInfo] = In(qos=SENSOR.with_depth(2))
    right_info: In[CameraInfo] = In(qos=SENSOR.with_depth(2))

    @on("right_image")
    def read(self, _: Image) -> None:
        """Receive the image."""


def measure() -> list[Metric]:
    """Return all metrics."""
    return [_metric(name) for name in ("GREY", "YUYV", "MJPG")]


def _metric(pixel_format: str) -> Metric:
    camera: Mapping[str, object] = {
        "plugin": f"{_HERE}:FedCamera",
        "parameters": {"device": "/dev/null", "format": pixel_format},
        "restart": "transient",
        "significant": True,
    }
    output = run_deployment({"reader": {"plugin": f"{_HERE}:ImageReader"}, "camera": camera}, 60)
    [measured] = results(output)
    return Metric(
        f"pair of {_WIDTH} x {_HEIGHT}, {pixel_format}: converted and published",
        1e3 * measured["processor"],
        "ms",
        at_most=_LIMIT_MS,
        note=f"of one core, {1e3 * measured['converting']:.2f} of it converting "
        f"{measured['size'] / 1000:.0f} kB; {1e3 * measured['passed']:.2f} ms passed",
    )


def _buffer(pixel_format: str, seed: int) -> bytes:
    """Return an image with edges and noise, as a camera's buffer."""
    random = np.random.default_rng(seed)
    coarse = random.integers(0, 256, (_HEIGHT // 16, _WIDTH // 16), np.uint8)
    large = cv2.resize(coarse, (_WIDTH, _HEIGHT), interpolation=cv2.INTER_LINEAR)
    noise = random.integers(-6, 7, large.shape)
    gray = np.clip(large + noise, 0, 255).astype(np.uint8)
    if pixel_format == "GREY":
        return bytes(gray)
    if pixel_format == "YUYV":
        return bytes(np.dstack((gray, np.full_like(gray, 128))))
    colors = np.dstack((gray, gray, gray))
    return bytes(
        simplejpeg.encode_jpeg(colors, quality=90, colorspace="RGB", colorsubsampling="422")
    )
