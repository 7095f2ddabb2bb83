"""The driver of a camera or stereo camera that speaks ROS 2 over the bus."""

from __future__ import annotations

from dataclasses import replace

from cairn import (
    LATCHED,
    SENSOR,
    CairnError,
    Component,
    In,
    Out,
    RateLimitedLog,
    every,
    from_ns,
    on,
    to_ns,
)
from cairn.components.ros2_devices.config import Ros2StereoCameraConfig
from cairn.components.ros2_devices.pair_stamps import PairStamps
from cairn.driver.diagnostics import OK
from cairn.driver.ros2_source import Ros2Source, SourceLimits
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.schemas.sensor_msgs.msg import CompressedImage
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage
from cairn.vision.images import Gray, decode, gray_message, gray_of
from cairn.vision.optical_frames import LEFT_FRAME, RIGHT_FRAME, optical_transforms
from cairn.vision.stereo import StereoRig

_FRAMES = (LEFT_FRAME, RIGHT_FRAME)
_SIDES = ("left", "right")


class Ros2StereoCamera(Component):
    """Publishes the images of a camera or stereo camera that ROS 2 nodes drive, in gray.

    The deployment names the nodes' topics, of `source_left_image` and `source_right_image`, or of
    `source_left_compressed` and `source_right_compressed`, and of `source_left_info` and
    `source_right_info`. The images are not rectified. Both of a pair get the stamp of the first
    one, if their own ones differ by at most 10 ms.
    """

    live_parameters = frozenset()
    config: Ros2StereoCameraConfig

    source_left_image: In[Image] = In(qos=SENSOR.with_depth(2), optional=True)
    source_right_image: In[Image] = In(qos=SENSOR.with_depth(2), optional=True)
    source_left_compressed: In[CompressedImage] = In(qos=SENSOR.with_depth(2), optional=True)
    source_right_compressed: In[CompressedImage] = In(qos=SENSOR.with_depth(2), optional=True)
    source_left_info: In[CameraInfo] = In(qos=SENSOR)
    source_right_info: In[CameraInfo] = In(qos=SENSOR, optional=True)
    left_image: Out[Image] = Out(qos=SENSOR.with_depth(2))
    right_image: Out[Image] = Out(qos=SENSOR.with_depth(2))
    left_info: Out[CameraInfo] = Out(qos=SENSOR.with_depth(2))
    right_info: Out[CameraInfo] = Out(qos=SENSOR.with_depth(2))
    tf_static: Out[TFMessage] = Out(qos=LATCHED)
    diagnostics: Out[DiagnosticArray]

    def on_activate(self) -> None:
        """Publish the optical frame of the left camera; wait for images."""
        config = self.config
        limits = SourceLimits(config.rate, config.timeout_s, config.age_s, config.stamp_on_arrival)
        topics = [self.source_left_image.topic, self.source_right_image.topic]
        if config.compressed:
            topics = [self.source_left_compressed.topic, self.source_right_compressed.topic]
        self._sources = [
            Ros2Source(
                self,
                topic,
                f"the {side} camera's image",
                f"no {side} image is published",
                limits,
            )
            for side, topic in zip(_SIDES, topics[: 2 if config.stereo else 1], strict=False)
        ]
        self._warnings = RateLimitedLog(self.log)
        self._stamps = PairStamps()
        self._infos: list[CameraInfo | None] = [None, None]
        self._baseline: float | None = None
        self._publish_frames()

    @on("source_left_info")
    def on_source_left_info(self, info: CameraInfo) -> None:
        """Publish the left camera's calibration."""
        self._on_info(0, info)

    @on("source_right_info")
    def on_source_right_info(self, info: CameraInfo) -> None:
        """Publish the right camera's calibration."""
        self._on_info(1, info)

    @on("source_left_image")
    def on_source_left_image(self, message: Image) -> None:
        """Publish a left image."""
        self._on_image(0, message)

    @on("source_right_image")
    def on_source_right_image(self, message: Image) -> None:
        """Publish a right image."""
        self._on_image(1, message)

    @on("source_left_compressed")
    def on_source_left_compressed(self, message: CompressedImage) -> None:
        """Decode and publish a left image."""
        self._on_image(0, message)

    @on("source_right_compressed")
    def on_source_right_compressed(self, message: CompressedImage) -> None:
        """Decode and publish a right image."""
        self._on_image(1, message)

    @every(hz=1)
    def publish_health(self) -> None:
        """Publish how the images arrive."""
        reports = [source.report((OK, "images arrive"), {}) for source in self._sources]
        statuses = tuple(status for report in reports for status in report.status)
        self.diagnostics.publish(replace(reports[0], status=statuses))

    def _on_image(self, side: int, message: Image | CompressedImage) -> None:
        if side >= len(self._sources) or isinstance(message, Image) is self.config.compressed:
            return  # the port is not used
        source = self._sources[side]
        own = to_ns(message.header.stamp)
        stamp = source.stamp_of(message.header.stamp)
        reason = source.why_untimely(stamp) or source.why_out_of_order(stamp)
        if reason is not None:
            source.reject(reason)
            return
        try:
            pixels = _pixels(message)
        except CairnError as error:
            source.reject(f"{source.topic}: {error}")
            return
        source.accept(stamp)
        time = self._stamps.common(side, own, stamp)
        header = Header(stamp=from_ns(time), frame_id=_FRAMES[side])
        (self.left_image, self.right_image)[side].publish(gray_message(pixels, header))

    def _on_info(self, side: int, info: CameraInfo) -> None:
        stamp = from_ns(self.clock.now()) if self.config.stamp_on_arrival else info.header.stamp
        info = replace(info, header=Header(stamp=stamp, frame_id=_FRAMES[side]))
        (self.left_info, self.right_info)[side].publish(info)
        self._infos[side] = info
        left, right = self._infos
        if left is not None and right is not None and self._baseline is None:
            try:
                self._baseline = StereoRig.of(left, right).baseline
            except CairnError as error:
                self._warnings.warn("pair", f"{self.source_right_info.topic}: {error}")
            else:
                self._warnings.resolved("pair", "left and right camera are a pair")
                self._publish_frames()

    def _publish_frames(self) -> None:
        header = Header(stamp=from_ns(self.clock.now()), frame_id=self.config.mount_frame)
        self.tf_static.publish(TFMessage(transforms=optical_transforms(header, self._baseline)))


def _pixels(message: Image | CompressedImage) -> Gray:
    """Return an image in gray (h, w); `CairnError` if it cannot be decoded."""
    if isinstance(message, Image):
        return gray_of(message)
    return decode(f"an image of format {message.format!r}", message.data.tobytes())
