"""Structures and requests of `linux/videodev2.h` that capturing needs, for ctypes.

Names of fields are the kernel's, so that its documentation (Video for Linux API, part I of the
kernel's media userspace API) can be read beside them. The layouts are those of 64-bit systems:
`v4l2_buffer` holds a `timeval` and a pointer, and has another layout on 32-bit ones.
"""

from __future__ import annotations

import ctypes
from ctypes import c_char, c_int32, c_int64, c_long, c_uint8, c_uint32, c_ulong, c_void_p
from typing import Final

IS_64_BIT: Final = ctypes.sizeof(c_void_p) == 8

CAPTURE: Final = 1  # V4L2_BUF_TYPE_VIDEO_CAPTURE
MMAP: Final = 1  # V4L2_MEMORY_MMAP
FIELD_NONE: Final = 1
"""V4L2_FIELD_NONE: progressive frames, not interlaced ones."""

CAP_VIDEO_CAPTURE: Final = 0x00000001
CAP_VIDEO_CAPTURE_MPLANE: Final = 0x00001000
CAP_STREAMING: Final = 0x04000000
CAP_DEVICE_CAPS: Final = 0x80000000
CAP_TIMEPERFRAME: Final = 0x1000

BUF_FLAG_ERROR: Final = 0x00000040
BUF_FLAG_TIMESTAMP_MASK: Final = 0x0000E000
BUF_FLAG_TIMESTAMP_MONOTONIC: Final = 0x00002000
BUF_FLAG_TSTAMP_SRC_MASK: Final = 0x00070000
BUF_FLAG_TSTAMP_SRC_SOE: Final = 0x00010000

CTRL_TYPE_INTEGER: Final = 1
CTRL_TYPE_BOOLEAN: Final = 2
CTRL_TYPE_MENU: Final = 3
CTRL_TYPE_BITMASK: Final = 8
CTRL_TYPE_INTEGER_MENU: Final = 9
CTRL_FLAG_DISABLED: Final = 0x0001
CTRL_FLAG_READ_ONLY: Final = 0x0004
CTRL_FLAG_INACTIVE: Final = 0x0010
CTRL_FLAG_NEXT_CTRL: Final = 0x80000000

DISCRETE: Final = 1
"""V4L2_FRMSIZE_TYPE_DISCRETE and V4L2_FRMIVAL_TYPE_DISCRETE; others are ranges."""


class Capability(ctypes.Structure):
    """struct v4l2_capability: identity and capabilities of the device."""

    _fields_ = [
        ("driver", c_char * 16),
        ("card", c_char * 32),
        ("bus_info", c_char * 32),
        ("version", c_uint32),
        ("capabilities", c_uint32),
        ("device_caps", c_uint32),
        ("reserved", c_uint32 * 3),
    ]


class FormatDescription(ctypes.Structure):
    """struct v4l2_fmtdesc: a pixel format that the device offers."""

    _fields_ = [
        ("index", c_uint32),
        ("type", c_uint32),
        ("flags", c_uint32),
        ("description", c_char * 32),
        ("pixelformat", c_uint32),
        ("mbus_code", c_uint32),
        ("reserved", c_uint32 * 3),
    ]


class PixelFormat(ctypes.Structure):
    """struct v4l2_pix_format: size and layout of frames."""

    _fields_ = [
        ("width", c_uint32),
        ("height", c_uint32),
        ("pixelformat", c_uint32),
        ("field", c_uint32),
        ("bytesperline", c_uint32),
        ("sizeimage", c_uint32),
        ("colorspace", c_uint32),
        ("priv", c_uint32),
        ("flags", c_uint32),
        ("ycbcr_enc", c_uint32),
        ("quantization", c_uint32),
        ("xfer_func", c_uint32),
    ]


class _FormatUnion(ctypes.Union):
    # The kernel's union has members with pointers, and so their alignment.
    _fields_ = [("pix", PixelFormat), ("raw_data", c_uint8 * 200), ("_aligned", c_void_p)]


class Format(ctypes.Structure):
    """struct v4l2_format."""

    _fields_ = [("type", c_uint32), ("fmt", _FormatUnion)]


class Fraction(ctypes.Structure):
    """struct v4l2_fract: a period [s]."""

    _fields_ = [("numerator", c_uint32), ("denominator", c_uint32)]


class CaptureParameters(ctypes.Structure):
    """struct v4l2_captureparm: rate of frames."""

    _fields_ = [
        ("capability", c_uint32),
        ("capturemode", c_uint32),
        ("timeperframe", Fraction),
        ("extendedmode", c_uint32),
        ("readbuffers", c_uint32),
        ("reserved", c_uint32 * 4),
    ]


class _ParametersUnion(ctypes.Union):
    _fields_ = [("capture", CaptureParameters), ("raw_data", c_uint8 * 200)]


class StreamParameters(ctypes.Structure):
    """struct v4l2_streamparm."""

    _fields_ = [("type", c_uint32), ("parm", _ParametersUnion)]


class BufferRequest(ctypes.Structure):
    """struct v4l2_requestbuffers: how many buffers are requested, and granted."""

    _fields_ = [
        ("count", c_uint32),
        ("type", c_uint32),
        ("memory", c_uint32),
        ("capabilities", c_uint32),
        ("flags", c_uint8),
        ("reserved", c_uint8 * 3),
    ]


class Timeval(ctypes.Structure):
    """struct timeval: seconds and microseconds."""

    _fields_ = [("tv_sec", c_long), ("tv_usec", c_long)]


class _Timecode(ctypes.Structure):
    _fields_ = [
        ("type", c_uint32),
        ("flags", c_uint32),
        ("frames", c_uint8),
        ("seconds", c_uint8),
        ("minutes", c_uint8),
        ("hours", c_uint8),
        ("userbits", c_uint8 * 4),
    ]


class _Memory(ctypes.Union):
    _fields_ = [("offset", c_uint32), ("userptr", c_ulong), ("planes", c_void_p), ("fd", c_int32)]


class V4l2Buffer(ctypes.Structure):
    """struct v4l2_buffer: a frame's memory, number, time and flags."""

    _fields_ = [
        ("index", c_uint32),
        ("type", c_uint32),
        ("bytesused", c_uint32),
        ("flags", c_uint32),
        ("field", c_uint32),
        ("timestamp", Timeval),
        ("timecode", _Timecode),
        ("sequence", c_uint32),
        ("memory", c_uint32),
        ("m", _Memory),
        ("length", c_uint32),
        ("reserved2", c_uint32),
        ("request_fd", c_int32),
    ]


class ControlValue(ctypes.Structure):
    """struct v4l2_control."""

    _fields_ = [("id", c_uint32), ("value", c_int32)]


class ControlQuery(ctypes.Structure):
    """struct v4l2_queryctrl: a control's name and bounds."""

    _fields_ = [
        ("id", c_uint32),
        ("type", c_uint32),
        ("name", c_char * 32),
        ("minimum", c_int32),
        ("maximum", c_int32),
        ("step", c_int32),
        ("default_value", c_int32),
        ("flags", c_uint32),
        ("reserved", c_uint32 * 2),
    ]


class _MenuItem(ctypes.Union):
    _pack_ = 1
    _fields_ = [("name", c_char * 32), ("value", c_int64)]


class MenuQuery(ctypes.Structure):
    """struct v4l2_querymenu: an item of a control that is a menu."""

    _pack_ = 1
    _fields_ = [
        ("id", c_uint32),
        ("index", c_uint32),
        ("item", _MenuItem),
        ("reserved", c_uint32),
    ]


class _SizeUnion(ctypes.Union):
    # Discrete: width, height. Stepwise: least, most, step of the width, then of the height.
    _fields_ = [("discrete", c_uint32 * 2), ("stepwise", c_uint32 * 6)]


class SizeQuery(ctypes.Structure):
    """struct v4l2_frmsizeenum: a frame size that the device offers."""

    _fields_ = [
        ("index", c_uint32),
        ("pixel_format", c_uint32),
        ("type", c_uint32),
        ("size", _SizeUnion),
        ("reserved", c_uint32 * 2),
    ]


class _IntervalUnion(ctypes.Union):
    # Stepwise: least, most, step.
    _fields_ = [("discrete", Fraction), ("stepwise", Fraction * 3)]


class IntervalQuery(ctypes.Structure):
    """struct v4l2_frmivalenum: a frame interval that the device offers."""

    _fields_ = [
        ("index", c_uint32),
        ("pixel_format", c_uint32),
        ("width", c_uint32),
        ("height", c_uint32),
        ("type", c_uint32),
        ("interval", _IntervalUnion),
        ("reserved", c_uint32 * 2),
    ]


def _request(direction: int, number: int, argument: type[ctypes.Structure | c_int32]) -> int:
    """Return a request number: direction, size of argument, 'V', number (asm/ioctl.h)."""
    return direction << 30 | ctypes.sizeof(argument) << 16 | ord("V") << 8 | number


_IN, _OUT, _BOTH = 1, 2, 3  # the kernel reads the argument, writes it, does both

QUERYCAP: Final = _request(_OUT, 0, Capability)
ENUM_FMT: Final = _request(_BOTH, 2, FormatDescription)
S_FMT: Final = _request(_BOTH, 5, Format)
REQBUFS: Final = _request(_BOTH, 8, BufferRequest)
QUERYBUF: Final = _request(_BOTH, 9, V4l2Buffer)
QBUF: Final = _request(_BOTH, 15, V4l2Buffer)
DQBUF: Final = _request(_BOTH, 17, V4l2Buffer)
STREAMON: Final = _request(_IN, 18, c_int32)
STREAMOFF: Final = _request(_IN, 19, c_int32)
G_PARM: Final = _request(_BOTH, 21, StreamParameters)
S_PARM: Final = _request(_BOTH, 22, StreamParameters)
G_CTRL: Final = _request(_BOTH, 27, ControlValue)
S_CTRL: Final = _request(_BOTH, 28, ControlValue)
QUERYCTRL: Final = _request(_BOTH, 36, ControlQuery)
QUERYMENU: Final = _request(_BOTH, 37, MenuQuery)
ENUM_FRAMESIZES: Final = _request(_BOTH, 74, SizeQuery)
ENUM_FRAMEINTERVALS: Final = _request(_BOTH, 75, IntervalQuery)


def fourcc(name: str) -> int:
    """Return the number of a pixel format such as `YUYV`."""
    return int.from_bytes(name.encode("ascii").ljust(4), "little")


def fourcc_name(number: int) -> str:
    """Return the name of a pixel format's number."""
    letters = (number & 0x7FFFFFFF).to_bytes(4, "little")
    return letters.decode("ascii", "replace").rstrip()
