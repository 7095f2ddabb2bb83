"""One camera: kept open and streaming whatever becomes of its device, read picture by picture."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from cairn import RateLimitedLog
from cairn.components.v4l2_camera.controls import Control, ControlRefused, assigned
from cairn.components.v4l2_camera.counts import Counts
from cairn.components.v4l2_camera.device import Setup, VideoDevice
from cairn.components.v4l2_camera.names import find_camera
from cairn.components.v4l2_camera.offers import best_format
from cairn.components.v4l2_camera.pairing import Picture
from cairn.components.v4l2_camera.pixels import Gray, NoPicture, ShortPicture
from cairn.components.v4l2_camera.stamps import Sequence, is_likely, system_offset
from cairn.components.v4l2_camera.stream import Capture, Stream
from cairn.driver.diagnostics import RateWindow
from cairn.driver.errors import DeviceError, LinkLost

# How long the thread waits for a picture before it looks whether it is to stop [s].
_LOOK_S = 0.1
# So many restarts of a stream without any picture: the device is opened anew.
_RESTARTS = 3
_PERIODS_OF_SILENCE = 4.0

_Values = list[tuple[Control, int]]


@dataclass(frozen=True)
class CameraSettings:
    """Which camera, and what is asked of it: size [px] of its pictures, rate [1/s], formats.

    Of the formats the first suits best. `silence_s` [s] is how long none may come until the stream
    is started anew.
    """

    device: str
    formats: tuple[str, ...]
    width: int
    height: int
    rate: float
    buffers: int
    silence_s: float


class Camera:
    """A camera that `converse` reads, on the driver's thread for it, until it is told to stop.

    It stays open between: `open` and `close` frame its use. Whatever the device does, `converse`
    begins anew with it or raises `DeviceError`, and may then be called again.
    """

    def __init__(
        self,
        settings: CameraSettings,
        controls: Mapping[str, int],
        accept: Callable[[Setup], None],
        on_picture: Callable[[Picture], None],
        log: logging.Logger,
    ) -> None:
        """`accept` raises `DeviceError` for a camera that does not give what is needed."""
        self._settings = settings
        self._wanted = dict(controls)
        self._accept = accept
        self._on_picture = on_picture
        self._log = log
        self._warnings = RateLimitedLog(log)
        self._device: VideoDevice | None = None
        self._panel: dict[str, Control] = {}
        # Whoever adjusts the camera must not meet one that is being closed.
        self._opening = threading.Lock()
        self._rate = RateWindow()
        self._rating = threading.Lock()  # others ask for the rate while pictures come
        self.setup: Setup | None = None
        self.identity = settings.device
        self.node = Path(settings.device)
        self.counts = Counts()
        self.latency_s = 0.0
        self.stamps_begin = False
        self.is_streaming = False

    def open(self) -> Setup:
        """Open and set up the device, and its controls; raises `DeviceError` if that fails."""
        with self._opening, ExitStack() as undo:
            device = VideoDevice(find_camera(self._settings.device))
            undo.callback(device.close)
            setup = self._prepare(device)
            undo.pop_all()
            self._device = device
            self.node = device.path.resolve()
            self.identity = f"{device.card} {device.bus}"
            return setup

    def close(self) -> None:
        """Let go of the device; may be called again."""
        with self._opening:
            if self._device is not None:
                self._device.close()
                self._device = None

    def adjust(self, wanted: Mapping[str, int]) -> Callable[[], None]:
        """Set controls, all or none; while the device is away, once it is back.

        Gives what sets them back. Raises `ControlRefused` with the camera's bounds, if they are
        known already, or `DeviceError` if it fails.
        """
        former: _Values = []
        with self._opening:
            try:
                if self.setup is not None:
                    assigned(self._panel, wanted)
                if self._device is not None:
                    former = self._set(self._device, wanted)
            except ControlRefused as error:
                raise ControlRefused(f"{self._settings.device}: {error}") from error
            except LinkLost:  # its thread has not noticed yet; controls are set when it is back
                pass
            undo = partial(self._undo, self._wanted, former)
            self._wanted = dict(wanted)
        return undo

    def rate(self) -> float:
        """Pictures a second now."""
        with self._rating:
            return self._rate.hz(time.monotonic())

    def converse(self, stopping: threading.Event) -> None:
        """Read pictures until `stopping` is set; raises `DeviceError` if the device fails."""
        try:
            device = self._ready()
            with closing(Stream(device, self._settings.buffers)) as stream:
                self._keep_streaming(stream, stopping)
        except DeviceError:
            self.close()
            raise
        finally:
            self.is_streaming = False
            with self._rating:
                self._rate.restart()

    def _undo(self, wanted: dict[str, int], former: _Values) -> None:
        with self._opening:
            self._wanted = wanted
            if self._device is not None:
                _set_back(self._device, former)

    def _ready(self) -> VideoDevice:
        """The device, open and set up."""
        if self._device is None:
            self.open()
            self.counts.returns += 1
        else:  # another program may have used it in between
            with self._opening:
                self._prepare(self._device)
        assert self._device is not None  # it is open now
        return self._device

    def _prepare(self, device: VideoDevice) -> Setup:
        """Set up pictures and controls."""
        setup = self._agreed(device)
        self._accept(setup)
        self._panel = device.controls()
        try:
            self._set(device, self._wanted)
        except ControlRefused as error:
            raise DeviceError(f"{device.path} ({device.card}): {error}") from error
        self.setup = setup
        return setup

    def _agreed(self, device: VideoDevice) -> Setup:
        wish = self._settings
        offers = {name: device.sizes(name) for name in device.formats() if name in wish.formats}
        chosen = best_format(offers, wish.formats, (wish.width, wish.height), wish.rate)
        if chosen is None:
            raise DeviceError(
                f"{device.path} ({device.card}) gives {', '.join(device.formats())}, but format is "
                f"{' or '.join(wish.formats)}: choose another format or camera"
            )
        return device.set_up(chosen, wish.width, wish.height, wish.rate)

    def _set(self, device: VideoDevice, wanted: Mapping[str, int]) -> _Values:
        """Set controls; if one fails, those before it are set back. Gives what they were.

        What something automatic holds is left to it: cameras refuse to set it.
        """
        done: _Values = []
        try:
            for control, value in assigned(self._panel, wanted):
                if device.is_held(control):
                    self._log.warning(
                        "%s: %s is held by something automatic: %d is set once that is off",
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

    def _keep_streaming(self, stream: Stream, stopping: threading.Event) -> None:
        """Stream; after an error start anew, unless that helped nothing several times."""
        fruitless = 0
        while not stopping.is_set():
            before = self.counts.pictures
            try:
                stream.start()
                self._read(stream, stopping)
            except LinkLost:
                raise
            except DeviceError as error:
                fruitless = fruitless + 1 if self.counts.pictures == before else 1
                if fruitless > _RESTARTS:
                    raise
                self.counts.restarts += 1
                self.is_streaming = False
                self._warnings.warn("stream", f"{error}; the stream is started anew")
            stream.stop()

    def _read(self, stream: Stream, stopping: threading.Event) -> None:
        assert self.setup is not None  # or there is no stream
        nominal = self.setup.rate
        silence_s = max(self._settings.silence_s, _PERIODS_OF_SILENCE / nominal if nominal else 0.0)
        sequence = Sequence()
        last, count = time.monotonic(), self.counts.pictures
        while not stopping.is_set():
            captures = stream.newest(_LOOK_S)
            now = time.monotonic()
            if captures:
                self._take(captures, sequence)
            if self.counts.pictures > count:
                last, count = now, self.counts.pictures
            elif now - last > silence_s:  # or nothing but damaged ones
                raise DeviceError(f"{self._settings.device}: no picture came for {silence_s:.3g} s")

    def _take(self, captures: list[Capture], sequence: Sequence) -> None:
        arrived, offset = time.monotonic_ns(), system_offset()
        counts = self.counts
        newest: Capture | None = None
        for capture in captures:
            counts.lost += sequence.lost_before(capture.sequence)
            if capture.is_damaged:
                counts.marked += 1
            elif capture.data is None:
                counts.skipped += 1
            else:
                newest = capture
        gray = None if newest is None else self._developed(newest.data or b"")
        if newest is None or gray is None:
            return
        taken = newest.taken
        if taken is None or not is_likely(taken, arrived):
            taken = arrived
            counts.unstamped += 1
        # A picture was not taken after it came.
        stamp = min(taken, arrived)
        self.latency_s = 1e-9 * (arrived - stamp)
        self.stamps_begin = newest.at_start
        counts.pictures += 1
        with self._rating:
            self._rate.note(1e-9 * arrived)
        if not self.is_streaming:
            self.is_streaming = True
            self._warnings.resolved("stream", f"{self._settings.device}: pictures come again")
        self._on_picture(Picture(gray, taken, stamp + offset))

    def _developed(self, data: bytes) -> Gray | None:
        assert self.setup is not None  # or there is no stream
        try:
            return self.setup.layout.gray(data)
        except NoPicture as error:
            short = isinstance(error, ShortPicture)
            if short:
                self.counts.short += 1
            else:
                self.counts.damaged += 1
            what = "is too short" if short else "is damaged"
            self._warnings.warn(what, f"{self._settings.device}: a picture {what}: {error}")
            return None


def _set_back(device: VideoDevice, values: _Values) -> None:
    for control, value in reversed(values):
        with suppress(DeviceError):  # what made this necessary is the failure to tell
            device.set_control(control, value)
