"""Optics of a simulated camera: pinhole geometry, lens distortion, blur, exposure and noise."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn import CairnError
from cairn.planar.compiled import compiled
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.schemas.std_msgs import Header

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]

# A distortion is rejected if the undistorted image would need to be this many times as wide or
# high.
_WIDEST = 3.0


@dataclass(frozen=True)
class PinholeCamera:
    """An ideal camera: size of the image, focal length and principal point [px].

    Pixel (0, 0) is the center of the top left pixel.
    """

    width: int
    height: int
    focal: float
    cx: float
    cy: float

    @staticmethod
    def of(width: int, height: int, field_of_view: float) -> PinholeCamera:
        """Return a camera with this horizontal field of view [rad], centered on its axis."""
        focal = 0.5 * width / math.tan(0.5 * field_of_view)
        return PinholeCamera(width, height, focal, 0.5 * (width - 1), 0.5 * (height - 1))

    @property
    def matrix(self) -> Array:
        """Return the intrinsic matrix (3, 3)."""
        return np.array([[self.focal, 0.0, self.cx], [0.0, self.focal, self.cy], [0.0, 0.0, 1.0]])


class LensDistortion:
    """Distort an ideal image as a real lens does: plumb_bob, k1, k2, p1, p2, k3.

    `ideal` is the camera whose image covers all that the distorted one of `lens` shows. Raises
    `CairnError` if the coefficients fold the image.
    """

    def __init__(self, lens: PinholeCamera, coefficients: Sequence[float]) -> None:
        self.ideal = lens
        self._maps: tuple[Float32, Float32] | None = None
        if not any(coefficients):
            return
        down, across = np.mgrid[: lens.height, : lens.width].astype(np.float64)
        pixels = np.stack((across.ravel(), down.ravel()), axis=1)
        five = _five(coefficients)
        until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-7)
        rays = cv2.undistortPoints(pixels[:, None], lens.matrix, five, criteria=until)
        rays = rays.reshape(-1, 2)
        solid = np.column_stack((rays, np.ones(len(rays))))
        projected, _ = cv2.projectPoints(solid, np.zeros(3), np.zeros(3), lens.matrix, five)
        error = np.abs(projected.reshape(-1, 2) - pixels).max()
        extent = 2.0 * np.abs(rays).max(axis=0) * lens.focal / (lens.width, lens.height)
        if not error < 0.1 or extent.max() > _WIDEST:
            raise CairnError(
                f"distortion = {list(coefficients)} folds or tears the image; choose "
                "smaller coefficients"
            )
        left, top = np.floor(rays.min(axis=0) * lens.focal).astype(int) - 2
        right, bottom = np.ceil(rays.max(axis=0) * lens.focal).astype(int) + 2
        self.ideal = replace(
            lens,
            width=int(right - left + 1),
            height=int(bottom - top + 1),
            cx=float(-left),
            cy=float(-top),
        )
        drawn = (lens.focal * rays - (left, top)).astype(np.float32)
        shape = (lens.height, lens.width)
        self._maps = (drawn[:, 0].reshape(shape).copy(), drawn[:, 1].reshape(shape).copy())

    def distorted(self, image: Float32) -> Float32:
        """Return the distorted image of `lens` from the image of `ideal`."""
        if self._maps is None:
            return image
        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_CUBIC), np.float32)


def camera_info(
    lens: PinholeCamera, coefficients: Sequence[float], frame: str, right: float
) -> CameraInfo:
    """Return the calibration of a camera that is `right` [m] to the right of the left one."""
    projection = np.column_stack((lens.matrix, (-lens.focal * right, 0.0, 0.0)))
    return CameraInfo(
        header=Header(frame_id=frame),
        height=lens.height,
        width=lens.width,
        distortion_model="plumb_bob",
        d=_five(coefficients),
        k=lens.matrix.ravel(),
        r=np.eye(3).ravel(),
        p=projection.ravel(),
    )


def _five(coefficients: Sequence[float]) -> Array:
    return np.array([*coefficients, 0.0, 0.0, 0.0, 0.0, 0.0][:5])


Gray = NDArray[np.uint8]

# This many normal random numbers are drawn once; each image row starts at a random one of them.
_NORMALS = 1 << 20


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviation of the read noise [gray levels], shot noise variance per gray level."""

    read: float
    shot: float


class ImageSensor:
    """Convert light to gray levels; all random numbers come from `random`."""

    def __init__(self, width: int, height: int, random: np.random.Generator) -> None:
        self._random = random
        self._normals = random.standard_normal(_NORMALS, np.float32)
        across = np.linspace(-1.0, 1.0, width)
        down = np.linspace(-1.0, 1.0, height) * height / width
        square = across**2 + down[:, None] ** 2
        self._off_axis = (square / square.max()).astype(np.float32)

    def expose(
        self, light: Float32, brightness: float, vignetting: float, noise: SensorNoise
    ) -> Gray:
        """Return the image of `light` (h, w) times `brightness`, read-only.

        The corners get less light by the share `vignetting` [1].
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
    """Return light (h, w) blurred by a deviation `defocus` and by horizontal `motion` [px]."""
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
    """Return the weights of pixels under a box of that width [px], which need not be an integer."""
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
