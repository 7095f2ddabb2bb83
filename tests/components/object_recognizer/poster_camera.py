"""A stereo camera in front of a poster, for deployments in real processes."""

from dataclasses import replace

import numpy as np
from pydantic import Field

from cairn import SECOND, SENSOR, Component, Config, Out, every, from_ns
from cairn.schemas.sensor_msgs import CameraInfo, Image
from tests.components.object_recognizer.scenes import Thing, info, message, pair


class PosterCamera(Component):
    """Publishes the same picture with different noise, five times a second."""

    left_image: Out[Image] = Out(qos=SENSOR.with_depth(2))
    right_image: Out[Image] = Out(qos=SENSOR.with_depth(2))
    left_info: Out[CameraInfo] = Out(qos=SENSOR.with_depth(2))
    right_info: Out[CameraInfo] = Out(qos=SENSOR.with_depth(2))

    def on_configure(self) -> None:
        """Render the picture once."""
        self._pair = pair([Thing(1, 0.0, 1.5)])

    @every(hz=5)
    def publish_pair(self) -> None:
        """Publish a pair of images."""
        now = self.clock.now()
        for port, one in ((self.left_info, info()), (self.right_info, info(right=True))):
            port.publish(replace(one, header=replace(one.header, stamp=from_ns(now))))
        for out, gray in zip((self.left_image, self.right_image), self._pair, strict=True):
            noise = self.random.integers(0, 3, gray.shape, np.uint8)
            out.publish(message(np.minimum(gray, 252) + noise, now / SECOND))


class EndingConfig(Config):
    """Duration of a run."""

    after_s: int = Field(3, ge=1, description="Duration [s].")


class Ending(Component):
    """Ends the run."""

    config: EndingConfig

    def on_activate(self) -> None:
        """Schedule the end."""
        end = self.clock.now() + self.config.after_s * SECOND
        self.schedule(end, lambda: self.finish("the time is up"))
