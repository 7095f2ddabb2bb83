"""The rows of the tables of taught objects, and what they stand for."""

from __future__ import annotations

import math
from io import BytesIO
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as Picture

from cairn.vision.checksum import check, checksum
from cairn.vision.features import DESCRIPTOR, Features
from cairn.vision.taught import View

Row = tuple[Any, ...]

MOST_ID: Final = 2**32 - 1  # as a message can carry

# Numbers lie in the file as they do in memory, little-endian.
_NUMBER: Final = np.dtype("<f4")
_MOST_SIDE: Final = 2**15 - 1  # [px], as OpenCV can transform


def view_row(object_id: int, view: View) -> Row:
    """The row of table `taught_views`, without its number."""
    features = view.features
    seen = (
        object_id,
        view.width,
        view.height,
        features.points.astype(_NUMBER).tobytes(),
        features.scales.astype(_NUMBER).tobytes(),
        features.angles.astype(_NUMBER).tobytes(),
        features.descriptors.tobytes(),
    )
    return (*seen, cv2.imencode(".png", view.picture)[1].tobytes(), checksum(seen))


def view_from_row(row: Row, with_picture: bool) -> View:
    """The view of a row as `view_row` made it; raises `ValueError` if it is none."""
    width, height = (_side(value) for value in row[1:3])
    features = _features(*row[3:7])
    beyond = (features.points < -0.5) | (features.points > (width - 0.5, height - 0.5))
    if beyond.any():
        raise ValueError("a feature lies outside of its picture")
    picture = _picture(row[7], width, height) if with_picture else np.zeros((0, 0), np.uint8)
    check(row[:7], row[8])
    return View(width, height, features, picture)


def size_from_row(width: Any, height: Any) -> tuple[float, float] | None:
    """An object's size [m]; raises `ValueError` if it is none that an object can have."""
    if width is None and height is None:
        return None
    size = float(width or 0), float(height or 0)
    if not all(math.isfinite(side) and side > 0 for side in size):
        raise ValueError(f"its size {width} x {height} is not above 0 m")
    return size


def _features(points: Any, scales: Any, angles: Any, descriptors: Any) -> Features:
    number = len(_bytes(scales, None, "scales")) // _NUMBER.itemsize
    found = Features(
        np.frombuffer(_bytes(points, 8 * number, "points"), _NUMBER).reshape(number, 2),
        np.frombuffer(_bytes(scales, 4 * number, "scales"), _NUMBER),
        np.frombuffer(_bytes(angles, 4 * number, "angles"), _NUMBER),
        np.frombuffer(_bytes(descriptors, DESCRIPTOR * number, "descriptors"), np.uint8).reshape(
            number, DESCRIPTOR
        ),
    )
    if not (
        np.isfinite(found.points).all()
        and np.isfinite(found.angles).all()
        and np.isfinite(found.scales).all()
        and (found.scales > 0).all()
    ):
        raise ValueError("a feature's place, size or direction is no number")
    return found


def _bytes(value: Any, length: int | None, what: str) -> bytes:
    if not isinstance(value, bytes) or (length is not None and len(value) != length):
        held = f"{len(value)} bytes" if isinstance(value, bytes) else type(value).__name__
        raise ValueError(f"its {what} are {held} instead of {length} bytes")
    return value


def _picture(value: Any, width: int, height: int) -> NDArray[np.uint8]:
    data = _bytes(value, None, "pixels")
    try:
        # OpenCV would write of its own to the terminal what is wrong with it.
        with Picture.open(BytesIO(data), formats=["PNG"]) as png:
            picture = np.asarray(png.convert("L"), np.uint8)
    except (OSError, SyntaxError) as error:
        raise ValueError("its picture is no PNG image") from error
    if picture.shape != (height, width):
        raise ValueError(f"its picture is no PNG image of {width} x {height} pixels")
    return picture


def _side(value: Any) -> int:
    if not isinstance(value, int) or not 1 <= value <= _MOST_SIDE:
        raise ValueError(f"a side of {value} pixels is not from 1 to {_MOST_SIDE}")
    return value
