"""What a sensor makes of light: blur, brightness, falloff to the corners, noise, saturation."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled

Float32 = NDArray[np.float32]
Gray = NDArray[np.uint8]

# So many normal numbers are drawn once; each row of an image takes them from a place of its own.
_NORMALS = 1 << 20


@dataclass(frozen=True)
class Noise:
    """Standard deviation of reading [gray levels], and variance per gray level of light."""

    read: float
    shot: float


class Film:
    """Turns light into gray levels; all randomness is that of `random`."""

    def __init__(self, width: int, height: int, random: np.random.Generator) -> None:
        self._random = random
        self._normals = random.standard_normal(_NORMALS, np.float32)
        across = np.linspace(-1.0, 1.0, width)
        down = np.linspace(-1.0, 1.0, height) * height / width
        square = across**2 + down[:, None] ** 2
        self._off_axis = (square / square.max()).astype(np.float32)

    def exposed(self, light: Float32, brightness: float, vignetting: float, noise: Noise) -> Gray:
        """The image of `light` (h, w) times `brightness`; read-only.

        The corners get that much less light [1].
        """
        height, width = light.shape
        image = np.empty((height, width), np.uint8)
        begins = self._random.integers(0, _NORMALS - width, height)
        _expose(
            light,
            self._off_axis,
            np.float32(vignetting),
            np.float32(brightness),
            np.float32(noise.read**2),
            np.float32(noise.shot),
            self._normals,
            begins,
            image,
        )
        image.flags.writeable = False
        return image


def blurred(light: Float32, defocus: float, motion: float) -> Float32:
    """Light (h, w) out of focus by a deviation `defocus`, and moved across by `motion` [px]."""
    down = _gaussian(defocus)
    across = np.convolve(down, _box(motion))
    if across.size == 1:
        return light
    border = cv2.BORDER_REPLICATE
    return np.asarray(cv2.sepFilter2D(light, -1, across, down, borderType=border), np.float32)


def _gaussian(deviation: float) -> Float32:
    if deviation < 0.05:
        return np.ones(1, np.float32)
    reach = int(np.ceil(3.0 * deviation))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / deviation) ** 2)
    return np.asarray(weights / weights.sum(), np.float32)


def _box(width: float) -> Float32:
    """Weights of pixels under a box of that width [px], not only a whole one."""
    if width < 0.05:
        return np.ones(1, np.float32)
    half = 0.5 * width
    reach = int(np.ceil(half + 0.5)) - 1
    pixels = np.arange(-reach, reach + 1)
    weights = np.minimum(pixels + 0.5, half) - np.maximum(pixels - 0.5, -half)
    return np.asarray(weights / weights.sum(), np.float32)


@compiled(
    "void(float32[:, ::1], float32[:, ::1], float32, float32, float32, float32, float32[::1],"
    " int64[::1], uint8[:, ::1])"
)
def _expose(
    light: Float32,
    off_axis: Float32,
    vignetting: np.float32,
    brightness: np.float32,
    read: np.float32,
    shot: np.float32,
    normals: Float32,
    begins: NDArray[np.int64],
    image: Gray,
) -> None:
    black, white, half = np.float32(0.0), np.float32(255.0), np.float32(0.5)
    for r in range(light.shape[0]):
        begin = begins[r]
        for c in range(light.shape[1]):
            gray = brightness * light[r, c] * (np.float32(1.0) - vignetting * off_axis[r, c])
            gray += np.sqrt(read + shot * gray) * normals[begin + c]
            image[r, c] = np.uint8(min(max(gray, black), white) + half)
