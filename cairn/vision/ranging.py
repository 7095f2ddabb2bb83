"""Where a flat object is: by the disparities of its features, by its known size, by both."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.vision.plane_fit import fit_plane
from cairn.vision.stereo import StereoRig

Array = NDArray[np.float64]

# Rectification is never better than this, and its error is the same for all points [px].
_DISPARITY_FLOOR = 0.15
# How well a calibration tells baseline and focal length, as a share of them.
_CALIBRATED = 0.01
# How well a homography tells where the object's middle is in the image [px].
_MIDDLE = 0.5
# A distance whose error is more than this share of it is none: it has no normal distribution.
_TOO_FAR = 0.25
# How well SIFT places a feature in both view and image [px], and what all have in common: the view
# is a photograph itself, taken at a slant and by a lens.
_POINT_FLOOR, _VIEW_FLOOR = 0.5, 0.25
# Residuals beyond this many deviations are of wrong matches.
_OUTLYING = 3.0
# A pose from fewer points has next to nothing that could contradict it.
_FEWEST_POINTS = 7
# 99.9 % of consistent pairs have a smaller distance (chi-square of 3 degrees of freedom).
_CONSISTENT = 16.27


@dataclass(frozen=True)
class Located:
    """`position` (3,) [m] of an object's middle in the left rectified optical frame.

    That is x right, y down, z ahead; `covariance` (3, 3) [m^2] is of it.
    """

    position: Array
    covariance: Array


@dataclass(frozen=True)
class Fused:
    """What two ways of ranging give together, and how far they are apart.

    `distance` is the squared Mahalanobis distance of the two (normalized innovation squared, 3
    degrees of freedom), None where there was one way only.
    """

    located: Located
    distance: float | None

    @property
    def consistent(self) -> bool:
        """Whether the two may be of one place; if not, `located` is of none and not to be used."""
        return self.distance is None or self.distance <= _CONSISTENT


def by_stereo(
    points: NDArray[np.floating], disparities: Array, middle: Array, rig: StereoRig
) -> Located | None:
    """Where the object's `middle` (2,) [px] in the left rectified image is.

    `points` (n, 2) [px] are the object's features there, `disparities` (n,) [px] theirs, NaN where
    there is none. The disparity of a plane is affine in the image, so one plane is fitted to those
    that agree, and taken at the middle. None where too few agree, or the object is too far.
    """
    known = np.isfinite(disparities)
    centered = np.asarray(points, np.float64)[known] - middle
    plane = fit_plane(centered, disparities[known])
    if plane is None:
        return None
    disparity = float(plane.coefficients[0])
    variance = float(plane.covariance[0, 0]) + _DISPARITY_FLOOR**2
    if disparity <= 0 or math.sqrt(variance) > _TOO_FAR * disparity:
        return None
    depth = rig.fx * rig.baseline / disparity
    ray = np.array([(middle[0] - rig.cx) / rig.fx, (middle[1] - rig.cy) / rig.fy, 1.0])
    jacobian = np.zeros((3, 3))
    # With the middle, the place on the plane moves too.
    slope = plane.coefficients[1:]
    jacobian[:, :2] = -np.outer(ray, slope) * depth / disparity
    jacobian[0, 0] += depth / rig.fx
    jacobian[1, 1] += depth / rig.fy
    jacobian[:, 2] = -ray * depth / disparity
    covariance = jacobian @ np.diag((_MIDDLE**2, _MIDDLE**2, variance)) @ jacobian.T
    covariance += _CALIBRATED**2 * depth**2 * np.outer(ray, ray)
    return Located(depth * ray, covariance)


def by_size(
    view_points: NDArray[np.floating],
    image_points: NDArray[np.floating],
    view: tuple[int, int],
    size: tuple[float, float],
    rig: StereoRig,
    *,
    tolerance: float = 0.02,
) -> Located | None:
    """Where the middle of a flat object of known `size` (width, height) [m] is.

    `view_points` (n, 2) [px] in the `view` (width, height) [px] that shows the object from edge to
    edge correspond to `image_points` (n, 2) [px] in the left rectified image. `tolerance` is the
    deviation of the size as stated, as a share of it. None where too few points agree on a pose.
    """
    scale = np.array([size[0] / view[0], size[1] / view[1]])
    flat = (np.asarray(view_points, np.float64) - (np.array(view) - 1) / 2) * scale
    model = np.column_stack((flat, np.zeros(len(flat))))
    seen = np.asarray(image_points, np.float64)
    camera = np.array([[rig.fx, 0, rig.cx], [0, rig.fy, rig.cy], [0, 0, 1]])
    used = _agreeing(flat, seen)
    rotation = translation = np.zeros((3, 1))
    # Twice: those who agree are known better by the pose than by the homography.
    for _ in range(2):
        if np.count_nonzero(used) < max(_FEWEST_POINTS, len(seen) // 2):
            return None
        pose = _pose(model[used], seen[used], camera)
        if pose is None:
            return None
        rotation, translation = pose
        projected, jacobian = cv2.projectPoints(model, rotation, translation, camera, np.zeros(5))
        off = np.linalg.norm(projected[:, 0] - seen, axis=1)
        deviation = max(_POINT_FLOOR, 1.4826 * float(np.median(off[used])) / 1.1774)
        used = off <= _OUTLYING * deviation * math.sqrt(2)
    count = int(np.count_nonzero(used))
    if count < _FEWEST_POINTS:
        return None
    rows = np.repeat(used, 2)
    jacobian = np.asarray(jacobian, np.float64)[rows, :6]
    # Less 2: what is estimated from few residuals is itself uncertain (Student's t).
    noise = max(_POINT_FLOOR**2, float(np.sum(off[used] ** 2)) / (2 * count - 8))
    # An error that all points have in common does not become less by their number.
    variance = noise + count * _VIEW_FLOOR**2
    covariance = variance * np.asarray(np.linalg.pinv(jacobian.T @ jacobian), np.float64)[3:, 3:]
    position = translation.ravel()
    covariance += tolerance**2 * np.outer(position, position)
    return Located(position, covariance)


def fused(stereo: Located | None, size: Located | None) -> Fused | None:
    """Both by their information, with their distance; None if there is neither.

    Two that are not `consistent` must not be used: the object has another size than stated, the
    cameras are not where their calibration says, or what was recognized is something else.
    """
    if stereo is None or size is None:
        one = size if stereo is None else stereo
        return None if one is None else Fused(one, None)
    apart = stereo.position - size.position
    gain = np.linalg.solve((stereo.covariance + size.covariance).T, stereo.covariance.T).T
    position = stereo.position - gain @ apart
    covariance = stereo.covariance - gain @ stereo.covariance
    distance = float(apart @ np.linalg.solve(stereo.covariance + size.covariance, apart))
    return Fused(Located(position, (covariance + covariance.T) / 2), distance)


def _agreeing(flat: Array, seen: Array) -> NDArray[np.bool_]:
    """Which of the points (n, 2) of plane and image agree with one homography."""
    if len(seen) < _FEWEST_POINTS:
        return np.zeros(len(seen), np.bool_)
    _, mask = cv2.findHomography(flat, seen, cv2.RANSAC, _OUTLYING)
    if mask is None:
        return np.zeros(len(seen), np.bool_)
    agree: NDArray[np.bool_] = mask.ravel() > 0
    return agree


def _pose(model: Array, seen: Array, camera: Array) -> tuple[Array, Array] | None:
    """Rotation vector (3, 1) and translation (3, 1) [m] that project `model` to `seen`."""
    try:
        _, rotations, translations, _ = cv2.solvePnPGeneric(
            model, seen, camera, None, flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        # All points on a line.
        return None
    # IPPE gives both poses that a small image cannot tell apart, the better one first.
    for rotation, translation in zip(rotations, translations, strict=True):
        rotation, translation = cv2.solvePnPRefineLM(
            model, seen, camera, None, rotation, translation
        )
        if translation[2, 0] > 0 and np.isfinite(translation).all():
            return np.asarray(rotation, np.float64), np.asarray(translation, np.float64)
    return None
