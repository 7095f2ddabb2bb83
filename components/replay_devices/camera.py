"""Replay component for a recorded camera or stereo camera."""

from __future__ import annotations

from dataclasses import replace

from pydantic import Field

from cairn import SENSOR, CairnError, Out, RateLimitedLog, ReadPath, from_ns
from cairn.components.replay_devices.components import ReplayComponent
from cairn.components.replay_devices.config import RecordingConfig
from cairn.components.replay_devices.recording import ImageStream
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.schemas.std_msgs import Header
from cairn.vision.camera_file import read_camera
from cairn.vision.images import gray_message
from cairn.vision.optical_frames import LEFT_FRAME, RIGHT_FRAME
from cairn.vision.stereo import StereoRig

_FRAMES = (LEFT_FRAME, RIGHT_FRAME)


class ReplayCameraConfig(RecordingConfig):
    """Which images, and the calibrations of their cameras."""

    side_by_side: bool = Field(
        False, description="Each image holds those of the left and the right camera side by side."
    )
    left_calibration: ReadPath | None = Field(
        None, description="camera_info YAML file of the left camera, or of the only one."
    )
    right_calibration: ReadPath | None = Field(
        None, description="camera_info YAML file of the right camera."
    )


class ReplayCamera(ReplayComponent):
    """Replays the images of a camera, or of a stereo camera in pairs, each at its recorded time.

    Images are published gray and not rectified, after their calibrations.
    """

    config: ReplayCameraConfig
    left_image: Out[Image] = Out(qos=SENSOR.with_depth(2))
    right_image: Out[Image] = Out(qos=SENSOR.with_depth(2))
    left_info: Out[CameraInfo] = Out(qos=SENSOR.with_depth(2))
    right_info: Out[CameraInfo] = Out(qos=SENSOR.with_depth(2))

    def on_configure(self) -> None:
        """Read times and sizes of the images, and the calibrations."""
        recording = self.config.open()
        images = recording.images()
        if images is None:
            self.replay_nothing("images of one camera or of a stereo camera")
            for note in recording.notes():
                self.log.warning("%s: %s", self.config.recording, note)
            return
        self._images = images
        self._warnings = RateLimitedLog(self.log)
        self._infos = self._calibrations(images)
        self.select(recording, images.stamps)

    def publish(self, index: int) -> None:
        """Publish the images with an index."""
        try:
            views = self._images.load(index)
        except CairnError as error:
            # A real camera also loses an image sometimes.
            self._warnings.warn("image", f"left out image {index + 1}: {error}")
            return
        if self.config.side_by_side:
            middle = views[0].shape[1] // 2
            views = (views[0][:, :middle], views[0][:, middle:])
        stamp = from_ns(self._images.stamps[index])
        headers = [Header(stamp=stamp, frame_id=frame) for frame in _FRAMES]
        infos = (self.left_info, self.right_info)
        for info, known, header in zip(infos, self._infos, headers, strict=False):
            info.publish(replace(known, header=header))
        images = (self.left_image, self.right_image)
        for image, pixels, header in zip(images, views, headers, strict=False):
            image.publish(gray_message(pixels, header))

    def _calibrations(self, images: ImageStream) -> list[CameraInfo]:
        """Return the calibration of each camera, from its file or recorded.

        Without one, it has only the size, as in ROS.
        """
        width, height = images.size
        cameras = images.cameras
        if self.config.side_by_side:
            if cameras == 2 or width % 2:
                raise CairnError(
                    f"{self.config.recording}: side_by_side = true, but there "
                    + ("are images of both cameras" if cameras == 2 else f"images are {width} wide")
                    + "; set side_by_side to false"
                )
            width, cameras = width // 2, 2
        files = (self.config.left_calibration, self.config.right_calibration)
        if cameras == 1 and files[1] is not None:
            raise CairnError(
                f"{self.config.recording} holds images of one camera only, but right_calibration = "
                f"{files[1]}; leave it out, or set side_by_side to true"
            )
        infos = []
        recorded = () if self.config.side_by_side else images.infos
        for number, (file, frame) in enumerate(zip(files[:cameras], _FRAMES, strict=False)):
            info = recorded[number] if number < len(recorded) else None
            if file is not None:
                info = read_camera(file, frame)
            if info is None or not info.k.any():
                self.log.warning("%s has no calibration, so no ranges can be measured", frame)
                info = CameraInfo(width=width, height=height)
            if (info.width, info.height) != (width, height):
                source = file or f"the recorded calibration of {frame}"
                raise CairnError(
                    f"{source} is for images of {info.width} x {info.height} pixels, but those of "
                    f"{self.config.recording} are {width} x {height}; calibrate with such images"
                )
            infos.append(info)
        if cameras == 2 and all(info.k.any() for info in infos):
            StereoRig.of(*infos)
        return infos
