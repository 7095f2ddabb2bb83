"""A camera's calibration from pictures of a chessboard.

Z. Zhang, A Flexible New Technique for Camera Calibration, PAMI 22(11), 2000. Distortion is ROS's
plumb_bob with k3 = 0, as camera_calibration has it by default: what is seen of a board seldom
reaches into an image's corners, and a third coefficient runs wild there.
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
from cairn.vision.chessboard import Board

Array = NDArray[np.float64]
Matrix = NDArray[np.integer | np.floating]  # as OpenCV gives it

FEWEST = 3
"""Images of the board that a calibration needs at least."""

# An image is left out if its error [px] is above this, and above this many times the median's:
# then its corners are not where they seem.
_BAD_PX, _BAD_TIMES = 1.0, 3.0
# Images of more than this error, and this many times the median's, are told of, but used.
_OUTLYING_PX, _OUTLYING_TIMES = 0.3, 2.0
# Above this share of it, the focal length's deviation makes a calibration doubtful.
_VAGUE = 0.01
# Boards turned less than this against each other [deg] are seen from one viewpoint.
_ONE_VIEW = 15.0
# Boards turned less than this [deg] tell nothing of the focal length.
_UNTURNED = 5.0
# Where no corner was seen, distortion is but continued: this share of width and height is wanted.
_COVERED = 0.5
# More than this [px] is not what corners of a flat board give.
_LARGE_ERROR = 1.0

USELESS_PX = 5.0
"""Cameras and boards err by tenths of a pixel; by more than this [px] images are mixed up."""


@dataclass(frozen=True)
class Calibration:
    """What was found of one camera.

    `intrinsics` K (3, 3), `distortion` (5,) k1 k2 p1 p2 k3, `rms` [px] over all corners, and by the
    name of each image: `corners` (n, 2), `residuals` (n, 2: seen less projected) [px], and the
    rotation (3,) and translation (3,) [m] of the board, `poses`. `focal_deviation` [px] is the
    standard deviation of the less certain focal length. `left_out` are images that did not fit,
    with their errors [px].
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
    left_out: Mapping[str, float]

    @property
    def errors(self) -> dict[str, float]:
        """The root mean square of the residuals of each image [px]."""
        return {
            name: math.sqrt(float(np.mean(np.sum(of**2, axis=1))))
            for name, of in self.residuals.items()
        }

    @property
    def outlying(self) -> dict[str, float]:
        """Images that fit much worse than the others, with their errors [px]."""
        errors = self.errors
        limit = max(_OUTLYING_PX, _OUTLYING_TIMES * float(np.median(list(errors.values()))))
        return {name: error for name, error in errors.items() if error > limit}

    @property
    def coverage(self) -> tuple[float, float]:
        """The shares of the image's width and height over which corners were seen."""
        seen = np.concatenate(list(self.corners.values()))
        wide, high = np.ptp(seen, axis=0) / np.array(self.size)
        return float(wide), float(high)

    def doubts(self) -> list[str]:
        """Why this calibration may be worse than its error says: sentences with a remedy."""
        told = []
        focal = float(min(self.intrinsics[0, 0], self.intrinsics[1, 1]))
        turned = _largest_turn(self.poses)
        if turned < _ONE_VIEW or self.focal_deviation > _VAGUE * focal:
            told.append(
                f"the focal length is {focal:.1f} +- {self.focal_deviation:.1f} px: the board was "
                f"turned by {turned:.0f} deg at most between images; take more, with the board "
                "turned by 30 to 45 deg to every side"
            )
        wide, high = self.coverage
        if min(wide, high) < _COVERED:
            told.append(
                f"corners cover {100 * wide:.0f} % of the image's width and {100 * high:.0f} % of "
                "its height: distortion outside is a guess; hold the board into every corner"
            )
        if self.rms > _LARGE_ERROR:
            told.append(
                f"an error of {self.rms:.2f} px is large: is the board flat, are images sharp, is "
                "the lens no fisheye?"
            )
        return told


def calibrate(corners: Mapping[str, Array], size: tuple[int, int], board: Board) -> Calibration:
    """The camera that saw the board's `corners` (n, 2) [px], by the name of each image.

    `size` is the images' width and height [px]. Images that do not fit are left out. Raises
    `CairnError` if there are too few, or no camera explains them.
    """
    left_out: dict[str, float] = {}
    while True:
        if len(corners) < FEWEST:
            without = "".join(f", {name} left out ({e:.1f} px)" for name, e in left_out.items())
            raise CairnError(
                f"{len(corners)} usable image{'' if len(corners) == 1 else 's'} of the board"
                f"{without}: a calibration needs {FEWEST} at least, and 10 to be good"
            )
        found = _calibrated(corners, size, board)
        errors = found.errors
        worst = max(errors, key=errors.__getitem__)
        if errors[worst] <= max(_BAD_PX, _BAD_TIMES * float(np.median(list(errors.values())))):
            break
        left_out[worst] = errors[worst]
        corners = {name: of for name, of in corners.items() if name != worst}
    turned = _largest_turn(found.poses)
    if turned < _UNTURNED:
        raise CairnError(
            f"the board was turned by {turned:.0f} deg at most between images: such images do not "
            "tell the focal length. Take some with the board turned by 30 to 45 deg to every side"
        )
    if found.rms > USELESS_PX:
        raise CairnError(
            f"an error of {found.rms:.1f} px is no calibration: are all images of one camera, and "
            "of this board?"
        )
    return replace(found, left_out=left_out)


def camera_info(found: Calibration, name: str) -> CameraInfo:
    """The calibration of a camera alone; its rectified image holds valid pixels only (alpha 0)."""
    projection = np.zeros((3, 4))
    projection[:, :3], _ = cv2.getOptimalNewCameraMatrix(
        found.intrinsics, found.distortion, found.size, 0.0
    )
    return described(found, name, np.eye(3), projection)


def described(found: Calibration, name: str, rotation: Matrix, projection: Matrix) -> CameraInfo:
    """CameraInfo of a calibration, rectified by `rotation` (3, 3) and `projection` (3, 4)."""
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


def _calibrated(corners: Mapping[str, Array], size: tuple[int, int], board: Board) -> Calibration:
    model = board.points.astype(np.float32)
    seen = [of.astype(np.float32) for of in corners.values()]
    try:
        rms, intrinsics, distortion, turns, moves, deviations, *_ = cv2.calibrateCameraExtended(
            [model] * len(seen), seen, size, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3
        )
    except cv2.error as error:
        raise CairnError(f"no camera explains the corners of {', '.join(corners)}") from error
    if not np.isfinite(rms) or not np.isfinite(intrinsics).all():
        raise CairnError(f"no camera explains the corners of {', '.join(corners)}")
    residuals, poses = {}, {}
    for (name, points), turn, move in zip(corners.items(), turns, moves, strict=True):
        projected, _ = cv2.projectPoints(model, turn, move, intrinsics, distortion)
        residuals[name] = points - projected.reshape(-1, 2)
        poses[name] = (turn.ravel().astype(np.float64), move.ravel().astype(np.float64))
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


def _largest_turn(poses: Mapping[str, tuple[Array, Array]]) -> float:
    """The largest angle [deg] between any two boards' planes."""
    normals = np.array([cv2.Rodrigues(turn)[0][:, 2] for turn, _ in poses.values()])
    return math.degrees(math.acos(float(np.clip((normals @ normals.T).min(), -1.0, 1.0))))
