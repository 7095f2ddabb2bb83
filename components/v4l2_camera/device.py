"""A video node: what it is, what it offers, and how its pictures are set up."""

from __future__ import annotations

import ctypes
import errno
import os
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TypeVar

from cairn.components.v4l2_camera import videodev
from cairn.components.v4l2_camera.controls import SETTABLE, STANDARD, Control, plain_name
from cairn.components.v4l2_camera.offers import PictureSize
from cairn.components.v4l2_camera.pixels import PictureLayout
from cairn.driver.errors import DeviceError, LinkLost

# The system's call itself, as it lets other threads go on: `fcntl.ioctl` keeps them all waiting,
# and some requests to a USB camera take seconds where its line is bad.
_IOCTL: Final = ctypes.CDLL(None, use_errno=True).ioctl
_IOCTL.argtypes = (ctypes.c_int, ctypes.c_ulong, ctypes.c_void_p)

# What the enumerations of sizes and rates are cut off at: some drivers never end them.
_MOST = 1000

S = TypeVar("S", bound=ctypes.Structure)


@dataclass(frozen=True)
class Setup:
    """What a camera agreed to: how pictures are laid out, and how many a second come.

    `rate` is 0 where the camera does not tell it.
    """

    layout: PictureLayout
    rate: float


class VideoDevice:
    """An open video node. Requests to it may be made by any thread.

    All methods raise `LinkLost` once it is unplugged, and `DeviceError` if it refuses.
    """

    def __init__(self, path: Path) -> None:
        """Open it; raises `LinkLost` if it is not there, `DeviceError` if it is no camera."""
        self.path = path
        if not videodev.IS_64_BIT:
            raise DeviceError(
                f"{path}: cameras are read on 64-bit systems only, as the kernel lays its "
                "structures out otherwise on this one; use a 64-bit Python and kernel"
            )
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise _not_opened(path, error) from error
        try:
            self._identify()
        except DeviceError:
            self.close()
            raise

    def close(self) -> None:
        """Let go of it; may be called again."""
        if self._descriptor >= 0:
            # A device that was unplugged says so once more when it is closed; it is closed then.
            with suppress(OSError):
                os.close(self._descriptor)
            self._descriptor = -1

    def fileno(self) -> int:
        """The file descriptor, to wait on."""
        return self._descriptor

    def request(self, number: int, argument: ctypes._CData, doing: str) -> None:
        """Make a request; raises `LinkLost` or `DeviceError` that says what it was `doing`."""
        try:
            self.ioctl(number, argument)
        except OSError as error:
            raise self.failed(error, doing) from error

    def ioctl(self, number: int, argument: ctypes._CData) -> None:
        """Make a request; raises `OSError` as the system tells it."""
        while _IOCTL(self._descriptor, number, ctypes.byref(argument)) < 0:
            code = ctypes.get_errno()
            if code != errno.EINTR:
                raise OSError(code, os.strerror(code))

    def failed(self, error: OSError, doing: str) -> DeviceError:
        """The error of ours that tells a system's one."""
        if error.errno in (errno.ENODEV, errno.ENXIO, errno.EBADF):
            return LinkLost(f"{self.path} is gone: it was unplugged, or its driver was unloaded")
        remedy = ""
        if error.errno == errno.EBUSY:
            remedy = f"; another program uses it (`fuser -v {self.path}` tells which): end that"
        if error.errno == errno.EACCES:
            remedy = "; something automatic holds it (auto_exposure, gain_automatic ...): set that"
        if error.errno == errno.ENOTTY:
            remedy = "; it is no camera: `cairn driver probe camera` lists those that are"
        if error.errno == errno.ENOSPC:
            remedy = "; its USB bus has no room left: plug it into another one, or use MJPG"
        return DeviceError(f"{self.path}: {doing}: {os.strerror(error.errno or 0)}{remedy}")

    def formats(self) -> list[str]:
        """The names of its pixel formats, its own order."""
        found = self._enumerated(
            videodev.ENUM_FMT,
            lambda index: videodev.FormatDescription(index=index, type=videodev.CAPTURE),
        )
        return [videodev.fourcc_name(one.pixelformat) for one in found]

    def sizes(self, pixel_format: str) -> list[PictureSize]:
        """The sizes of pictures of a format, and the rates of each; none if it does not tell."""
        code = videodev.fourcc(pixel_format)
        sizes = []
        for one in self._enumerated(
            videodev.ENUM_FRAMESIZES,
            lambda index: videodev.SizeQuery(index=index, pixel_format=code),
        ):
            is_range = one.type != videodev.DISCRETE
            # Of a range the largest: least and largest width, its step, and so the height.
            width, height = one.size.stepwise[1:5:3] if is_range else one.size.discrete
            rates = tuple(self._rates(code, width, height))
            sizes.append(PictureSize(width, height, rates, is_range=is_range))
            if is_range:  # the one answer tells all of it
                break
        return sizes

    def set_up(self, pixel_format: str, width: int, height: int, rate: float) -> Setup:
        """Ask for pictures, size in px and rate in 1/s; gives what the camera makes of that.

        Raises `DeviceError` also if it does not have the pixel format.
        """
        asked = videodev.Format(type=videodev.CAPTURE)
        pix = asked.fmt.pix
        pix.width, pix.height = width, height
        pix.pixelformat, pix.field = videodev.fourcc(pixel_format), videodev.FIELD_NONE
        self.request(videodev.S_FMT, asked, f"asked for {pixel_format} {width} x {height}")
        got = videodev.fourcc_name(pix.pixelformat)
        if got != pixel_format:
            raise DeviceError(
                f"{self.path} gives {got} instead of {pixel_format} of {width} x {height} pixels; "
                f"it has {', '.join(self.formats())}: choose another format or size"
            )
        layout = PictureLayout(pix.width, pix.height, got, pix.bytesperline)
        return Setup(layout, self._set_rate(rate))

    def controls(self) -> dict[str, Control]:
        """Its controls that have a number as value, by plain name."""
        offered = [
            query
            for query in self._control_queries()
            if query.type in SETTABLE and not query.flags & videodev.CTRL_FLAG_DISABLED
        ]
        return {control.name: control for control in map(self._control, offered)}

    def control(self, control: Control) -> int:
        """The value that a control has."""
        value = videodev.ControlValue(id=control.id)
        self.request(videodev.G_CTRL, value, f"asked for {control.name}")
        return _unsigned_bits(control.type, value.value)

    def is_held(self, control: Control) -> bool:
        """Whether something automatic has taken a control over, at this moment."""
        query = videodev.ControlQuery(id=control.id)
        self.request(videodev.QUERYCTRL, query, f"asked for {control.name}")
        return bool(query.flags & videodev.CTRL_FLAG_INACTIVE)

    def set_control(self, control: Control, wanted: int) -> None:
        """Give a control a value that it takes."""
        value = videodev.ControlValue(id=control.id, value=ctypes.c_int32(wanted).value)
        self.request(videodev.S_CTRL, value, f"set {control.name} = {wanted}")

    def _identify(self) -> None:
        known = videodev.Capability()
        self.request(videodev.QUERYCAP, known, "asked what it is")
        self.card = known.card.decode("utf-8", "replace")
        self.bus = known.bus_info.decode("utf-8", "replace")
        has_own = known.capabilities & videodev.CAP_DEVICE_CAPS
        can = known.device_caps if has_own else known.capabilities
        if not can & videodev.CAP_VIDEO_CAPTURE or not can & videodev.CAP_STREAMING:
            several = can & videodev.CAP_VIDEO_CAPTURE_MPLANE
            raise DeviceError(
                f"{self.path} ({self.card}) "
                + ("gives its pictures in several planes" if several else "gives no pictures")
                + ": choose another node, `cairn driver probe camera` lists them"
            )

    def _set_rate(self, rate: float) -> float:
        asked = videodev.StreamParameters(type=videodev.CAPTURE)
        if not self._answers(videodev.G_PARM, asked):
            return 0.0  # as capture cards, whose rate is that of their signal
        period = asked.parm.capture.timeperframe
        if asked.parm.capture.capability & videodev.CAP_TIMEPERFRAME:
            period.numerator, period.denominator = 1000, round(1000 * rate)
            self.request(videodev.S_PARM, asked, f"asked for {rate:g} pictures a second")
        return _rate(period)

    def _rates(self, code: int, width: int, height: int) -> Iterator[float]:
        for one in self._enumerated(
            videodev.ENUM_FRAMEINTERVALS,
            lambda index: videodev.IntervalQuery(
                index=index, pixel_format=code, width=width, height=height
            ),
        ):
            discrete = one.type == videodev.DISCRETE
            yield _rate(one.interval.discrete if discrete else one.interval.stepwise[0])
            if not discrete:
                return

    def _control_queries(self) -> Iterator[videodev.ControlQuery]:
        query = videodev.ControlQuery(id=videodev.CTRL_FLAG_NEXT_CTRL)
        while (is_told := self._is_control(query)) is True:
            yield query
            query = videodev.ControlQuery(id=query.id | videodev.CTRL_FLAG_NEXT_CTRL)
        if is_told is None:  # nor what comes after it, but numbers of the usual ones are known
            last = query.id & ~videodev.CTRL_FLAG_NEXT_CTRL
            for number in sorted(number for number in STANDARD.values() if number > last):
                single = videodev.ControlQuery(id=number)
                if self._is_control(single):
                    yield single

    def _is_control(self, query: videodev.ControlQuery) -> bool | None:
        """Whether there is such a control; None if the firmware fails to tell, as some do."""
        try:
            return self._answers(videodev.QUERYCTRL, query)
        except LinkLost:
            raise
        except DeviceError:
            return None

    def _control(self, query: videodev.ControlQuery) -> Control:
        items = {}
        if query.type in (videodev.CTRL_TYPE_MENU, videodev.CTRL_TYPE_INTEGER_MENU):
            for index in range(query.minimum, query.maximum + 1):
                menu = videodev.MenuQuery(id=query.id, index=index)
                if not self._answers(videodev.QUERYMENU, menu):
                    continue  # menus have gaps
                named = query.type == videodev.CTRL_TYPE_MENU
                items[index] = menu.item.name.decode("utf-8", "replace") if named else str(
                    menu.item.value
                )  # fmt: skip
        return Control(
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
        """Answers to queries numbered from 0, until there is none."""
        for index in range(_MOST):
            argument = query(index)
            if not self._answers(number, argument):
                return
            yield argument

    def _answers(self, number: int, argument: ctypes._CData) -> bool:
        """Make a request that a device need not know; whether it answered."""
        try:
            self.ioctl(number, argument)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return False
            raise self.failed(error, "asked what it offers") from error
        return True


def _unsigned_bits(kind: int, value: int) -> int:
    """A control's value, which the kernel gives as a signed number even where it is bits."""
    return value & 0xFFFFFFFF if kind == videodev.CTRL_TYPE_BITMASK else value


def _rate(period: videodev.Fraction) -> float:
    """Pictures a second; 0 for a period that is not told."""
    return period.denominator / period.numerator if period.numerator else 0.0


def _not_opened(path: Path, error: OSError) -> DeviceError:
    if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return LinkLost(
            f"{path}: there is no such camera; `cairn driver probe camera` lists those that are"
        )
    remedy = ""
    if error.errno in (errno.EACCES, errno.EPERM):
        remedy = "; add the user to the group of the device (`ls -l` tells it, mostly video)"
    if error.errno == errno.EBUSY:
        remedy = f"; another program uses it (`fuser -v {path}` tells which): end that"
    return DeviceError(f"{path} cannot be opened: {os.strerror(error.errno or 0)}{remedy}")
