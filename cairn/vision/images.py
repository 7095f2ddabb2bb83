"""Decodes images from files and messages to gray."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.errors import CairnError
from cairn.limits.files import open_regular
from cairn.limits.images import check_pixels, decode_image, read_header, read_image_file
from cairn.schemas.sensor_msgs import Image, pixel_layout
from cairn.schemas.std_msgs import Header
from cairn.system.files import explained

Gray = NDArray[np.uint8]

LEAST_SIDE: Final = 16
"""Shortest side [px]: nothing can be recognized in smaller images."""

_ROWS: Final = 256  # are converted at once, to limit the memory for fractions
# Exif orientation -> quarter turns to the left and whether to mirror first, to make it upright.
_UPRIGHT: Final = {
    1: (0, False),
    2: (0, True),
    3: (2, False),
    4: (2, True),
    5: (1, True),
    6: (3, False),
    7: (3, True),
    8: (1, False),
}

_GRAY: Final = ("mono8", "mono16", "8UC1", "16UC1", "nv12", "nv21", "nv24")
# OpenCV's names of colors, as in cv2.COLOR_BGR2GRAY.
_COLORS: Final = (
    {"8UC3": "BGR", "8UC4": "BGRA"}
    | {f"{name.lower()}{bits}": name for name in ("BGR", "RGB", "BGRA", "RGBA") for bits in (8, 16)}
    | {
        f"bayer_{order.lower()}{bits}": f"Bayer{order}"
        for order in ("RGGB", "BGGR", "GBRG", "GRBG")
        for bits in (8, 16)
    }
)
# Index of the luminance byte among the two bytes of a pixel.
_LUMINANCE: Final = {"yuv422": 1, "uyvy": 1, "yuv422_yuy2": 0, "yuyv": 0}


def read_image(path: Path) -> Gray:
    """Read and decode an image file; raise `CairnError` as `decode`, or if it cannot be read."""
    return decode(str(path), read_image_file(path))


def decode(name: str, data: bytes) -> Gray:
    """Decode the bytes of an image file to a gray image (h, w), upright according to its Exif data.

    Transparent pixels become white; for 16-bit images see `eight_bits`. Raises `CairnError`, which
    begins with `name`, if the file is empty, not an image, truncated, damaged (where its format
    can reveal that), too large or too small.
    """
    header, pixels = decode_image(name, data)
    _check_least(name, header.width, header.height)
    gray = eight_bits(_gray(pixels))
    turns, mirrored = _UPRIGHT.get(header.orientation, (0, False))
    upright = np.rot90(gray[:, ::-1] if mirrored else gray, turns)
    return np.require(upright, requirements=["C", "W"])


def upright_size(path: Path) -> tuple[int, int]:
    """Return width and height [px] of the image that `read_image` returns, without decoding it.

    Raises `CairnError` if the file is not an image.
    """
    with explained(f"{path}: cannot be read"), open_regular(path) as stream:
        header = read_header(str(path), stream)
    turns, _ = _UPRIGHT.get(header.orientation, (0, False))
    return (header.height, header.width) if turns % 2 else (header.width, header.height)


def gray_of(image: Image) -> Gray:
    """Convert an image message to gray (h, w); a gray image is returned without a copy.

    For 16-bit images see `eight_bits`. Raises `CairnError` with the encoding or the size if it is
    not valid.
    """
    name = f"an image of {image.header.frame_id or 'the camera'}"
    width, height, encoding = image.width, image.height, image.encoding
    _check_least(name, width, height)
    check_pixels(name, width, height)
    layout = pixel_layout(encoding)
    if layout is None or encoding not in (*_GRAY, *_COLORS, *_LUMINANCE):
        known = ", ".join((*_GRAY, *_COLORS, *_LUMINANCE))
        raise CairnError(
            f"{name}: encoding = {encoding!r} is not supported; set its driver to send one of "
            f"{known}"
        )
    number, channels = layout
    rows = _rows(name, image, number * channels)
    if encoding in _LUMINANCE:
        return np.ascontiguousarray(rows[:, _LUMINANCE[encoding] :: 2])
    values: NDArray[Any] = rows
    if number == 2:
        wide = np.ascontiguousarray(rows).view(">u2" if image.is_bigendian else "<u2")
        values = wide.astype(np.uint16, copy=False)
    if encoding in _COLORS:
        shape = (height, width, channels) if channels > 1 else (height, width)
        conversion: int = getattr(cv2, f"COLOR_{_COLORS[encoding]}2GRAY")
        values = cv2.cvtColor(np.ascontiguousarray(values).reshape(shape), conversion)
    return eight_bits(values)


def gray_message(gray: Gray, header: Header) -> Image:
    """Return the message of a gray image (h, w)."""
    height, width = gray.shape
    return Image(
        header=header,
        height=height,
        width=width,
        encoding="mono8",
        step=width,
        data=np.ascontiguousarray(gray).reshape(-1),
    )


def eight_bits(gray: NDArray[np.integer[Any]]) -> Gray:
    """Convert an image of uint8 or uint16 to uint8.

    Cameras put 8 to 16 significant bits into 16-bit pixels, and messages do not say how many. So
    values are shifted by the number of bits that all but the brightest thousandth of the pixels
    need: no image turns black, and a dark one is not stretched until its noise has structure.
    """
    if gray.dtype == np.uint8:
        return np.asarray(gray, np.uint8)
    bits = int(np.percentile(gray, 99.9, method="lower")).bit_length()
    return np.asarray(np.minimum(gray >> max(0, bits - 8), 255), np.uint8)


def _gray(pixels: NDArray[Any]) -> NDArray[Any]:
    """Return the lightness (h, w) of pixels as `decode_image` returns them, on white."""
    if pixels.ndim == 2:
        return pixels
    if pixels.shape[2] == 3:
        return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY))
    gray = np.empty(pixels.shape[:2], pixels.dtype)
    for top in range(0, len(gray), _ROWS):
        band = slice(top, top + _ROWS)
        gray[band] = _on_white(pixels[band])
    return gray


def _on_white(pixels: NDArray[Any]) -> NDArray[Any]:
    whole = np.iinfo(pixels.dtype).max
    opaque = pixels[..., -1:].astype(np.float32) / whole
    color = pixels[..., :-1].astype(np.float32) * opaque + whole * (1.0 - opaque)
    pixels = np.rint(color).astype(pixels.dtype)
    return pixels[..., 0] if pixels.shape[2] == 1 else cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)


def _rows(name: str, image: Image, pixel: int) -> Gray:
    """Return the bytes of the pixels without padding, (height, width * pixel)."""
    length = image.width * pixel
    if image.step < length:
        raise CairnError(
            f"{name}: step = {image.step} is too small for {image.width} pixels of "
            f"{image.encoding}, which take {length} bytes; correct its driver"
        )
    return np.asarray(image.data).reshape(image.height, image.step)[:, :length]


def _check_least(name: str, width: int, height: int) -> None:
    if min(width, height) < LEAST_SIDE:
        raise CairnError(
            f"{name} has {width} x {height} pixels, too few to recognize anything: give one of at "
            f"least {LEAST_SIDE} x {LEAST_SIDE}."
        )


def write_picture(picture: Gray, file: Path) -> None:
    """Write an image; raise `CairnError` if that fails."""
    try:
        written = cv2.imwrite(str(file), picture)
    except cv2.error as error:
        raise CairnError(
            f"{file}: unknown picture format ({error.err}); use .png or .jpg"
        ) from error
    if not written:
        raise CairnError(f"{file}: cannot be written; check that the folder exists and is writable")
