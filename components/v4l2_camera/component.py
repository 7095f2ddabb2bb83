"""The driver of cameras and stereo cameras behind V4L2."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path

from cairn import (
    LATCHED,
    SECOND,
    SENSOR,
    CairnError,
    Component,
    Config,
    Out,
    ParameterRejected,
    every,
    from_ns,
)
from cairn.components.v4l2_camera.camera import VideoCamera
from cairn.components.v4l2_camera.config import LIVE, V4l2StereoCameraConfig
from cairn.components.v4l2_camera.controls import ControlRejected
from cairn.components.v4l2_camera.decoding import Gray, split_side_by_side
from cairn.components.v4l2_camera.format_negotiation import FormatCheck
from cairn.components.v4l2_camera.health import CameraMonitor, PairMonitor
from cairn.components.v4l2_camera.pairing import UNPAIRED_KEPT, StampedImage, StereoPairer
from cairn.driver.device_thread import DeviceThread
from cairn.driver.errors import DeviceError
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage
from cairn.vision.camera_file import read_camera
from cairn.vision.images import gray_message
from cairn.vision.optical_frames import LEFT_FRAME, RIGHT_FRAME, optical_transforms
from cairn.vision.stereo import StereoRig

_FRAMES = (LEFT_FRAME, RIGHT_FRAME)
_SIDES = ("left", "right")


class V4l2StereoCamera(Component):
    """A camera behind V4L2, a side-by-side stereo camera, or two cameras as a stereo pair.

    It publishes the newest images, gray and not rectified. Both images of a pair have the stamp of
    the left one: its capture time by the kernel. It waits for a camera that is unplugged.

    `diagnostics` reports, in addition to what all drivers report:

    - no usable image for `silence_s`, at least 4 periods (error): the driver restarts the stream,
      and after three failures opens the device again;
    - damaged or incomplete images: `marked`, `short`, `damaged`; a damaged JPEG that still decodes
      to its end is not detected;
    - gaps in the image numbers: `lost`; images that this computer was too slow for: `dropped`;
    - a missing camera (error): without the right one, left images are published;
    - another camera that returns, with other formats, sizes or controls (error): no images;
    - a rate a tenth below the agreed one (warning): in the dark, set `exposure_dynamic_framerate:
      0`;
    - images whose kernel time is not usable: `unstamped`; they have the arrival time.
    """

    live_parameters = frozenset(LIVE)
    clock_source = "device"

    published_frames = frozenset({LEFT_FRAME, RIGHT_FRAME})
    config: V4l2StereoCameraConfig

    left_image: Out[Image] = Out(qos=SENSOR.with_depth(2))
    right_image: Out[Image] = Out(qos=SENSOR.with_depth(2))
    left_info: Out[CameraInfo] = Out(qos=SENSOR.with_depth(2))
    right_info: Out[CameraInfo] = Out(qos=SENSOR.with_depth(2))
    tf_static: Out[TFMessage] = Out(qos=LATCHED)
    diagnostics: Out[DiagnosticArray]

    _cameras: tuple[VideoCamera, ...] = ()
    _threads: tuple[DeviceThread, ...] = ()

    def on_configure(self) -> None:
        """Open the cameras and negotiate their formats.

        After a restart a camera may be missing: then its thread waits for it, once active.
        """
        config = self.config
        try:
            count = 2 if config.is_stereo else 1
            files = (config.left_calibration, config.right_calibration)[:count]
            self._infos, self._baseline = _read_calibrations(files, _FRAMES[:count], self.log)
            self._format_check = FormatCheck(config, self._infos, self.log)
            self._cameras = tuple(
                VideoCamera(
                    config.settings_of(device), config.controls.values(),
                    partial(self._format_check.accept, side), partial(self._on_image, side),
                    self.log,
                )
                for side, device in enumerate(config.devices())
            )  # fmt: skip
            self._open()
        except CairnError as error:
            self._close()
            raise CairnError(f"{self.name}: {error}") from error

    def on_activate(self) -> None:
        """Publish the optical frames of the cameras, and start their streams."""
        header = Header(stamp=from_ns(self.clock.now()), frame_id=self.config.mount_frame)
        self.tf_static.publish(TFMessage(transforms=optical_transforms(header, self._baseline)))
        self._newest = [deque[StampedImage](maxlen=1) for _ in self._cameras]
        # The stamps of the last left images that were published without a right one.
        self._alone = deque[int](maxlen=UNPAIRED_KEPT + 1)
        self._device_errors = [""] * len(self._cameras)
        self._pairer = StereoPairer(self._format_check.half_period())
        self._pair_monitor = PairMonitor(self.name, self._pairer)
        self._monitors = [
            CameraMonitor(f"{self.name}: {side} camera" if self._has_two else self.name, camera)
            for side, camera in zip(_SIDES, self._cameras, strict=False)
        ]
        self._threads = tuple(
            DeviceThread(
                f"{self.name} {side}",
                camera.serve,
                log=self.log,
                on_device_error=partial(self._on_device_error, index),
                on_failure=self._on_failure,
            )
            for index, (side, camera) in enumerate(zip(_SIDES, self._cameras, strict=False))
        )
        for thread in self._threads:
            thread.start()

    def on_deactivate(self) -> None:
        """Stop the streams; the cameras stay open."""
        self._stop()

    def on_cleanup(self) -> None:
        """Close the cameras."""
        self._close()

    def on_error(self, _: Exception) -> bool:
        """Close the cameras, for the component that is started instead."""
        try:
            self._stop()
        finally:
            self._close()
        return False

    def on_parameters(self, new: Config) -> None:
        """Set controls of the cameras."""
        assert isinstance(new, V4l2StereoCameraConfig)
        with ExitStack() as undo:
            try:
                for camera in self._cameras:
                    undo.callback(camera.set_controls(new.controls.values()))
            except (ControlRejected, DeviceError) as error:
                raise ParameterRejected(str(error)) from error
            undo.pop_all()

    @every(hz=1)
    def publish_health(self) -> None:
        """Publish the health of the cameras and of their pairs."""
        now = self.clock.now()
        reports = [
            monitor.report(now, device_error)
            for monitor, device_error in zip(self._monitors, self._device_errors, strict=True)
        ]
        if self._has_two:
            reports.append(self._pair_monitor.report(now))
        statuses = tuple(status for report in reports for status in report.status)
        self.diagnostics.publish(replace(reports[0], status=statuses))

    @property
    def _has_two(self) -> bool:
        return len(self._cameras) == 2

    def _open(self) -> None:
        for camera in self._cameras:
            try:
                camera.open()
            except DeviceError as error:
                if not self.restarts:
                    raise
                self.log.warning("waiting for a camera: %s", error)
        if self._has_two and self._cameras[0].node == self._cameras[1].node:
            raise CairnError(
                f"device and right_device are both {self._cameras[0].node}; name two cameras, or "
                "set side_by_side to true for one that sends both images in one"
            )

    def _on_image(self, side: int, image: StampedImage) -> None:
        """Queue an image on the camera's thread; it replaces one that was not published yet."""
        self._threads[side].report_working(f"{self.config.devices()[side]}: images arrive again")
        self._device_errors[side] = ""
        if self._newest[side]:
            self._cameras[side].counts.dropped += 1
        self._newest[side].append(image)
        self.post(partial(self._publish_newest, side))

    def _publish_newest(self, side: int) -> None:
        try:
            image = self._newest[side].popleft()
        except IndexError:  # two had arrived, and the newer one was published
            return
        if not self._has_two:
            self._publish(image.stamp, self._views(image.gray))
            return
        self._pairer.tolerance = self._format_check.half_period()  # cameras may have changed
        pair = self._pairer.add(side, image)
        if pair is not None:
            left, right = pair
            if left.stamp not in self._alone:  # otherwise it was published
                self._publish(left.stamp, (left.gray, right.gray))
        elif side == 0 and not self._cameras[1].is_streaming:
            # With one camera objects are ranged by size: better than nothing until both are back.
            self._alone.append(image.stamp)
            self._publish(image.stamp, (image.gray,))

    def _views(self, gray: Gray) -> tuple[Gray, ...]:
        if not self.config.side_by_side:
            return (gray,)
        left, right = split_side_by_side(gray)
        return (right, left) if self.config.right_comes_first else (left, right)

    def _publish(self, stamp: int, views: tuple[Gray, ...]) -> None:
        time = from_ns(stamp - round(self.config.stamp_delay_s * SECOND))
        headers = [Header(stamp=time, frame_id=frame) for frame in _FRAMES[: len(views)]]
        infos, images = (self.left_info, self.right_info), (self.left_image, self.right_image)
        for port, info, view, header in zip(infos, self._infos, views, headers, strict=False):
            height, width = view.shape
            known = CameraInfo(width=width, height=height) if info is None else info
            port.publish(replace(known, header=header))
        for out, view, header in zip(images, views, headers, strict=False):
            out.publish(gray_message(view, header))

    def _on_device_error(self, side: int, error: DeviceError) -> None:
        self._device_errors[side] = str(error)

    def _on_failure(self, error: Exception) -> None:
        self.post(partial(_raise, error))

    def _stop(self) -> None:
        with ExitStack() as stopping:  # all of them, even if one does not end
            for thread in self._threads:
                stopping.callback(thread.stop)
        self._threads = ()

    def _close(self) -> None:
        for camera in self._cameras:
            camera.close()


def _raise(error: Exception) -> None:
    raise error


def _read_calibrations(
    files: Sequence[Path | None], frames: Sequence[str], log: logging.Logger
) -> tuple[list[CameraInfo | None], float | None]:
    """Read the calibration of each camera, and the baseline [m] of two that are calibrated.

    Without a file the calibration is None, and a warning is logged, as no range can be measured.
    Raises `CairnError` for a file that cannot be used.
    """
    infos = [
        None if file is None else read_camera(file, frame)
        for file, frame in zip(files, frames, strict=True)
    ]
    known = [info for info in infos if info is not None]
    for frame, info in zip(frames, infos, strict=True):
        if info is None:
            log.warning("%s has no calibration, so no ranges can be measured", frame)
    if len(known) == 2:
        return infos, StereoRig.of(*known).baseline
    return infos, None
