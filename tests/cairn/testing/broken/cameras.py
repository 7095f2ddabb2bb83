"""A correct driver of a fictitious stereo camera, and drivers with one mistake each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cairn import SENSOR, Component, Out, every, from_ns
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.schemas.std_msgs import Header
from tests.cairn.testing.broken.periods import Periods

WIDTH, HEIGHT = 32, 24
RATE_HZ = 20.0
FOCAL = 30.0
BASELINE = 0.1


class CorrectCamera(Component):
    """Has no mistake."""

    left_info: Out[CameraInfo] = Out(qos=SENSOR.with_depth(2))
    right_info: Out[CameraInfo] = Out(qos=SENSOR.with_depth(2))
    left_image: Out[Image] = Out(qos=SENSOR.with_depth(2))
    right_image: Out[Image] = Out(qos=SENSOR.with_depth(2))

    def on_activate(self) -> None:
        self.turns = Periods(self.clock.now(), RATE_HZ)

    @every(hz=RATE_HZ)
    def publish_pairs(self) -> None:
        for _ in self.turns.completed(self.clock.now()):
            self.take(self.turns.ended)

    def take(self, stamp: int) -> None:
        left, right = self.header(stamp, "left"), self.header(stamp, "right")
        self.left_info.publish(self.info(left, 0.0))
        self.right_info.publish(self.info(right, BASELINE))
        self.left_image.publish(self.image(left))
        self.right_image.publish(self.image(right))

    def header(self, stamp: int, side: str) -> Header:
        return Header(stamp=from_ns(stamp), frame_id=f"{side}_camera_optical_frame")

    def info(self, header: Header, baseline: float) -> CameraInfo:
        k = [FOCAL, 0, WIDTH / 2, 0, FOCAL, HEIGHT / 2, 0, 0, 1]
        p = [FOCAL, 0, WIDTH / 2, -FOCAL * baseline, 0, FOCAL, HEIGHT / 2, 0, 0, 0, 1, 0]
        return CameraInfo(
            header=header,
            width=WIDTH,
            height=HEIGHT,
            distortion_model="plumb_bob",
            d=np.zeros(5),
            k=np.array(k, float),
            r=np.eye(3).ravel(),
            p=np.array(p, float),
        )

    def image(self, header: Header) -> Image:
        pixels = self.random.integers(0, 255, WIDTH * HEIGHT, np.uint8)
        return Image(
            header=header, width=WIDTH, height=HEIGHT, encoding="mono8", step=WIDTH, data=pixels
        )


class StampsDiffer(CorrectCamera):
    """Stamps each image with the time at which it was read."""

    def header(self, stamp: int, side: str) -> Header:
        return super().header(stamp + 1_000_000 * (side == "right"), side)


class SwappedSides(CorrectCamera):
    """Mistakes the left camera for the right one."""

    def info(self, header: Header, baseline: float) -> CameraInfo:
        return super().info(header, BASELINE - baseline)


class SwappedSizes(CorrectCamera):
    """Mistakes rows for columns."""

    def image(self, header: Header) -> Image:
        return replace(super().image(header), width=HEIGHT, height=WIDTH, step=HEIGHT)


class Frozen(CorrectCamera):
    """Sends the same image again and again."""

    def image(self, header: Header) -> Image:
        return replace(super().image(header), data=np.full(WIDTH * HEIGHT, 7, np.uint8))


class WrongEncoding(CorrectCamera):
    """Uses V4L2's name of its encoding."""

    def image(self, header: Header) -> Image:
        return replace(super().image(header), encoding="GREY")


class InfosLate(CorrectCamera):
    """Publishes camera info after its image."""

    def take(self, stamp: int) -> None:
        left, right = self.header(stamp, "left"), self.header(stamp, "right")
        self.left_image.publish(self.image(left))
        self.right_image.publish(self.image(right))

        self.left_info.publish(self.info(left, 0.0))
        self.right_info.publish(self.info(right, BASELINE))
