"""One camera: kept open and streaming despite faults of its device, read image by image."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing, suppress
from functools import partial
from pathlib import Path

from cairn import RateLimitedLog
from cairn.components.v4l2_camera.camera_names import find_camera
from cairn.components.v4l2_camera.config import CameraSettings
from cairn.components.v4l2_camera.controls import CameraControl, ControlRejected, assign_controls
from cairn.components.v4l2_camera.decoding import Gray, InvalidImageError, ShortImageError
from cairn.components.v4l2_camera.device import FilledBuffer, VideoDevice, VideoStream
from cairn.components.v4l2_camera.format_negotiation import CaptureFormat, best_format
from cairn.components.v4l2_camera.frames import (
    FrameCounts,
    SequenceCounter,
    is_plausible,
)
from cairn.components.v4l2_camera.pairing import StampedImage
from cairn.driver.device_clock import ahead_of_monotonic
from cairn.driver.diagnostics import RateWindow
from cairn.driver.errors import DeviceError, LinkLost

_POLL_S = 0.1  # how long the thread waits for an image before it checks `stopping`
_FRUITLESS_RESTARTS = 3  # of a stream without any image; then the device is opened again
_SILENT_PERIODS = 4.0

_Values = list[tuple[CameraControl, int]]


class VideoCamera:
    """A camera that `serve` reads, on the driver's thread for it, until it is stopped.

    It stays open in between: `open` and `close` frame its use. Whatever the device does, `serve`
    restarts its stream or raises `DeviceError`, and may then be called again.
    """

    def __init__(
        self,
        settings: CameraSettings,
        controls: Mapping[str, int],
        accept: Callable[[CaptureFormat], None],
        on_image: Callable[[StampedImage], None],
        log: logging.Logger,
    ) -> None:
        """`accept` raises `DeviceError` for a camera that sends unusable images."""
        self._settings = settings
        self._requested = dict(controls)
        self._accept = accept
        self._on_image = on_image
        self._log = log
        self._warnings = RateLimitedLog(log)
        self._device: VideoDevice | None = None
        self._controls: dict[str, CameraControl] = {}
        self._device_lock = threading.Lock()  # controls are set by another thread
        self._rate = RateWindow()
        self._rate_lock = threading.Lock()  # others read the rate while images arrive
        self.capture_format: CaptureFormat | None = None
        self.identity = settings.device
        self.node = Path(settings.device)
        self.counts = FrameCounts()
        self.latency_s = 0.0
        self.stamps_at_start = False
        self.is_streaming = False

    def open(self) -> CaptureFormat:
        """Open the device and set format and controls; raises `DeviceError` if that fails."""
        with self._device_lock, ExitStack() as undo:
            device = VideoDevice(find_camera(self._settings.device))
            undo.callback(device.close)
            capture_format = self._prepare(device)
            undo.pop_all()
            self._device = device
            self.node = device.path.resolve()
            self.identity = f"{device.card} {device.bus}"
            return capture_format

    def close(self) -> None:
        """Close the device; may be called again."""
        with self._device_lock:
            if self._device is not None:
                self._device.close()
                self._device = None

    def set_controls(self, requested: Mapping[str, int]) -> Callable[[], None]:
        """Set controls, all or none; if the device is away, once it is back.

        Returns the function that sets them back. Raises `ControlRejected` with the camera's bounds,
        if they are known already, or `DeviceError` if it fails.
        """
        former: _Values = []
        with self._device_lock:
            try:
                if self.capture_format is not None:
                    assign_controls(self._controls, requested)
                if self._device is not None:
                    former = self._set(self._device, requested)
            except ControlRejected as error:
                raise ControlRejected(f"{self._settings.device}: {error}") from error
            except LinkLost:  # not noticed yet by its thread, which sets controls when it is back
                pass
            undo = partial(self._undo, self._requested, former)
            self._requested = dict(requested)
        return undo

    def rate(self) -> float:
        """Return the present rate of images [1/s]."""
        with self._rate_lock:
            return self._rate.hz(time.monotonic())

    def serve(self, stopping: threading.Event) -> None:
        """Read images until `stopping` is set; raises `DeviceError` if the device fails."""
        try:
            device = self._ready_device()
            with closing(VideoStream(device, self._settings.buffers)) as stream:
                self._keep_streaming(stream, stopping)
        except DeviceError:
            self.close()
            raise
        finally:
            self.is_streaming = False
            with self._rate_lock:
                self._rate.restart()

    def _undo(self, requested: dict[str, int], former: _Values) -> None:
        with self._device_lock:
            self._requested = requested
            if self._device is not None:
                _set_back(self._device, former)

    def _ready_device(self) -> VideoDevice:
        """Return the device, open and set up."""
        if self._device is None:
            self.open()
            self.counts.reopened += 1
        else:  # another program may have used it in between
            with self._device_lock:
                self._prepare(self._device)
        assert self._device is not None  # it is open now
        return self._device

    def _prepare(self, device: VideoDevice) -> CaptureFormat:
        """Set format and controls."""
        capture_format = self._negotiate(device)
        self._accept(capture_format)
        self._controls = device.controls()
        try:
            self._set(device, self._requested)
        except ControlRejected as error:
            raise DeviceError(f"{device.path} ({device.card}): {error}") from error
        self.capture_format = capture_format
        return capture_format

    def _negotiate(self, device: VideoDevice) -> CaptureFormat:
        request = self._settings
        offers = {name: device.sizes(name) for name in device.formats() if name in request.formats}
        size = request.width, request.height
        chosen = best_format(offers, request.formats, size, request.rate)
        if chosen is None:
            raise DeviceError(
                f"{device.path} ({device.card}) offers {', '.join(device.formats())}, but format "
                f"is {' or '.join(request.formats)}; choose another format or camera"
            )
        return device.set_format(chosen, *size, request.rate)

    def _set(self, device: VideoDevice, requested: Mapping[str, int]) -> _Values:
        """Set controls, and return their former values; if one fails, the others are set back.

        A control that the camera sets automatically is left out: cameras refuse to set it.
        """
        done: _Values = []
        try:
            for control, value in assign_controls(self._controls, requested):
                if device.is_inactive(control):
                    self._log.warning(
                        "%s: %s is set automatically by the camera; %d is set once that is off",
                        self._settings.device, control.name, value,
                    )  # fmt: skip
                    continue
                before = device.control(control)
                device.set_control(control, value)
                done.append((control, before))
        except DeviceError:
            _set_back(device, done)
            raise
        return done

    def _keep_streaming(self, stream: VideoStream, stopping: threading.Event) -> None:
        """Stream; restart after an error, unless several restarts brought no image."""
        fruitless = 0
        while not stopping.is_set():
            before = self.counts.images
            try:
                stream.start()
                self._read(stream, stopping)
            except LinkLost:
                raise
            except DeviceError as error:
                fruitless = fruitless + 1 if self.counts.images == before else 1
                if fruitless > _FRUITLESS_RESTARTS:
                    raise
                self.counts.restarts += 1
                self.is_streaming = False
                self._warnings.warn("stream", f"{error}; the stream is restarted")
            stream.stop()

    def _read(self, stream: VideoStream, stopping: threading.Event) -> None:
        assert self.capture_format is not None  # or there is no stream
        rate = self.capture_format.rate
        silence_s = max(self._settings.silence_s, _SILENT_PERIODS / rate if rate else 0.0)
        sequence = SequenceCounter()
        last, count = time.monotonic(), self.counts.images
        while not stopping.is_set():
            buffers = stream.newest(_POLL_S)
            now = time.monotonic()
            if buffers:
                self._process(buffers, sequence)
            if self.counts.images > count:
                last, count = now, self.counts.images
            elif now - last > silence_s:  # silence, or damaged images only
                raise DeviceError(
                    f"{self._settings.device}: no image arrived for {silence_s:.3g} s"
                )

    def _process(self, buffers: list[FilledBuffer], sequence: SequenceCounter) -> None:
        arrived, offset = time.monotonic_ns(), ahead_of_monotonic(time.time_ns)
        counts = self.counts
        newest: FilledBuffer | None = None
        for buffer in buffers:
            counts.lost += sequence.lost_before(buffer.sequence)
            if buffer.is_damaged:
                counts.marked += 1
            elif buffer.data is None:
                counts.dropped += 1
            else:
                newest = buffer
        gray = None if newest is None else self._decode(newest.data or b"")
        if newest is None or gray is None:
            return
        captured = newest.captured
        if captured is None or not is_plausible(captured, arrived):
            captured = arrived
            counts.unstamped += 1
        # An image cannot be captured after it arrived.
        stamp = min(captured, arrived)
        self.latency_s = 1e-9 * (arrived - stamp)
        self.stamps_at_start = newest.at_start
        with self._rate_lock:
            self._rate.note(1e-9 * arrived)
        if not self.is_streaming:
            self.is_streaming = True
            self._warnings.resolved("stream", f"{self._settings.device}: images arrive again")
        counts.images += 1
        self._on_image(StampedImage(gray, captured, stamp + offset))

    def _decode(self, data: bytes) -> Gray | None:
        assert self.capture_format is not None  # or there is no stream
        try:
            return self.capture_format.layout.decode(data)
        except InvalidImageError as error:
            short = isinstance(error, ShortImageError)
            if short:
                self.counts.short += 1
            else:
                self.counts.damaged += 1
            fault = "too short" if short else "damaged"
            self._warnings.warn(
                fault, f"{self._settings.device}: dropped an image that is {fault}: {error}"
            )
            return None


def _set_back(device: VideoDevice, values: _Values) -> None:
    for control, value in reversed(values):
        with suppress(DeviceError):  # the failure that made this necessary is reported
            device.set_control(control, value)
