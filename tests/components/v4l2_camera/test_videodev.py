"""Structures and requests have the layout of the kernel on 64-bit systems."""

import ctypes

import pytest

from cairn.components.v4l2_camera import videodev


@pytest.mark.parametrize(
    ("structure", "size"),
    [
        (videodev.Capability, 104),
        (videodev.FormatDescription, 64),
        (videodev.Format, 208),
        (videodev.StreamParameters, 204),
        (videodev.BufferRequest, 20),
        (videodev.V4l2Buffer, 88),
        (videodev.ControlValue, 8),
        (videodev.ControlQuery, 68),
        (videodev.MenuQuery, 44),
        (videodev.SizeQuery, 44),
        (videodev.IntervalQuery, 52),
    ],
)
def test_structures_have_the_sizes_of_the_kernel(
    structure: type[ctypes.Structure], size: int
) -> None:
    assert ctypes.sizeof(structure) == size


@pytest.mark.parametrize(
    ("request_", "number"),
    [
        (videodev.QUERYCAP, 0x80685600),
        (videodev.ENUM_FMT, 0xC0405602),
        (videodev.S_FMT, 0xC0D05605),
        (videodev.REQBUFS, 0xC0145608),
        (videodev.QUERYBUF, 0xC0585609),
        (videodev.QBUF, 0xC058560F),
        (videodev.DQBUF, 0xC0585611),
        (videodev.STREAMON, 0x40045612),
        (videodev.STREAMOFF, 0x40045613),
        (videodev.G_PARM, 0xC0CC5615),
        (videodev.S_PARM, 0xC0CC5616),
        (videodev.G_CTRL, 0xC008561B),
        (videodev.S_CTRL, 0xC008561C),
        (videodev.QUERYCTRL, 0xC0445624),
        (videodev.QUERYMENU, 0xC02C5625),
        (videodev.ENUM_FRAMESIZES, 0xC02C564A),
        (videodev.ENUM_FRAMEINTERVALS, 0xC034564B),
    ],
)
def test_requests_have_the_numbers_of_the_kernel(request_: int, number: int) -> None:
    assert request_ == number


@pytest.mark.parametrize(
    ("field", "offset"), [("timestamp", 24), ("sequence", 56), ("m", 64), ("length", 72)]
)
def test_buffer_fields_have_the_offsets_of_the_kernel(field: str, offset: int) -> None:
    assert getattr(videodev.V4l2Buffer, field).offset == offset


@pytest.mark.parametrize("name", ["GREY", "YUYV", "MJPG", "Y16"])
def test_pixel_formats_have_names(name: str) -> None:
    assert videodev.fourcc_name(videodev.fourcc(name)) == name
    assert videodev.fourcc("YUYV") == 0x56595559
