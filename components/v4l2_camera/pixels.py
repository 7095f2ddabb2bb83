"""From a camera's bytes to gray pixels, and which of them are no whole picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import simplejpeg
from numpy.typing import NDArray

Gray = NDArray[np.uint8]

FORMATS: Final = ("GREY", "YUYV", "MJPG")
"""Pixel formats that are understood, the one that is preferred first: exact and light before
compressed."""

_BYTES_PER_PIXEL: Final = {"GREY": 1, "YUYV": 2}
_BEGIN, _END = b"\xff\xd8", b"\xff\xd9"  # of a JPEG picture (ITU-T T.81, table B.1: SOI, EOI)


class NoPicture(Exception):  # noqa: N818 - what a buffer holds, not a failure of the program
    """A buffer that holds no whole picture; the text says why."""


class ShortPicture(NoPicture):
    """Fewer bytes came than a picture has."""


class DamagedPicture(NoPicture):
    """The bytes of a compressed picture are not those of a whole one."""


@dataclass(frozen=True)
class PictureLayout:
    """How a camera lays out its pictures: size [px], pixel format, bytes from row to row."""

    width: int
    height: int
    format: str
    bytes_per_row: int = 0

    def __str__(self) -> str:
        return f"{self.format} {self.width} x {self.height}"

    def gray(self, data: bytes) -> Gray:
        """The picture in a buffer's bytes as gray levels (height, width), in memory of its own.

        Of YUYV that is Y, of MJPG the decoded Y: no conversion of colors is made, so that values
        are the camera's own. Raises `ShortPicture` or `DamagedPicture`.
        """
        if self.format == "MJPG":
            return self._decoded(data)
        pixel = _BYTES_PER_PIXEL[self.format]
        row = max(self.bytes_per_row, self.width * pixel)
        # The last row may end where its pixels do.
        whole = row * (self.height - 1) + self.width * pixel
        if len(data) < whole:
            raise ShortPicture(f"{len(data)} bytes of {whole}")
        taken = np.empty((self.height, self.width), np.uint8)
        strides = (row, pixel)
        taken[:] = np.ndarray((self.height, self.width), np.uint8, data, 0, strides)
        return taken

    def _decoded(self, data: bytes) -> Gray:
        if not data.startswith(_BEGIN):
            raise DamagedPicture(f"it begins with {data[:2].hex() or 'nothing'}, not with ffd8")
        end = data.rfind(_END)
        if end < 0:
            raise ShortPicture(f"no end (ffd9) in {len(data)} bytes")
        # What follows the end is left of a former picture, or fills up a USB packet.
        whole = data[: end + len(_END)]
        try:
            # Before it is decoded: a damaged size can be one of gigabytes.
            height, width, *_ = simplejpeg.decode_jpeg_header(whole)
            if (width, height) != (self.width, self.height):
                raise DamagedPicture(
                    f"it is {width} x {height} pixels, not {self.width} x {self.height}"
                )
            pixels = simplejpeg.decode_jpeg(whole, colorspace="GRAY", strict=True)
        except (ValueError, KeyError) as error:  # the latter by a sampling that it does not know
            raise DamagedPicture(str(error)) from error
        gray: Gray = pixels[:, :, 0]
        return gray


def halves(gray: Gray) -> tuple[Gray, Gray]:
    """The left and the right half (h, w / 2) of a side-by-side picture, each in its own memory."""
    middle = gray.shape[1] // 2
    return np.ascontiguousarray(gray[:, :middle]), np.ascontiguousarray(gray[:, middle:])
