"""Textures: pictures on objects, the pattern of all other surfaces, and their lookup tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.vision.images import read_image

Gray = NDArray[np.uint8]

# Longer side of a picture on an object [px]: a camera 0.5 m from a 0.5 m picture shows no more.
LONGEST_PX = 640
_DRAWN_PX = 400
# The repeating square pattern of surfaces: its size [texels] and its brightness variation [1].
PATTERN_TEXELS = 256
_PATTERN_SD = 0.04
_PATTERN_SEED = 1


def object_picture(texture: str | Path, object_id: int, size: tuple[float, float]) -> Gray:
    """Return the picture (h, w) on an object of that size [m]: from a file, or drawn if it is "".

    Raises `CairnError` if the file cannot be read as a picture.
    """
    return read_picture(Path(texture)) if str(texture) else drawn_picture(object_id, size)


def read_picture(file: Path) -> Gray:
    """Read a gray picture, reduced to at most `LONGEST_PX`; `CairnError` if that fails."""
    found = read_image(file)
    shrink = min(1.0, LONGEST_PX / max(found.shape))
    if shrink == 1.0:
        return found
    smaller = [max(1, round(shrink * side)) for side in found.shape[::-1]]
    return np.asarray(cv2.resize(found, smaller, interpolation=cv2.INTER_AREA), np.uint8)


def drawn_picture(object_id: int, size: tuple[float, float]) -> Gray:
    """Draw a picture with corners and blobs of all sizes, reproducible, different per id."""
    scale = _DRAWN_PX / max(size)
    width, height = (max(16, round(side * scale)) for side in size)
    random = np.random.default_rng(object_id)
    picture = np.full((height, width), int(random.integers(60, 200)), np.uint8)
    for part in np.geomspace(0.5, 0.03, 220).tolist():
        _draw_shape(picture, part * min(width, height), random)
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.7), np.uint8)


def _draw_shape(picture: Gray, extent: float, random: np.random.Generator) -> None:
    """Draw a polygon, an ellipse or some lines of about that extent [px] at a random position."""
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
    """Return a seamless square pattern of mean 1 with weak blotches of all sizes."""
    white = np.random.default_rng(_PATTERN_SEED).standard_normal((PATTERN_TEXELS, PATTERN_TEXELS))
    frequency = np.fft.fftfreq(PATTERN_TEXELS)
    steps = np.maximum(np.hypot(frequency[:, None], frequency), 8 / PATTERN_TEXELS)
    blotches = np.fft.ifft2(np.fft.fft2(white) / steps).real
    blotches -= blotches.mean()
    return np.asarray(1.0 + _PATTERN_SD * blotches / blotches.std(), np.float32)


Float32 = NDArray[np.float32]

# Texture 0 is the repeating pattern of surfaces.
PATTERN = 0
# Size of one of its texels [m].
TEXEL_M = 0.02


@dataclass(frozen=True)
class TextureAtlas:
    """Textures side by side, as sums from which the mean of any strip follows.

    Texture k has `shapes[k]` = width, height [texels]. Its sums along x from the left, column by
    column (width + 1, height), start at `begins[k]` of `sums`; the mean over any part of a row is a
    difference of two of them. The pattern is stored twice as wide, so that a part may cross its
    seam. `levels` has the pattern again, halved repeatedly, for planes seen at a flat angle: level
    k is square and starts at `level_begins[k]`.
    """

    sums: Float32
    begins: NDArray[np.int64]
    shapes: NDArray[np.int64]
    levels: Float32
    level_begins: NDArray[np.int64]

    @staticmethod
    def of(pictures: Sequence[NDArray[np.uint8]]) -> TextureAtlas:
        """Return the atlas of the pattern, and of pictures (h, w) as textures 1, 2, ..."""
        pattern = surface_pattern()
        parts = [_sums(np.hstack((pattern, pattern))), *(_sums(one) for one in pictures)]
        begins = np.cumsum([0, *(part.size for part in parts[:-1])])
        shapes = [pattern.shape[::-1], *(one.shape[::-1] for one in pictures)]
        levels = [pattern]
        while len(levels[-1]) > 1:
            half = len(levels[-1]) // 2
            halved = cv2.resize(levels[-1], (half, half), interpolation=cv2.INTER_AREA)
            levels.append(np.asarray(halved, np.float32))
        sizes = [level.size for level in levels[:-1]]
        return TextureAtlas(
            np.concatenate([part.ravel() for part in parts]),
            begins.astype(np.int64),
            np.array(shapes, np.int64),
            np.concatenate([level.ravel() for level in levels]),
            np.cumsum([0, *sizes]).astype(np.int64),
        )


def _sums(picture: NDArray[np.uint8] | Float32) -> Float32:
    """Return the sums (w + 1, h) of all columns to the left of each."""
    sums = np.zeros((picture.shape[1] + 1, picture.shape[0]))
    np.cumsum(picture.T.astype(np.float64), axis=0, out=sums[1:])
    return sums.astype(np.float32)
