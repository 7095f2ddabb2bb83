"""The driver of cameras and stereo cameras behind V4L2."""

from __future__ import annotations

from collections import deque
from contextlib import ExitStack
from dataclasses import replace
from functools import partial

import numpy as np

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
from cairn.components.v4l2_camera.agreement import Agreement
from cairn.components.v4l2_camera.calibrations import read_calibrations
from cairn.components.v4l2_camera.camera import Camera
from cairn.components.v4l2_camera.config import LIVE, V4l2StereoCameraConfig
from cairn.components.v4l2_camera.controls import ControlRefused
from cairn.components.v4l2_camera.pairing import Pairing, Picture
from cairn.components.v4l2_camera.pixels import Gray, halves
from cairn.components.v4l2_camera.placing import placed
from cairn.components.v4l2_camera.report import CameraReport, PairReport
from cairn.driver.device_thread import DeviceThread
from cairn.driver.errors import DeviceError
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.sensor_msgs import CameraInfo, Image
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage

_FRAMES = ("left_camera_optical_frame", "right_camera_optical_frame")
_SIDES = ("left", "right")


class V4l2StereoCamera(Component):
    """A camera behind V4L2, a side-by-side stereo camera, or two cameras that make a stereo one.

    Images are gray, as they were taken, and the newest there are. Both of a pair have the stamp of
    the left one: when the kernel says that it was taken. A camera that is unplugged is waited for.
    """

    clock_source = "device"

    config: V4l2StereoCameraConfig

    left_image: Out[Image] = Out(qos=SENSOR.with_depth(2))
    right_image: Out[Image] = Out(qos=SENSOR.with_depth(2))
    left_info: Out[CameraInfo] = Out(qos=SENSOR.with_depth(2))
    right_info: Out[CameraInfo] = Out(qos=SENSOR.with_depth(2))
    tf_static: Out[TFMessage] = Out(qos=LATCHED)
    diagnostics: Out[DiagnosticArray]

    _cameras: tuple[Camera, ...] = ()
    _threads: tuple[DeviceThread, ...] = ()

    def on_configure(self) -> None:
        """Open the cameras and agree with them on their pictures.

        One that was there before may come back: then it is waited for, once active.
        """
        config = self.config
        try:
            count = 2 if config.is_stereo else 1
            files = (config.left_calibration, config.right_calibration)[:count]
            self._infos, self._baseline = read_calibrations(files, _FRAMES[:count], self.log)
            self._agreement = Agreement(config, self._infos, self.log)
            self._cameras = tuple(
                Camera(
                    config.settings_of(device), config.controls.given(),
                    partial(self._agreement.accept, side), partial(self._came, side), self.log,
                )
                for side, device in enumerate(config.devices())
            )  # fmt: skip
            self._open()
        except CairnError as error:
            self._close()
            raise CairnError(f"{self.name}: {error}") from error

    def on_activate(self) -> None:
        """Tell where the cameras sit; let them stream."""
        header = Header(stamp=from_ns(self.clock.now()), frame_id="base_link")
        offsets = (0.0,) if self._baseline is None else (0.0, self._baseline)
        config = self.config
        self.tf_static.publish(
            TFMessage(
                transforms=tuple(
                    placed(header, frame, config.mount, config.z, offset)
                    for frame, offset in zip(_FRAMES, offsets, strict=False)
                )
            )
        )
        self._newest = [deque[Picture](maxlen=1) for _ in self._cameras]
        self._trouble = [""] * len(self._cameras)
        self._pairing = Pairing(self._agreement.half_period())
        self._pair_report = PairReport(self.name, self._pairing)
        self._reports = [
            CameraReport(f"{self.name}: {side} camera" if self._has_two else self.name, camera)
            for side, camera in zip(_SIDES, self._cameras, strict=False)
        ]
        self._threads = tuple(
            DeviceThread(
                f"{self.name} {side}",
                camera.converse,
                log=self.log,
                on_device_error=partial(self._troubled, index),
                on_failure=self._failed,
            )
            for index, (side, camera) in enumerate(zip(_SIDES, self._cameras, strict=False))
        )
        for thread in self._threads:
            thread.start()

    def on_deactivate(self) -> None:
        """Stop streaming; the cameras stay open."""
        self._stop()

    def on_cleanup(self) -> None:
        """Let go of the cameras."""
        self._close()

    def on_error(self, error: Exception) -> bool:  # noqa: ARG002 - it makes no difference
        """Let go of the cameras, for the one that is started in place of this."""
        try:
            self._stop()
        finally:
            self._close()
        return False

    def on_parameters(self, new: Config) -> None:
        """Set controls on the cameras; they stay the cameras that they are."""
        assert isinstance(new, V4l2StereoCameraConfig)
        for name in type(new).model_fields:
            if name not in LIVE and getattr(new, name) != getattr(self.config, name):
                raise ParameterRejected(
                    f"the camera takes {name} when it is configured; {', '.join(LIVE)} may be "
                    "changed while it runs"
                )
        with ExitStack() as undo:
            try:
                for camera in self._cameras:
                    undo.callback(camera.adjust(new.controls.given()))
            except (ControlRefused, DeviceError) as error:
                raise ParameterRejected(str(error)) from error
            undo.pop_all()

    @every(hz=1)
    def tell(self) -> None:
        """Tell how the cameras are."""
        now = self.clock.now()
        told = [
            report.told(now, trouble)
            for report, trouble in zip(self._reports, self._trouble, strict=True)
        ]
        if self._has_two:
            told.append(self._pair_report.told(now))
        statuses = tuple(status for one in told for status in one.status)
        self.diagnostics.publish(replace(told[0], status=statuses))

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
                self.log.warning("%s; it is waited for", error)
        if self._has_two and self._cameras[0].node == self._cameras[1].node:
            raise CairnError(
                f"device and right_device are both {self._cameras[0].node}: name two cameras, or "
                "set side_by_side to true for one that sends both pictures in one"
            )

    def _came(self, side: int, picture: Picture) -> None:
        """On the camera's thread: hand on a picture, in place of one that was not taken yet."""
        self._threads[side].report_working(f"{self.config.devices()[side]}: pictures come again")
        self._trouble[side] = ""
        if self._newest[side]:
            self._cameras[side].counts.skipped += 1
        self._newest[side].append(picture)
        self.post(partial(self._take, side))

    def _take(self, side: int) -> None:
        try:
            picture = self._newest[side].popleft()
        except IndexError:  # two had come, and the newer one was taken
            return
        if not self._has_two:
            self._publish(picture.stamp, self._views(picture.gray))
            return
        self._pairing.within = self._agreement.half_period()  # a camera may have come meanwhile
        pair = self._pairing.add(side, picture)
        if pair is not None:
            left, right = pair
            self._publish(left.stamp, (left.gray, right.gray))
        elif side == 0 and not self._cameras[1].is_streaming:
            # What sees with one eye ranges by size: better than nothing until the other is back.
            self._publish(picture.stamp, (picture.gray,))

    def _views(self, gray: Gray) -> tuple[Gray, ...]:
        if not self.config.side_by_side:
            return (gray,)
        left, right = halves(gray)
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
            out.publish(_message(view, header))

    def _troubled(self, side: int, error: DeviceError) -> None:
        self._trouble[side] = str(error)

    def _failed(self, error: Exception) -> None:
        self.post(partial(_fail, error))

    def _stop(self) -> None:
        with ExitStack() as stopping:  # all of them, even if one does not end
            for thread in self._threads:
                stopping.callback(thread.stop)
        self._threads = ()

    def _close(self) -> None:
        for camera in self._cameras:
            camera.close()


def _message(pixels: Gray, header: Header) -> Image:
    height, width = pixels.shape
    return Image(
        header=header,
        height=height,
        width=width,
        encoding="mono8",
        step=width,
        data=np.ascontiguousarray(pixels).reshape(-1),
    )


def _fail(error: Exception) -> None:
    raise error
