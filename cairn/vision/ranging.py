"""Measures where a flat object is: by the disparities of its features, by its size, by both."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.vision.stereo import StereoRig

Array = NDArray[np.float64]

# Error of rectification, at best; it is common to all points [px].
_DISPARITY_FLOOR = 0.15
# Relative error of the calibrated baseline and focal length.
_CALIBRATED = 0.01
# Error of the object's center in the image, by a homography [px].
_CENTER = 0.5
# A distance with a larger relative error is rejected: its error is not normally distributed.
_TOO_FAR = 0.25
# Error of a feature's position in both view and image [px], and the part that all features share:
# the view is a photograph itself, taken at a slant and through a lens.
_POINT_FLOOR, _VIEW_FLOOR = 0.5, 0.25
# Residuals beyond this many standard deviations come from wrong matches.
_OUTLYING = 3.0
# A pose from fewer points has almost no redundancy.
_FEWEST_POINTS = 7
# 99.9 % quantile of chi-square with 3 degrees of freedom: scipy.stats.chi2.ppf(0.999, 3).
_CONSISTENT = 16.27
# Fit of a plane to disparities, by RANSAC: number of triples that are tried, and the largest
# residual [px of disparity] of values that agree.
_PLANE_TRIALS, _PLANE_NEAR = 200, 1.0
# Least squares then keep residuals within this many standard deviations. At least this share and
# this number of the values must agree.
_PLANE_DEVIATIONS, _PLANE_SHARE, _PLANE_POINTS = 3.0, 0.6, 6
# Standard deviation of the disparity of a single patch, at best [px].
_PATCH_FLOOR = 0.1


@dataclass(frozen=True)
class CameraPosition:
    """The position (3,) [m] of an object's center in the left rectified optical frame.

    The axes are x right, y down, z forward. `covariance` (3, 3) is in [m^2].
    """

    position: Array
    covariance: Array


def range_by_stereo(
    points: NDArray[np.floating], disparities: Array, middle: Array, rig: StereoRig
) -> CameraPosition | None:
    """Return the position of the object's `middle` (2,) [px] in the left rectified image.

    `points` (n, 2) [px] are the object's features there, `disparities` (n,) [px] theirs, NaN where
    unknown. The disparity of a plane is affine in the image, so a plane is fitted to the
    disparities that agree and evaluated at the middle. Return None if too few agree, or if the
    object is too far away.
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
    # An error of the middle also moves the point on the plane.
    slope = plane.coefficients[1:]
    jacobian[:, :2] = -np.outer(ray, slope) * depth / disparity
    jacobian[0, 0] += depth / rig.fx
    jacobian[1, 1] += depth / rig.fy
    jacobian[:, 2] = -ray * depth / disparity
    covariance = jacobian @ np.diag((_CENTER**2, _CENTER**2, variance)) @ jacobian.T
    covariance += _CALIBRATED**2 * depth**2 * np.outer(ray, ray)
    return CameraPosition(depth * ray, covariance)


def range_by_size(
    view_points: NDArray[np.floating],
    image_points: NDArray[np.floating],
    view: tuple[int, int],
    size: tuple[float, float],
    rig: StereoRig,
    *,
    tolerance: float = 0.02,
) -> CameraPosition | None:
    """Return the position of the center of a flat object of known `size` (width, height) [m].

    `view_points` (n, 2) [px] in the `view` (width, height) [px], which shows the object from edge
    to edge, correspond to `image_points` (n, 2) [px] in the left rectified image. `tolerance` is
    the relative error of the stated size. Return None if too few points agree on a pose.
    """
    scale = np.array([size[0] / view[0], size[1] / view[1]])
    flat = (np.asarray(view_points, np.float64) - (np.array(view) - 1) / 2) * scale
    model = np.column_stack((flat, np.zeros(len(flat))))
    observed = np.asarray(image_points, np.float64)
    camera = np.array([[rig.fx, 0, rig.cx], [0, rig.fy, rig.cy], [0, 0, 1]])
    used = _agreeing(flat, observed)
    rotation = translation = np.zeros((3, 1))
    # Twice: the pose selects inliers better than the homography.
    for _ in range(2):
        if np.count_nonzero(used) < max(_FEWEST_POINTS, len(observed) // 2):
            return None
        pose = _pose(model[used], observed[used], camera)
        if pose is None:
            return None
        rotation, translation = pose
        projected, jacobian = cv2.projectPoints(model, rotation, translation, camera, np.zeros(5))
        off = np.linalg.norm(projected[:, 0] - observed, axis=1)
        deviation = max(_POINT_FLOOR, 1.4826 * float(np.median(off[used])) / 1.1774)
        used = off <= _OUTLYING * deviation * math.sqrt(2)
    count = int(np.count_nonzero(used))
    if count < _FEWEST_POINTS:
        return None
    rows = np.repeat(used, 2)
    jacobian = np.asarray(jacobian, np.float64)[rows, :6]
    # Less 2: a variance estimated from few residuals is itself uncertain (Student's t).
    noise = max(_POINT_FLOOR**2, float(np.sum(off[used] ** 2)) / (2 * count - 8))
    # An error that all points share does not average out.
    variance = noise + count * _VIEW_FLOOR**2
    covariance = variance * np.asarray(np.linalg.pinv(jacobian.T @ jacobian), np.float64)[3:, 3:]
    position = translation.ravel()
    covariance += tolerance**2 * np.outer(position, position)
    return CameraPosition(position, covariance)


def fuse(one: CameraPosition, other: CameraPosition) -> CameraPosition:
    """Combine two independent estimates of one position by their covariances.

    Estimates that are not `consistent` must not be fused: the object has another size than stated,
    the cameras are not where their calibration says, or something else was recognized.
    """
    apart = one.position - other.position
    gain = np.linalg.solve((one.covariance + other.covariance).T, one.covariance.T).T
    position = one.position - gain @ apart
    covariance = one.covariance - gain @ one.covariance
    return CameraPosition(position, (covariance + covariance.T) / 2)


def consistent(one: CameraPosition, other: CameraPosition) -> bool:
    """Return whether two estimates may be of one position, by their Mahalanobis distance."""
    return squared_distance(one, other) <= _CONSISTENT


def squared_distance(one: CameraPosition, other: CameraPosition) -> float:
    """Return the squared Mahalanobis distance of two estimates (3 degrees of freedom)."""
    apart = one.position - other.position
    return float(apart @ np.linalg.solve(one.covariance + other.covariance, apart))


def _agreeing(flat: Array, observed: Array) -> NDArray[np.bool_]:
    """Return which points (n, 2) of plane and image agree with one homography."""
    if len(observed) < _FEWEST_POINTS:
        return np.zeros(len(observed), np.bool_)
    _, mask = cv2.findHomography(flat, observed, cv2.RANSAC, _OUTLYING)
    if mask is None:
        return np.zeros(len(observed), np.bool_)
    agree: NDArray[np.bool_] = mask.ravel() > 0
    return agree


def _pose(model: Array, observed: Array, camera: Array) -> tuple[Array, Array] | None:
    """Return rotation vector (3, 1) and translation (3, 1) [m] that project `model`."""
    try:
        _, rotations, translations, _ = cv2.solvePnPGeneric(
            model, observed, camera, None, flags=cv2.SOLVEPNP_IPPE
        )
    except cv2.error:
        # All points on a line.
        return None
    # IPPE returns both poses that a small image cannot distinguish, the better one first.
    for rotation, translation in zip(rotations, translations, strict=True):
        rotation, translation = cv2.solvePnPRefineLM(
            model, observed, camera, None, rotation, translation
        )
        if translation[2, 0] > 0 and np.isfinite(translation).all():
            return np.asarray(rotation, np.float64), np.asarray(translation, np.float64)
    return None


@dataclass(frozen=True)
class PlaneFit:
    """value = c[0] + c[1] * x + c[2] * y, with the `covariance` (3, 3) of `coefficients` (3,)."""

    coefficients: Array
    covariance: Array
    agree: NDArray[np.bool_]


def fit_plane(points: Array, values: Array) -> PlaneFit | None:
    """Fit an affine function of `points` (n, 2) to most of `values` (n,).

    RANSAC (Fischler and Bolles 1981) selects the values that agree, least squares fit them. Return
    None if fewer than six, or fewer than 60 % of them agree, or all points are on a line.
    """
    count = len(values)
    if count < _PLANE_POINTS:
        return None
    model = np.column_stack((np.ones(count), points))
    triples = _triples(count)
    corners = model[triples]
    spread = np.abs(np.linalg.det(corners))
    triples, corners = triples[spread > 1.0], corners[spread > 1.0]
    if not len(triples):
        return None
    planes = np.linalg.solve(corners, values[triples][:, :, None])[:, :, 0]
    off = np.abs(planes @ model.T - values)
    # MSAC (Torr and Zisserman 2000): values that agree are weighted by their residuals.
    best = int(np.minimum(off, _PLANE_NEAR).sum(axis=1).argmin())
    agree = off[best] <= _PLANE_NEAR
    for _ in range(5):
        if np.count_nonzero(agree) < max(_PLANE_POINTS, _PLANE_SHARE * count):
            return None
        coefficients, *_ = np.linalg.lstsq(model[agree], values[agree], rcond=None)
        residuals = model @ coefficients - values
        deviation = max(_PATCH_FLOOR, 1.4826 * float(np.median(np.abs(residuals[agree]))))
        agree = np.abs(residuals) <= _PLANE_DEVIATIONS * deviation
    used = model[agree]
    # Less 2: a variance estimated from few residuals is itself uncertain (Student's t).
    freedom = len(used) - 5
    variance = max(_PATCH_FLOOR**2, float(np.sum(residuals[agree] ** 2)) / freedom)
    covariance = variance * np.linalg.pinv(used.T @ used)
    return PlaneFit(coefficients, covariance, agree)


@lru_cache(maxsize=256)
def _triples(count: int) -> NDArray[np.int64]:
    """Return triples of point indices (trials, 3), the same for the same number of points.

    They are cached: drawing them takes longer than the rest of the fit, and counts recur.
    """
    random = np.random.default_rng(count)
    triples = np.array([random.choice(count, 3, replace=False) for _ in range(_PLANE_TRIALS)])
    triples.flags.writeable = False
    return triples
