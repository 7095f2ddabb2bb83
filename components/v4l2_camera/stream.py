"""A camera's stream: buffers that it shares with the kernel, and the newest picture in them."""

from __future__ import annotations

import ctypes
import errno
import mmap
import select
from contextlib import ExitStack, suppress
from dataclasses import dataclass

from cairn.components.v4l2_camera import videodev
from cairn.components.v4l2_camera.device import VideoDevice
from cairn.driver.errors import DeviceError


@dataclass(frozen=True)
class Capture:
    """A buffer that the camera has filled.

    `data` are its bytes, None where they were not copied; `sequence` is the kernel's number of the
    picture, `taken` its time by CLOCK_MONOTONIC [ns], that of the exposure's beginning if
    `at_start`, else of the end of its transfer; None where the driver tells none. `is_damaged`: the
    driver says that the data are.
    """

    data: bytes | None
    sequence: int
    taken: int | None
    at_start: bool
    is_damaged: bool


class Stream:
    """The buffers of a camera that is set up; streams between `start` and `stop`.

    Methods raise `LinkLost` once the camera is unplugged, and `DeviceError` if it fails.
    """

    def __init__(self, device: VideoDevice, buffers: int) -> None:
        """Share so many buffers with the kernel, or as many as the driver wants."""
        self._device = device
        self._maps: list[mmap.mmap] = []
        with ExitStack() as undo:
            undo.callback(self.close)
            request = videodev.BufferRequest(
                count=buffers, type=videodev.CAPTURE, memory=videodev.MMAP
            )
            device.request(videodev.REQBUFS, request, f"asked for {buffers} buffers")
            for index in range(request.count):
                self._maps.append(self._mapped(index))
            if not self._maps:
                raise DeviceError(f"{device.path} gives no buffers")
            undo.pop_all()

    def start(self) -> None:
        """Hand all buffers to the camera, and let it stream."""
        for index in range(len(self._maps)):
            self._give_back(index)
        self._switch(videodev.STREAMON, "asked to stream")

    def stop(self) -> None:
        """Stop streaming; pictures that nobody has taken are lost."""
        self._switch(videodev.STREAMOFF, "asked to stop streaming")

    def close(self) -> None:
        """Give the buffers back; may be called again, and after the device is gone."""
        for shared in self._maps:
            shared.close()
        self._maps.clear()
        none = videodev.BufferRequest(count=0, type=videodev.CAPTURE, memory=videodev.MMAP)
        with suppress(OSError):  # a device that is gone has freed them already
            self._device.ioctl(videodev.REQBUFS, none)

    def newest(self, limit_s: float) -> list[Capture]:
        """What has come, oldest first; waits up to `limit_s` [s] for something.

        All that waits is taken from the kernel, so that the last whole picture is the newest there
        is; only its data are copied.
        """
        poll = select.poll()
        poll.register(self._device, select.POLLIN)
        ready = poll.poll(1000 * limit_s)
        if not ready:
            return []
        filled = self._all_filled()
        if not filled and not ready[0][1] & select.POLLIN:
            # It would be ready again at once, for ever.
            raise DeviceError(f"{self._device.path}: its stream has an error")
        whole = [buffer.index for buffer in filled if not buffer.flags & videodev.BUF_FLAG_ERROR]
        taken = []
        for buffer in filled:
            is_newest = bool(whole) and buffer.index == whole[-1]
            data = self._maps[buffer.index][: buffer.bytesused] if is_newest else None
            taken.append(_capture(buffer, data))
            self._give_back(buffer.index)
        return taken

    def _all_filled(self) -> list[videodev.Buffer]:
        filled = []
        for _ in self._maps:  # as many can have waited
            buffer = self._filled()
            if buffer is None:
                break
            filled.append(buffer)
        return filled

    def _filled(self) -> videodev.Buffer | None:
        buffer = videodev.Buffer(type=videodev.CAPTURE, memory=videodev.MMAP)
        try:
            self._device.ioctl(videodev.DQBUF, buffer)
        except OSError as error:
            if error.errno == errno.EAGAIN:
                return None
            raise self._device.failed(error, "its stream broke off") from error
        return buffer

    def _give_back(self, index: int) -> None:
        buffer = videodev.Buffer(index=index, type=videodev.CAPTURE, memory=videodev.MMAP)
        self._device.request(videodev.QBUF, buffer, "given a buffer to fill")

    def _switch(self, number: int, doing: str) -> None:
        self._device.request(number, ctypes.c_int32(videodev.CAPTURE), doing)

    def _mapped(self, index: int) -> mmap.mmap:
        buffer = videodev.Buffer(index=index, type=videodev.CAPTURE, memory=videodev.MMAP)
        self._device.request(videodev.QUERYBUF, buffer, "asked where a buffer is")
        try:
            return mmap.mmap(
                self._device.fileno(), buffer.length, mmap.MAP_SHARED, mmap.PROT_READ,
                offset=buffer.m.offset,
            )  # fmt: skip
        except OSError as error:
            raise self._device.failed(error, "its buffer cannot be mapped") from error


def _capture(buffer: videodev.Buffer, data: bytes | None) -> Capture:
    flags = buffer.flags
    monotonic = flags & videodev.BUF_FLAG_TIMESTAMP_MASK == videodev.BUF_FLAG_TIMESTAMP_MONOTONIC
    time = buffer.timestamp
    return Capture(
        data,
        buffer.sequence,
        time.tv_sec * 1_000_000_000 + time.tv_usec * 1000 if monotonic else None,
        flags & videodev.BUF_FLAG_TSTAMP_SRC_MASK == videodev.BUF_FLAG_TSTAMP_SRC_SOE,
        bool(flags & videodev.BUF_FLAG_ERROR),
    )
