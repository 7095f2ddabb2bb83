"""Pictures of what a camera sees: those on objects, and the weak pattern of all other surfaces."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.vision.images import read_image

Gray = NDArray[np.uint8]

# The longer side of a picture on an object [px]: half a meter at half a meter shows no more.
LONGEST_PX = 640
_DRAWN_PX = 400
# The pattern of surfaces: a square that repeats [texels], and how much its brightness varies [1].
PATTERN_TEXELS = 256
_PATTERN_SD = 0.04
_PATTERN_SEED = 1


def picture_of(texture: str | Path, object_id: int, size: tuple[float, float]) -> Gray:
    """The picture (h, w) on an object of that size [m]: the file `texture`, or drawn if it is "".

    Raises `CairnError` if the file cannot be read as a picture.
    """
    return read_picture(Path(texture)) if str(texture) else drawn_picture(object_id, size)


def read_picture(file: Path) -> Gray:
    """A picture in gray, at most `LONGEST_PX` long; `CairnError` if the file is none."""
    found = read_image(file)
    shrink = min(1.0, LONGEST_PX / max(found.shape))
    if shrink == 1.0:
        return found
    smaller = [max(1, round(shrink * side)) for side in found.shape[::-1]]
    return np.asarray(cv2.resize(found, smaller, interpolation=cv2.INTER_AREA), np.uint8)


def drawn_picture(object_id: int, size: tuple[float, float]) -> Gray:
    """A picture full of corners and blobs of all sizes: another for each id, always the same."""
    scale = _DRAWN_PX / max(size)
    width, height = (max(16, round(side * scale)) for side in size)
    random = np.random.default_rng(object_id)
    picture = np.full((height, width), int(random.integers(60, 200)), np.uint8)
    for part in np.geomspace(0.5, 0.03, 220).tolist():
        _draw_shape(picture, part * min(width, height), random)
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.7), np.uint8)


def _draw_shape(picture: Gray, extent: float, random: np.random.Generator) -> None:
    """Somewhere a polygon, an ellipse or some lines of about that extent [px]."""
    height, width = picture.shape
    middle = random.uniform((0, 0), (width, height))
    gray = int(random.integers(5, 251))
    kind = int(random.integers(3))
    if kind == 0:
        corners = int(random.integers(3, 7))
        angles = np.sort(random.uniform(0, 2 * np.pi, corners))
        reach = extent * random.uniform(0.3, 0.7, corners)
        points = middle + reach[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))
        cv2.fillPoly(picture, [np.round(points * 16).astype(np.int32)], gray, cv2.LINE_AA, 4)
    elif kind == 1:
        axes = extent * random.uniform(0.15, 0.5, 2)
        turn = float(random.uniform(0, 180))
        box = (middle.tolist(), (2 * axes).tolist(), turn)
        cv2.ellipse(picture, box, gray, -1, cv2.LINE_AA)
    else:
        for _ in range(3):
            ends = middle + extent * random.uniform(-0.5, 0.5, (2, 2))
            first, last = (tuple(end) for end in np.round(ends).astype(int).tolist())
            thick = max(1, round(0.08 * extent))
            cv2.line(picture, first, last, gray, thick, cv2.LINE_AA)


def surface_pattern() -> NDArray[np.float32]:
    """A square that repeats without seams: about 1, with weak blotches of all sizes."""
    white = np.random.default_rng(_PATTERN_SEED).standard_normal((PATTERN_TEXELS, PATTERN_TEXELS))
    frequency = np.fft.fftfreq(PATTERN_TEXELS)
    steps = np.maximum(np.hypot(frequency[:, None], frequency), 8 / PATTERN_TEXELS)
    blotches = np.fft.ifft2(np.fft.fft2(white) / steps).real
    blotches -= blotches.mean()
    return np.asarray(1.0 + _PATTERN_SD * blotches / blotches.std(), np.float32)
