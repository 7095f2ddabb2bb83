"""Rectifies images: removes the lens's distortion and aligns the rows of a stereo pair."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.errors import CairnError
from cairn.schemas.sensor_msgs import CameraInfo

Array = NDArray[np.float64]
Gray = NDArray[np.uint8]

_FISHEYE: Final = "equidistant"
# Numbers of coefficients that OpenCV accepts for each of ROS's models
# (sensor_msgs/distortion_models.hpp).
_COEFFICIENTS: Final = {
    "plumb_bob": (0, 4, 5),
    "rational_polynomial": (0, 8, 12, 14),
    _FISHEYE: (4,),
}
# Smaller displacements of pixels are ignored [px].
_NEGLIGIBLE = 1e-3


@dataclass(frozen=True)
class CameraModel:
    """A calibrated camera as matrices.

    `intrinsics` K (3, 3) and `distortion` (n,) of the raw image; `rotation` R (3, 3) from the
    camera to the rectified camera; `projection` P (3, 4) of the rectified image.
    """

    width: int
    height: int
    intrinsics: Array
    distortion: Array
    fisheye: bool
    rotation: Array
    projection: Array

    @classmethod
    def of(cls, info: CameraInfo) -> CameraModel:
        """Return the camera of `info`; raise `CairnError` if that is not a valid calibration."""
        name = info.header.frame_id or "camera"
        if not is_calibrated(info):
            raise CairnError(
                f"{name}: its CameraInfo has no calibration (k, width or height is 0); calibrate "
                "the camera with `cairn camera calibrate` and give the file to its driver"
            )
        _check_whole(info, name)
        model = info.distortion_model
        known = _COEFFICIENTS.get(model)
        if known is None and (model or info.d.any()):
            raise CairnError(
                f"{name}: distortion_model = {model!r} is not supported; calibrate it with one of "
                f"{', '.join(_COEFFICIENTS)}"
            )
        if known is not None and info.d.size not in known:
            raise CairnError(
                f"{name}: d has {info.d.size} coefficients, but {model} has "
                f"{' or '.join(str(n) for n in known if n)}; calibrate the camera again"
            )
        # Drivers of rectified images may fill p alone.
        intrinsics = info.k.reshape(3, 3) if info.k.any() else info.p.reshape(3, 4)[:, :3]
        # Drivers of single cameras may fill k and d alone.
        rotation = info.r.reshape(3, 3) if info.r.any() else np.eye(3)
        projection = info.p.reshape(3, 4)
        if not info.p.any():
            projection = np.column_stack((intrinsics, np.zeros(3)))
        for key, matrix in (("k", intrinsics), ("p", projection)):
            if matrix[0, 0] <= 0 or matrix[1, 1] <= 0 or not np.allclose(matrix[2, :3], (0, 0, 1)):
                raise CairnError(
                    f"{name}: {key} = {matrix.ravel().tolist()} is not a camera matrix: its focal "
                    "lengths must be above 0 and its last row 0 0 1; calibrate the camera again"
                )
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3) or (
            np.linalg.det(rotation) < 0
        ):
            raise CairnError(
                f"{name}: r = {rotation.ravel().tolist()} is not a rotation; for a single camera "
                "it is 1 0 0 0 1 0 0 0 1"
            )
        return cls(
            info.width, info.height, intrinsics, info.d, model == _FISHEYE, rotation, projection
        )

    def maps(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return x and y [px] in the raw image for each pixel of the rectified image."""
        make = cv2.fisheye.initUndistortRectifyMap if self.fisheye else cv2.initUndistortRectifyMap
        x, y = make(
            self.intrinsics,
            self._d(),
            self.rotation,
            self.projection[:, :3],
            (self.width, self.height),
            cv2.CV_32FC1,
        )
        return np.asarray(x, np.float32), np.asarray(y, np.float32)

    def _d(self) -> Array:
        d: Array = self.distortion.reshape(-1, 1) if self.distortion.size else np.zeros((4, 1))
        return d


class Rectifier:
    """Rectifies the images of one camera; rectified images are returned unchanged."""

    def __init__(self, info: CameraInfo) -> None:
        """Prepare for images of the camera of `info`; raise `CairnError` as `CameraModel.of`."""
        self._name = info.header.frame_id or "camera"
        self._size = (info.height, info.width)
        x, y = CameraModel.of(info).maps()
        columns, rows = np.meshgrid(np.arange(info.width), np.arange(info.height))
        moves = max(np.abs(x - columns).max(), np.abs(y - rows).max())
        self._maps = cv2.convertMaps(x, y, cv2.CV_16SC2) if moves > _NEGLIGIBLE else None

    def apply(self, gray: Gray) -> Gray:
        """Return the rectified image (h, w), black outside of the camera's view.

        Raises `CairnError` if the image does not have the size of the calibration.
        """
        if gray.shape != self._size:
            raise CairnError(
                f"{self._name}: the image is {gray.shape[1]} x {gray.shape[0]} pixels, but its "
                f"CameraInfo is of {self._size[1]} x {self._size[0]}; calibrate the camera at the "
                "size that its driver sends, or set the driver to that size"
            )
        if self._maps is None:
            return gray
        return np.asarray(cv2.remap(gray, *self._maps, cv2.INTER_LINEAR), np.uint8)


def is_calibrated(info: CameraInfo) -> bool:
    """Return whether `info` has a calibration: drivers of uncalibrated cameras leave it zero."""
    is_rectified = info.p.any() and not info.d.any()
    return bool((info.k.any() or is_rectified) and info.width and info.height)


def _check_whole(info: CameraInfo, name: str) -> None:
    """Raise `CairnError` unless `info` is of whole, unbinned images: calibrations are of those."""
    if info.binning_x > 1 or info.binning_y > 1:
        raise CairnError(
            f"{name}: binning of {info.binning_x} x {info.binning_y} is not supported; switch it "
            "off in the camera's driver, and calibrate the camera without it"
        )
    roi = info.roi
    parts = (roi.x_offset, roi.y_offset, roi.width, roi.height)
    if any(parts) and parts != (0, 0, info.width, info.height):
        raise CairnError(
            f"{name}: a region of interest of {roi.width} x {roi.height} pixels at "
            f"({roi.x_offset}, {roi.y_offset}) is not supported; set the driver to send whole "
            "images"
        )
