"""A V4L2 video node: what it offers, its format and controls, and its stream of frames."""

from __future__ import annotations

import ctypes
import errno
import mmap
import os
import select
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

from cairn.components.v4l2_camera import videodev
from cairn.components.v4l2_camera.controls import SETTABLE, STANDARD, CameraControl, plain_name
from cairn.components.v4l2_camera.decoding import ImageLayout
from cairn.components.v4l2_camera.format_negotiation import CaptureFormat, FrameSize
from cairn.driver.errors import DeviceError, LinkLost

# The system call itself, as it does not block other threads: `fcntl.ioctl` keeps the interpreter
# lock, and some requests to a USB camera take seconds if its cable is bad.
_IOCTL: Final = ctypes.CDLL(None, use_errno=True).ioctl
_IOCTL.argtypes = (ctypes.c_int, ctypes.c_ulong, ctypes.c_void_p)

_LONGEST_LIST = 1000  # of sizes and rates: some drivers never end their lists

S = TypeVar("S", bound=ctypes.Structure)


@dataclass(frozen=True)
class FilledBuffer:
    """A buffer that the camera has filled.

    `data` are its bytes, None where they were not copied; `sequence` is the kernel's number of the
    frame, `captured` its time by CLOCK_MONOTONIC [ns], that of the start of exposure if `at_start`,
    else of the end of its transfer; None where the kernel driver reports none. `is_damaged`: the
    kernel driver reports damaged data.
    """

    data: bytes | None
    sequence: int
    captured: int | None
    at_start: bool
    is_damaged: bool


class VideoDevice:
    """An open video node. Any thread may call its methods.

    All methods raise `LinkLost` once it is unplugged, and `DeviceError` if it refuses.
    """

    def __init__(self, path: Path) -> None:
        """Open it; raises `LinkLost` if it does not exist, `DeviceError` if it is not a camera."""
        self.path = path
        if not videodev.IS_64_BIT:
            raise DeviceError(
                f"{path}: this system is not a 64-bit one, so the kernel's structures have another "
                "layout; use a 64-bit Python and kernel"
            )
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise _open_error(path, error) from error
        try:
            self._identify()
        except DeviceError:
            self.close()
            raise

    def close(self) -> None:
        """Close it; may be called again."""
        if self._descriptor >= 0:
            # Closing an unplugged device reports an error once more, but closes it.
            with suppress(OSError):
                os.close(self._descriptor)
            self._descriptor = -1

    def fileno(self) -> int:
        """Return the file descriptor, for waiting."""
        return self._descriptor

    def request(self, number: int, argument: ctypes._CData, action: str) -> None:
        """Make a request; raises `LinkLost`, or `DeviceError` with the `action` that failed."""
        try:
            self.ioctl(number, argument)
        except OSError as error:
            raise self.device_error(error, action) from error

    def ioctl(self, number: int, argument: ctypes._CData) -> None:
        """Make a request; raises `OSError` if the system reports an error."""
        while _IOCTL(self._descriptor, number, ctypes.byref(argument)) < 0:
            code = ctypes.get_errno()
            if code != errno.EINTR:
                raise OSError(code, os.strerror(code))

    def device_error(self, error: OSError, action: str) -> DeviceError:
        """Return the error to raise for an error of the system."""
        if error.errno in (errno.ENODEV, errno.ENXIO, errno.EBADF):
            return LinkLost(
                f"{self.path} has disappeared: it was unplugged, or its kernel driver was unloaded"
            )
        remedy = ""
        if error.errno == errno.EBUSY:
            remedy = f"; another program uses it (`fuser -v {self.path}` names it): terminate that"
        if error.errno == errno.EACCES:
            remedy = "; the camera sets it automatically (auto_exposure, gain_automatic): set that"
        if error.errno == errno.ENOTTY:
            remedy = "; it is not a camera: `cairn driver probe camera` lists them"
        if error.errno == errno.ENOSPC:
            remedy = "; its USB bus has no bandwidth left: use another bus, or MJPG"
        return DeviceError(f"{self.path}: {action}: {os.strerror(error.errno or 0)}{remedy}")

    def formats(self) -> list[str]:
        """Return the names of its pixel formats, in its own order."""
        found = self._enumerated(
            videodev.ENUM_FMT,
            lambda index: videodev.FormatDescription(index=index, type=videodev.CAPTURE),
        )
        return [videodev.fourcc_name(entry.pixelformat) for entry in found]

    def sizes(self, pixel_format: str) -> list[FrameSize]:
        """Return the frame sizes of a format with their rates; none if it does not report them."""
        code = videodev.fourcc(pixel_format)
        sizes = []
        for entry in self._enumerated(
            videodev.ENUM_FRAMESIZES,
            lambda index: videodev.SizeQuery(index=index, pixel_format=code),
        ):
            is_range = entry.type != videodev.DISCRETE
            # The largest of a range: minimum, maximum and step of the width, then of the height.
            width, height = entry.size.stepwise[1:5:3] if is_range else entry.size.discrete
            rates = tuple(self._rates(code, width, height))
            sizes.append(FrameSize(width, height, rates, is_range=is_range))
            if is_range:  # one entry describes all of it
                break
        return sizes

    def set_format(self, pixel_format: str, width: int, height: int, rate: float) -> CaptureFormat:
        """Request a format, size [px] and rate [1/s]; return what the camera chose.

        Raises `DeviceError`, also if it does not offer the pixel format.
        """
        requested = videodev.Format(type=videodev.CAPTURE)
        pix = requested.fmt.pix
        pix.width, pix.height = width, height
        pix.pixelformat, pix.field = videodev.fourcc(pixel_format), videodev.FIELD_NONE
        self.request(videodev.S_FMT, requested, f"requesting {pixel_format} {width} x {height}")
        chosen = videodev.fourcc_name(pix.pixelformat)
        if chosen != pixel_format:
            raise DeviceError(
                f"{self.path} sends {chosen} instead of {pixel_format} of {width} x {height} "
                f"pixels; it offers {', '.join(self.formats())}: choose another format or size"
            )
        layout = ImageLayout(pix.width, pix.height, chosen, pix.bytesperline)
        return CaptureFormat(layout, self._set_rate(rate))

    def controls(self) -> dict[str, CameraControl]:
        """Return its controls that have a number as value, by plain name."""
        offered = [
            query
            for query in self._control_queries()
            if query.type in SETTABLE and not query.flags & videodev.CTRL_FLAG_DISABLED
        ]
        return {control.name: control for control in map(self._control, offered)}

    def control(self, control: CameraControl) -> int:
        """Return the value of a control."""
        value = videodev.ControlValue(id=control.id)
        self.request(videodev.G_CTRL, value, f"reading {control.name}")
        return _unsigned_bits(control.type, value.value)

    def is_inactive(self, control: CameraControl) -> bool:
        """Return whether the camera sets a control automatically at this moment."""
        query = videodev.ControlQuery(id=control.id)
        self.request(videodev.QUERYCTRL, query, f"reading {control.name}")
        return bool(query.flags & videodev.CTRL_FLAG_INACTIVE)

    def set_control(self, control: CameraControl, value: int) -> None:
        """Set a control to a value that it accepts."""
        argument = videodev.ControlValue(id=control.id, value=ctypes.c_int32(value).value)
        self.request(videodev.S_CTRL, argument, f"setting {control.name} = {value}")

    def _identify(self) -> None:
        capability = videodev.Capability()
        self.request(videodev.QUERYCAP, capability, "querying its capabilities")
        self.card = capability.card.decode("utf-8", "replace")
        self.bus = capability.bus_info.decode("utf-8", "replace")
        has_device_caps = capability.capabilities & videodev.CAP_DEVICE_CAPS
        caps = capability.device_caps if has_device_caps else capability.capabilities
        if not caps & videodev.CAP_VIDEO_CAPTURE or not caps & videodev.CAP_STREAMING:
            several = caps & videodev.CAP_VIDEO_CAPTURE_MPLANE
            raise DeviceError(
                f"{self.path} ({self.card}) "
                + ("sends its images in several planes" if several else "sends no images")
                + "; choose another node, `cairn driver probe camera` lists them"
            )

    def _set_rate(self, rate: float) -> float:
        requested = videodev.StreamParameters(type=videodev.CAPTURE)
        if not self._supports(videodev.G_PARM, requested):
            return 0.0  # such as capture cards, whose rate is that of their signal
        period = requested.parm.capture.timeperframe
        if requested.parm.capture.capability & videodev.CAP_TIMEPERFRAME:
            period.numerator, period.denominator = 1000, round(1000 * rate)
            self.request(videodev.S_PARM, requested, f"requesting {rate:g} images per second")
        return _rate(period)

    def _rates(self, code: int, width: int, height: int) -> Iterator[float]:
        for entry in self._enumerated(
            videodev.ENUM_FRAMEINTERVALS,
            lambda index: videodev.IntervalQuery(
                index=index, pixel_format=code, width=width, height=height
            ),
        ):
            discrete = entry.type == videodev.DISCRETE
            yield _rate(entry.interval.discrete if discrete else entry.interval.stepwise[0])
            if not discrete:
                return

    def _control_queries(self) -> Iterator[videodev.ControlQuery]:
        query = videodev.ControlQuery(id=videodev.CTRL_FLAG_NEXT_CTRL)
        while (found := self._query_control(query)) is True:
            yield query
            query = videodev.ControlQuery(id=query.id | videodev.CTRL_FLAG_NEXT_CTRL)
        if found is None:  # the list ends here, but the ids of the usual controls are known
            last = query.id & ~videodev.CTRL_FLAG_NEXT_CTRL
            for control_id in sorted(known for known in STANDARD.values() if known > last):
                single = videodev.ControlQuery(id=control_id)
                if self._query_control(single):
                    yield single

    def _query_control(self, query: videodev.ControlQuery) -> bool | None:
        """Return whether there is such a control; None if the firmware fails, as some does."""
        try:
            return self._supports(videodev.QUERYCTRL, query)
        except LinkLost:
            raise
        except DeviceError:
            return None

    def _control(self, query: videodev.ControlQuery) -> CameraControl:
        items = {}
        if query.type in (videodev.CTRL_TYPE_MENU, videodev.CTRL_TYPE_INTEGER_MENU):
            for index in range(query.minimum, query.maximum + 1):
                menu = videodev.MenuQuery(id=query.id, index=index)
                if not self._supports(videodev.QUERYMENU, menu):
                    continue  # menus have gaps
                named = query.type == videodev.CTRL_TYPE_MENU
                items[index] = menu.item.name.decode("utf-8", "replace") if named else str(
                    menu.item.value
                )  # fmt: skip
        return CameraControl(
            query.id,
            plain_name(query.name.decode("utf-8", "replace")),
            query.type,
            query.minimum,
            query.maximum,
            query.step,
            _unsigned_bits(query.type, query.default_value),
            query.flags,
            items,
        )

    def _enumerated(self, number: int, query: Callable[[int], S]) -> Iterator[S]:
        """Yield the answers to queries numbered from 0, until there is none."""
        for index in range(_LONGEST_LIST):
            argument = query(index)
            if not self._supports(number, argument):
                return
            yield argument

    def _supports(self, number: int, argument: ctypes._CData) -> bool:
        """Make a request that a device need not support; return whether it does."""
        try:
            self.ioctl(number, argument)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return False
            raise self.device_error(error, "querying what it offers") from error
        return True


class VideoStream:
    """The buffers of a camera whose format is set; it streams between `start` and `stop`.

    Methods raise `LinkLost` once the camera is unplugged, and `DeviceError` if it fails.
    """

    def __init__(self, device: VideoDevice, buffers: int) -> None:
        """Share `buffers` buffers with the kernel, or as many as its driver grants."""
        self._device = device
        self._maps: list[mmap.mmap] = []
        with ExitStack() as undo:
            undo.callback(self.close)
            request = videodev.BufferRequest(
                count=buffers, type=videodev.CAPTURE, memory=videodev.MMAP
            )
            device.request(videodev.REQBUFS, request, f"requesting {buffers} buffers")
            for index in range(request.count):
                self._maps.append(self._map(index))
            if not self._maps:
                raise DeviceError(f"{device.path} grants no buffers; check its kernel driver")
            undo.pop_all()

    def start(self) -> None:
        """Queue all buffers, and start the stream."""
        for index in range(len(self._maps)):
            self._enqueue(index)
        self._switch(videodev.STREAMON, "starting the stream")

    def stop(self) -> None:
        """Stop streaming; frames that were not read are lost."""
        self._switch(videodev.STREAMOFF, "stopping the stream")

    def close(self) -> None:
        """Free the buffers; may be called again, and after the device has disappeared."""
        for shared in self._maps:
            shared.close()
        self._maps.clear()
        none = videodev.BufferRequest(count=0, type=videodev.CAPTURE, memory=videodev.MMAP)
        with suppress(OSError):  # an unplugged device has freed them already
            self._device.ioctl(videodev.REQBUFS, none)

    def newest(self, timeout_s: float) -> list[FilledBuffer]:
        """Return all filled buffers, oldest first; waits up to `timeout_s` [s] for one.

        All of them are taken from the kernel, so that the last whole frame is the newest one; only
        its data are copied.
        """
        poll = select.poll()
        poll.register(self._device, select.POLLIN)
        ready = poll.poll(1000 * timeout_s)
        if not ready:
            return []
        filled = self._all_filled()
        if not filled and not ready[0][1] & select.POLLIN:
            # Polling would return at once from now on.
            raise DeviceError(f"{self._device.path}: its stream reports an error")
        whole = [buffer.index for buffer in filled if not buffer.flags & videodev.BUF_FLAG_ERROR]
        buffers = []
        for buffer in filled:
            is_newest = bool(whole) and buffer.index == whole[-1]
            data = self._maps[buffer.index][: buffer.bytesused] if is_newest else None
            buffers.append(_filled_buffer(buffer, data))
            self._enqueue(buffer.index)
        return buffers

    def _all_filled(self) -> list[videodev.V4l2Buffer]:
        filled = []
        for _ in self._maps:  # no more can be filled
            buffer = self._dequeue()
            if buffer is None:
                break
            filled.append(buffer)
        return filled

    def _dequeue(self) -> videodev.V4l2Buffer | None:
        buffer = videodev.V4l2Buffer(type=videodev.CAPTURE, memory=videodev.MMAP)
        try:
            self._device.ioctl(videodev.DQBUF, buffer)
        except OSError as error:
            if error.errno == errno.EAGAIN:
                return None
            raise self._device.device_error(error, "its stream failed") from error
        return buffer

    def _enqueue(self, index: int) -> None:
        buffer = videodev.V4l2Buffer(index=index, type=videodev.CAPTURE, memory=videodev.MMAP)
        self._device.request(videodev.QBUF, buffer, "queuing a buffer")

    def _switch(self, number: int, action: str) -> None:
        self._device.request(number, ctypes.c_int32(videodev.CAPTURE), action)

    def _map(self, index: int) -> mmap.mmap:
        buffer = videodev.V4l2Buffer(index=index, type=videodev.CAPTURE, memory=videodev.MMAP)
        self._device.request(videodev.QUERYBUF, buffer, "querying a buffer")
        try:
            return mmap.mmap(
                self._device.fileno(), buffer.length, mmap.MAP_SHARED, mmap.PROT_READ,
                offset=buffer.m.offset,
            )  # fmt: skip
        except OSError as error:
            raise self._device.device_error(error, "mapping a buffer") from error


def _filled_buffer(buffer: videodev.V4l2Buffer, data: bytes | None) -> FilledBuffer:
    flags = buffer.flags
    monotonic = flags & videodev.BUF_FLAG_TIMESTAMP_MASK == videodev.BUF_FLAG_TIMESTAMP_MONOTONIC
    time = buffer.timestamp
    return FilledBuffer(
        data,
        buffer.sequence,
        time.tv_sec * 1_000_000_000 + time.tv_usec * 1000 if monotonic else None,
        flags & videodev.BUF_FLAG_TSTAMP_SRC_MASK == videodev.BUF_FLAG_TSTAMP_SRC_SOE,
        bool(flags & videodev.BUF_FLAG_ERROR),
    )


def _unsigned_bits(kind: int, value: int) -> int:
    """Return a control's value; the kernel returns bits as a signed number."""
    return value & 0xFFFFFFFF if kind == videodev.CTRL_TYPE_BITMASK else value


def _rate(period: videodev.Fraction) -> float:
    """Return the rate [1/s]; 0 for a period that is not reported."""
    return period.denominator / period.numerator if period.numerator else 0.0


def _open_error(path: Path, error: OSError) -> DeviceError:
    if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return LinkLost(
            f"{path}: there is no such camera; `cairn driver probe camera` lists those connected"
        )
    remedy = ""
    if error.errno in (errno.EACCES, errno.EPERM):
        remedy = "; add the user to the group of the device (`ls -l` shows it, mostly video)"
    if error.errno == errno.EBUSY:
        remedy = f"; another program uses it (`fuser -v {path}` names it): terminate that"
    return DeviceError(f"{path} cannot be opened: {os.strerror(error.errno or 0)}{remedy}")
