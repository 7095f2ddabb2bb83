"""Two cameras calibrated together: where the right one is, and how both are rectified."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.errors import CairnError
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.vision.calibration import FEWEST, USELESS_PX, Calibration, calibrate, described
from cairn.vision.chessboard import Board, in_order_of

Array = NDArray[np.float64]

# A pair is left out if its error [px] is above this, and above this many times the median's.
_BAD_PX, _BAD_TIMES = 1.0, 3.0
_LARGE_ERROR = 1.0


@dataclass(frozen=True)
class StereoCalibration:
    """Two cameras, and `rotation` (3, 3) and `translation` (3,) [m] from the left to the right.

    `rms` [px] is over all corners in both images of all pairs; `errors` of each pair [px] by the
    name of its left image. `left_out` are pairs that did not fit, with their errors [px].
    """

    left: Calibration
    right: Calibration
    rotation: Array
    translation: Array
    rms: float
    errors: Mapping[str, float]
    left_out: Mapping[str, float]

    @property
    def baseline(self) -> float:
        """How far the cameras are apart [m]."""
        return float(np.linalg.norm(self.translation))

    def doubts(self) -> list[str]:
        """Why this calibration may be worse than its error says: sentences with a remedy."""
        told = [f"left: {doubt}" for doubt in self.left.doubts()]
        told += [f"right: {doubt}" for doubt in self.right.doubts()]
        if self.rms > _LARGE_ERROR:
            told.append(
                f"the pairs' error of {self.rms:.2f} px is large: were both images of each pair "
                "taken at the same moment, and did the cameras stay where they are?"
            )
        return told


def calibrate_pair(
    left: Mapping[str, Array],
    right: Mapping[str, Array],
    pairs: Mapping[str, str],
    size: tuple[int, int],
    board: Board,
) -> StereoCalibration:
    """Both cameras from the corners (n, 2) [px] of each image, by its name.

    `pairs` names the right image of each left one. Each camera is calibrated by all of its images,
    and then their places to each other by the pairs of which both images are usable. Raises
    `CairnError` as `calibrate`, and if left and right are swapped or above each other.
    """
    cameras = calibrate(left, size, board), calibrate(right, size, board)
    usable = {a: b for a, b in pairs.items() if a in cameras[0].corners and b in cameras[1].corners}
    left_out: dict[str, float] = {}
    while True:
        if len(usable) < FEWEST:
            raise CairnError(
                f"{len(usable)} pair{'' if len(usable) == 1 else 's'} of which both images show "
                f"the board: a calibration needs {FEWEST} at least, and 10 to be good"
            )
        found = _placed(cameras[0], cameras[1], usable, left_out)
        worst = max(found.errors, key=found.errors.__getitem__)
        limit = _BAD_TIMES * float(np.median(list(found.errors.values())))
        if found.errors[worst] <= max(_BAD_PX, limit):
            break
        left_out[worst] = found.errors[worst]
        del usable[worst]
    if found.rms > USELESS_PX:
        raise CairnError(
            f"an error of {found.rms:.1f} px of the pairs is no calibration: were both images of "
            "each pair taken at the same moment, and are they named the same?"
        )
    x, y, _ = found.translation
    if abs(x) < abs(y):
        raise CairnError(
            f"the right camera is {abs(y):.3f} m above or below the left one, but {abs(x):.3f} m "
            "beside it: only cameras side by side are supported; mount or turn them so"
        )
    if x > 0:
        raise CairnError(
            f"left and right are swapped: the right camera is {x:.3f} m to the left of the left "
            "one; swap the images"
        )
    return found


def camera_infos(found: StereoCalibration, names: tuple[str, str]) -> tuple[CameraInfo, CameraInfo]:
    """The calibrations of both cameras.

    Rectified images keep their size and hold valid pixels only (alpha 0); what is infinitely far
    is at the same place in both.
    """
    turn_left, turn_right, project_left, project_right, *_ = cv2.stereoRectify(
        found.left.intrinsics,
        found.left.distortion,
        found.right.intrinsics,
        found.right.distortion,
        found.left.size,
        found.rotation,
        found.translation.reshape(3, 1),
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=0.0,
    )
    return (
        described(found.left, names[0], np.asarray(turn_left), np.asarray(project_left)),
        described(found.right, names[1], np.asarray(turn_right), np.asarray(project_right)),
    )


def _placed(
    left: Calibration, right: Calibration, pairs: Mapping[str, str], left_out: Mapping[str, float]
) -> StereoCalibration:
    model = left.board.points.astype(np.float32)
    seen = [left.corners[name].astype(np.float32) for name in pairs]
    beside = [
        in_order_of(right.corners[b], left.corners[a], left.board).astype(np.float32)
        for a, b in pairs.items()
    ]
    rms, _, _, _, _, rotation, translation, _, _, _, _, each = cv2.stereoCalibrateExtended(
        [model] * len(seen),
        seen,
        beside,
        left.intrinsics,
        left.distortion,
        right.intrinsics,
        right.distortion,
        left.size,
        np.eye(3),
        np.zeros(3),
        flags=cv2.CALIB_FIX_INTRINSIC,
    )
    errors = {
        name: math.sqrt(float(np.mean(np.square(of)))) for name, of in zip(pairs, each, strict=True)
    }
    return StereoCalibration(
        left,
        right,
        np.asarray(rotation, np.float64),
        np.asarray(translation, np.float64).ravel(),
        float(rms),
        errors,
        dict(left_out),
    )
