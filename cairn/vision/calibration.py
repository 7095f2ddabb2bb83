"""Calibrates a camera, or a stereo pair, from images of a chessboard.

Z. Zhang, A Flexible New Technique for Camera Calibration, PAMI 22(11), 2000. Distortion is ROS's
plumb_bob with k3 = 0, as in camera_calibration by default: boards seldom reach the corners of an
image, where a third coefficient would extrapolate wildly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.errors import CairnError
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.schemas.std_msgs import Header
from cairn.vision.chessboard import Board, reorder_like

Array = NDArray[np.float64]
Matrix = NDArray[np.integer | np.floating]  # as OpenCV returns it

FEWEST = 3
"""Fewest images of the board for a calibration."""

# An image or a pair is excluded if its error is above this [px], and above this multiple of the
# median error: then its corners were not found where they are.
_BAD_PX, _BAD_TIMES = 1.0, 3.0
# Images with errors above this [px], and above this multiple of the median, are used but reported.
_OUTLYING_PX, _OUTLYING_TIMES = 0.3, 2.0
# Relative standard deviation of the focal length above which a calibration is doubtful.
_VAGUE = 0.01
# Boards rotated less than this against each other [deg] count as one viewpoint.
_ONE_VIEW = 15.0
# Boards rotated less than this [deg] do not determine the focal length.
_UNTURNED = 5.0
# Least share of width and height that corners should cover: outside, distortion is extrapolated.
_COVERED = 0.5
# Corners of a flat board have smaller errors [px].
_LARGE_ERROR = 1.0

USELESS_PX = 5.0
"""Usual errors are tenths of a pixel; above this [px] the images were mixed up."""


@dataclass(frozen=True)
class Calibration:
    """The calibration of one camera.

    `intrinsics` K (3, 3), `distortion` (5,) k1 k2 p1 p2 k3, `rms` [px] over all corners, and by the
    name of each image: `corners` (n, 2), `residuals` (n, 2: measured less projected) [px], and
    `poses`, the rotation vector (3,) and translation (3,) [m] of the board. `focal_deviation` [px]
    is the standard deviation of the less certain focal length. `excluded` are the images that did
    not fit, with their errors [px].
    """

    board: Board
    size: tuple[int, int]
    intrinsics: Array
    distortion: Array
    rms: float
    focal_deviation: float
    corners: Mapping[str, Array]
    residuals: Mapping[str, Array]
    poses: Mapping[str, tuple[Array, Array]]
    excluded: Mapping[str, float]

    @property
    def errors(self) -> dict[str, float]:
        """Return the root mean square of the residuals of each image [px]."""
        return {
            name: math.sqrt(float(np.mean(np.sum(of**2, axis=1))))
            for name, of in self.residuals.items()
        }

    @property
    def outlying(self) -> dict[str, float]:
        """Return the images that fit much worse than the others, with their errors [px]."""
        errors = self.errors
        limit = max(_OUTLYING_PX, _OUTLYING_TIMES * float(np.median(list(errors.values()))))
        return {name: error for name, error in errors.items() if error > limit}

    @property
    def coverage(self) -> tuple[float, float]:
        """Return the shares of the image's width and height that corners cover."""
        corners = np.concatenate(list(self.corners.values()))
        wide, high = np.ptp(corners, axis=0) / np.array(self.size)
        return float(wide), float(high)

    def warnings(self) -> list[str]:
        """Return why this calibration may be worse than its error suggests, with remedies."""
        warnings = []
        focal = float(min(self.intrinsics[0, 0], self.intrinsics[1, 1]))
        rotated = _largest_rotation(self.poses)
        if rotated < _ONE_VIEW or self.focal_deviation > _VAGUE * focal:
            warnings.append(
                f"the focal length is {focal:.1f} +- {self.focal_deviation:.1f} px: the board was "
                f"rotated by at most {rotated:.0f} deg between images; take more images with the "
                "board rotated by 30 to 45 deg to every side"
            )
        wide, high = self.coverage
        if min(wide, high) < _COVERED:
            warnings.append(
                f"corners cover {100 * wide:.0f} % of the image's width and {100 * high:.0f} % of "
                "its height: distortion outside is extrapolated; hold the board into every corner"
            )
        if self.rms > _LARGE_ERROR:
            warnings.append(
                f"the error of {self.rms:.2f} px is large; check that the board is flat, images "
                "are sharp, and the lens is not a fisheye"
            )
        return warnings


def calibrate(corners: Mapping[str, Array], size: tuple[int, int], board: Board) -> Calibration:
    """Calibrate a camera by the board's `corners` (n, 2) [px], by the name of each image.

    `size` is the images' width and height [px]. Images that do not fit are excluded. Raises
    `CairnError` if there are too few images, or no camera explains them.
    """
    excluded: dict[str, float] = {}
    while True:
        if len(corners) < FEWEST:
            without = "".join(f", {name} excluded ({e:.1f} px)" for name, e in excluded.items())
            raise CairnError(
                f"{len(corners)} usable image{'' if len(corners) == 1 else 's'} of the board"
                f"{without}; a calibration needs at least {FEWEST}, and 10 to be good"
            )
        found = _solve(corners, size, board)
        errors = found.errors
        worst = max(errors, key=errors.__getitem__)
        if errors[worst] <= max(_BAD_PX, _BAD_TIMES * float(np.median(list(errors.values())))):
            break
        excluded[worst] = errors[worst]
        corners = {name: of for name, of in corners.items() if name != worst}
    rotated = _largest_rotation(found.poses)
    if rotated < _UNTURNED:
        raise CairnError(
            f"the board was rotated by at most {rotated:.0f} deg between images, which does not "
            "determine the focal length; take images with the board rotated by 30 to 45 deg to "
            "every side"
        )
    if found.rms > USELESS_PX:
        raise CairnError(
            f"the error of {found.rms:.1f} px is too large for a calibration; check that all "
            "images are of one camera, and of this board"
        )
    return replace(found, excluded=excluded)


def single_camera_info(found: Calibration, name: str) -> CameraInfo:
    """Return the CameraInfo of a single camera; rectification keeps valid pixels only (alpha 0)."""
    projection = np.zeros((3, 4))
    projection[:, :3], _ = cv2.getOptimalNewCameraMatrix(
        found.intrinsics, found.distortion, found.size, 0.0
    )
    return make_camera_info(found, name, np.eye(3), projection)


def make_camera_info(
    found: Calibration, name: str, rotation: Matrix, projection: Matrix
) -> CameraInfo:
    """Return a CameraInfo with rectification by `rotation` (3, 3) and `projection` (3, 4)."""
    return CameraInfo(
        header=Header(frame_id=name),
        width=found.size[0],
        height=found.size[1],
        distortion_model="plumb_bob",
        d=found.distortion,
        k=found.intrinsics.ravel(),
        r=rotation.astype(np.float64).ravel(),
        p=projection.astype(np.float64).ravel(),
    )


def _solve(corners: Mapping[str, Array], size: tuple[int, int], board: Board) -> Calibration:
    model = board.points.astype(np.float32)
    seen = [of.astype(np.float32) for of in corners.values()]
    try:
        rms, intrinsics, distortion, rotations, translations, deviations, *_ = (
            cv2.calibrateCameraExtended(
                [model] * len(seen), seen, size, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3
            )
        )
    except cv2.error as error:
        raise CairnError(f"no camera explains the corners of {', '.join(corners)}") from error
    if not np.isfinite(rms) or not np.isfinite(intrinsics).all():
        raise CairnError(f"no camera explains the corners of {', '.join(corners)}")
    residuals, poses = {}, {}
    for (name, points), rotation, translation in zip(
        corners.items(), rotations, translations, strict=True
    ):
        projected, _ = cv2.projectPoints(model, rotation, translation, intrinsics, distortion)
        residuals[name] = points - projected.reshape(-1, 2)
        poses[name] = (rotation.ravel().astype(np.float64), translation.ravel().astype(np.float64))
    return Calibration(
        board,
        size,
        np.asarray(intrinsics, np.float64),
        np.asarray(distortion, np.float64).ravel(),
        float(rms),
        float(np.max(deviations[:2])),
        dict(corners),
        residuals,
        poses,
        {},
    )


def _largest_rotation(poses: Mapping[str, tuple[Array, Array]]) -> float:
    """Return the largest angle [deg] between any two boards' planes."""
    normals = np.array([cv2.Rodrigues(rotation)[0][:, 2] for rotation, _ in poses.values()])
    return math.degrees(math.acos(float(np.clip((normals @ normals.T).min(), -1.0, 1.0))))


@dataclass(frozen=True)
class StereoCalibration:
    """Two cameras, and `rotation` (3, 3) and `translation` (3,) [m] from the left to the right.

    `rms` [px] is over all corners in both images of all pairs; `errors` [px] are those of each pair
    by the name of its left image. `excluded` are the pairs that did not fit, with their errors.
    """

    left: Calibration
    right: Calibration
    rotation: Array
    translation: Array
    rms: float
    errors: Mapping[str, float]
    excluded: Mapping[str, float]

    @property
    def baseline(self) -> float:
        """Return the distance of the cameras [m]."""
        return float(np.linalg.norm(self.translation))

    def warnings(self) -> list[str]:
        """Return why this calibration may be worse than its error suggests, with remedies."""
        warnings = [f"left: {warning}" for warning in self.left.warnings()]
        warnings += [f"right: {warning}" for warning in self.right.warnings()]
        if self.rms > _LARGE_ERROR:
            warnings.append(
                f"the pairs' error of {self.rms:.2f} px is large; check that both images of each "
                "pair were taken at the same time, and that the cameras did not move"
            )
        return warnings


def calibrate_pair(
    left: Mapping[str, Array],
    right: Mapping[str, Array],
    pairs: Mapping[str, str],
    size: tuple[int, int],
    board: Board,
) -> StereoCalibration:
    """Calibrate two cameras by the corners (n, 2) [px] of each image, by its name.

    `pairs` maps each left image to its right one. Each camera is calibrated with all of its images,
    then their relative pose with the pairs of which both images are usable. Raises `CairnError` as
    `calibrate`, and if the cameras are swapped or above each other.
    """
    cameras = calibrate(left, size, board), calibrate(right, size, board)
    usable = {a: b for a, b in pairs.items() if a in cameras[0].corners and b in cameras[1].corners}
    excluded: dict[str, float] = {}
    while True:
        if len(usable) < FEWEST:
            raise CairnError(
                f"{len(usable)} pair{'' if len(usable) == 1 else 's'} of which both images show "
                f"the board; a calibration needs at least {FEWEST}, and 10 to be good"
            )
        found = _solve_pair(cameras[0], cameras[1], usable, excluded)
        worst = max(found.errors, key=found.errors.__getitem__)
        limit = _BAD_TIMES * float(np.median(list(found.errors.values())))
        if found.errors[worst] <= max(_BAD_PX, limit):
            break
        excluded[worst] = found.errors[worst]
        del usable[worst]
    if found.rms > USELESS_PX:
        raise CairnError(
            f"the pairs' error of {found.rms:.1f} px is too large for a calibration; check that "
            "both images of each pair were taken at the same time and have corresponding names"
        )
    x, y, _ = found.translation
    if abs(x) < abs(y):
        raise CairnError(
            f"the right camera is {abs(y):.3f} m above or below the left one, but {abs(x):.3f} m "
            "beside it; mount the cameras side by side, other arrangements are not supported"
        )
    if x > 0:
        raise CairnError(
            f"left and right are swapped: the right camera is {x:.3f} m to the left of the left "
            "one; swap the images"
        )
    return found


def stereo_camera_infos(
    found: StereoCalibration, names: tuple[str, str]
) -> tuple[CameraInfo, CameraInfo]:
    """Return the CameraInfos of both cameras.

    Rectified images keep their size and have valid pixels only (alpha 0); disparity is 0 at
    infinite distance.
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
        make_camera_info(found.left, names[0], np.asarray(turn_left), np.asarray(project_left)),
        make_camera_info(found.right, names[1], np.asarray(turn_right), np.asarray(project_right)),
    )


def _solve_pair(
    left: Calibration, right: Calibration, pairs: Mapping[str, str], excluded: Mapping[str, float]
) -> StereoCalibration:
    model = left.board.points.astype(np.float32)
    seen = [left.corners[name].astype(np.float32) for name in pairs]
    beside = [
        reorder_like(right.corners[b], left.corners[a], left.board).astype(np.float32)
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
        dict(excluded),
    )
