"""The lens of a simulated camera: its geometry, distortion, and how ROS tells of both."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn import CairnError
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.schemas.std_msgs import Header

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]

# No distortion may need a drawn image so many times as wide or high.
_WIDEST = 3.0


@dataclass(frozen=True)
class Lens:
    """A pinhole: size of the image, focal length and principal point [px].

    Pixel (0, 0) is the middle of the top left pixel.
    """

    width: int
    height: int
    focal: float
    cx: float
    cy: float

    @staticmethod
    def of(width: int, height: int, field_of_view: float) -> Lens:
        """With that horizontal field of view [rad], its axis through the middle of the image."""
        focal = 0.5 * width / math.tan(0.5 * field_of_view)
        return Lens(width, height, focal, 0.5 * (width - 1), 0.5 * (height - 1))

    @property
    def matrix(self) -> Array:
        """The intrinsic matrix (3, 3)."""
        return np.array([[self.focal, 0.0, self.cx], [0.0, self.focal, self.cy], [0.0, 0.0, 1.0]])


class Distortion:
    """Bends an ideal image as a real lens does: plumb_bob, k1, k2, p1, p2, k3.

    `ideal` is the lens whose image has all that the bent one of `lens` shows. Raises `CairnError`
    if the coefficients fold the image.
    """

    def __init__(self, lens: Lens, coefficients: Sequence[float]) -> None:
        self.ideal = lens
        self._maps: tuple[Float32, Float32] | None = None
        if not any(coefficients):
            return
        down, across = np.mgrid[: lens.height, : lens.width].astype(np.float64)
        pixels = np.stack((across.ravel(), down.ravel()), axis=1)
        given = _five(coefficients)
        until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-7)
        rays = cv2.undistortPoints(pixels[:, None], lens.matrix, given, criteria=until)
        rays = rays.reshape(-1, 2)
        solid = np.column_stack((rays, np.ones(len(rays))))
        again, _ = cv2.projectPoints(solid, np.zeros(3), np.zeros(3), lens.matrix, given)
        off = np.abs(again.reshape(-1, 2) - pixels).max()
        extent = 2.0 * np.abs(rays).max(axis=0) * lens.focal / (lens.width, lens.height)
        if not off < 0.1 or extent.max() > _WIDEST:
            raise CairnError(
                f"distortion = {list(coefficients)} folds the image or tears it apart; choose "
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

    def bent(self, image: Float32) -> Float32:
        """The image of `lens` from that of `ideal`."""
        if self._maps is None:
            return image
        return np.asarray(cv2.remap(image, *self._maps, cv2.INTER_CUBIC), np.float32)


def camera_info(lens: Lens, coefficients: Sequence[float], frame: str, right: float) -> CameraInfo:
    """The calibration of a camera of a stereo pair, so far to the right of the left one [m]."""
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
