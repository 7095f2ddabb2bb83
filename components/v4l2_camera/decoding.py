"""Decoding of a camera's bytes (GREY, YUYV, MJPG) to gray pixels; incomplete ones are rejected."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import simplejpeg
from numpy.typing import NDArray

Gray = NDArray[np.uint8]

FORMATS: Final = ("GREY", "YUYV", "MJPG")
"""Pixel formats that can be decoded, by preference: exact and cheap ones before compressed ones."""

_BYTES_PER_PIXEL: Final = {"GREY": 1, "YUYV": 2}
_START, _END = b"\xff\xd8", b"\xff\xd9"  # of a JPEG image (ITU-T T.81, table B.1: SOI, EOI)


class InvalidImageError(Exception):
    """A buffer does not hold a whole image; the text says why."""


class ShortImageError(InvalidImageError):
    """A buffer holds fewer bytes than an image has."""


class DamagedImageError(InvalidImageError):
    """The bytes of a compressed image are damaged."""


@dataclass(frozen=True)
class ImageLayout:
    """How a camera lays out its images: size [px], pixel format, bytes from row to row."""

    width: int
    height: int
    format: str
    bytes_per_row: int = 0

    def __str__(self) -> str:
        return f"{self.format} {self.width} x {self.height}"

    def decode(self, data: bytes) -> Gray:
        """Decode the bytes of a buffer to gray levels (height, width), in memory of its own.

        Of YUYV that is Y, of MJPG the decoded Y: colors are not converted, so that values are the
        camera's own. Raises `ShortImageError` or `DamagedImageError`.
        """
        if self.format == "MJPG":
            return self._decode_jpeg(data)
        pixel = _BYTES_PER_PIXEL[self.format]
        row = max(self.bytes_per_row, self.width * pixel)
        # The last row may end with its last pixel.
        size = row * (self.height - 1) + self.width * pixel
        if len(data) < size:
            raise ShortImageError(f"{len(data)} bytes of {size}")
        gray = np.empty((self.height, self.width), np.uint8)
        strides = (row, pixel)
        gray[:] = np.ndarray((self.height, self.width), np.uint8, data, 0, strides)
        return gray

    def _decode_jpeg(self, data: bytes) -> Gray:
        if not data.startswith(_START):
            raise DamagedImageError(f"it starts with {data[:2].hex() or 'nothing'}, not with ffd8")
        end = data.rfind(_END)
        if end < 0:
            raise ShortImageError(f"no end (ffd9) in {len(data)} bytes")
        # What follows the end is a rest of an earlier image, or padding of a USB packet.
        jpeg = data[: end + len(_END)]
        try:
            # Checked before decoding: a damaged size can be one of gigabytes.
            height, width, *_ = simplejpeg.decode_jpeg_header(jpeg)
            if (width, height) != (self.width, self.height):
                raise DamagedImageError(
                    f"it is {width} x {height} pixels, not {self.width} x {self.height}"
                )
            pixels = simplejpeg.decode_jpeg(jpeg, colorspace="GRAY", strict=True)
        except (ValueError, KeyError) as error:  # KeyError: a sampling that is not known
            raise DamagedImageError(str(error)) from error
        gray: Gray = pixels[:, :, 0]
        return gray


def split_side_by_side(gray: Gray) -> tuple[Gray, Gray]:
    """Return the left and the right half (h, w / 2) of an image, each in its own memory."""
    middle = gray.shape[1] // 2
    return np.ascontiguousarray(gray[:, :middle]), np.ascontiguousarray(gray[:, middle:])
