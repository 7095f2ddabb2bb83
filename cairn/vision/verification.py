"""Verifies geometrically that a view of an object is in an image: a homography and its proof."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.vision.feature_matching import kernel
from cairn.vision.features import Features
from cairn.vision.object_model import ModelView

LEAST = 8
"""Fewest matched features of a detection: a homography fits any four."""

NEAR = 3.0
"""Largest error of a match [px], in the image or in the view, whichever is coarser."""

_SIMILAR = 290.0  # descriptor distance: nine in ten true matches are nearer, few false ones
_TURN = math.radians(30.0)
_OCTAVES = 0.8
_FINEST = 2.0  # px, scale of the finest features that SIFT finds
_LEAST_SHARE = 0.1  # of the features that should be visible: the rest may be covered
_LEAST_DENSITY = 0.12  # the same within the hull of the matched ones, where nothing covers it
_LEAST_SPREAD = 0.03  # area of the hull of the matched features, as a share of the view
_LEAST_POINTS = 5  # a homography maps any four points to any four others
_APART = 0.08  # of the view's diagonal: nearer features belong to one dot or ring
_BLURRED = 0.2  # quantile of matched scales; finer features are not expected to be visible
_SMALLEST = 12.0  # px, shortest side of a detection
_PERSPECTIVE = 6.0  # largest ratio of the depths of the farthest and the nearest corner

Homography = NDArray[np.float64]


@dataclass(frozen=True)
class VerifiedMatch:
    """A view that was verified in an image: homography (view to image) and corners (4, 2) [px].

    `view_rows` and `image_rows` (n,) are the matched features. `share` is the share of matched
    features among those of the view that should be visible in the image.
    """

    homography: Homography
    corners: NDArray[np.float64]
    view_rows: NDArray[np.intp]
    image_rows: NDArray[np.intp]
    share: float


@dataclass(frozen=True)
class SortedFeatures:
    """The features of an image, sorted by x, and the size of the image [px]."""

    features: Features
    width: int
    height: int


def sort_features(features: Features, width: int, height: int) -> SortedFeatures:
    """Sort the features of an image of `width` x `height` [px] for `verify`."""
    return SortedFeatures(
        features.at(np.argsort(features.points[:, 0], kind="stable")), width, height
    )


def verify(
    image: SortedFeatures, view: ModelView, table: NDArray[np.float64]
) -> VerifiedMatch | None:
    """Return where the view is, None if the matches in `table` (`MatchGroups`) do not prove it.

    The matches only start the search: features are matched again where the homography expects them.
    """
    homography = _initial_homography(table)
    for radius in (3.0, 1.5, 1.0):
        if homography is None or not _is_plausible(homography, view, image):
            return None
        rows, image_rows = _match_guided(image, view, homography, radius * NEAR)
        if len(rows) < LEAST:
            return None
        homography = _refit(
            view.features.points[rows], image.features.points[image_rows], homography
        )
    if homography is None or not _is_plausible(homography, view, image):
        return None
    return _prove(image, view, homography)


def _initial_homography(table: NDArray[np.float64]) -> Homography | None:
    source, target = table[:, 2:4].astype(np.float32), table[:, 0:2].astype(np.float32)
    threshold = 2.0 * NEAR * max(1.0, float(np.exp2(np.median(table[:, 6]))))
    if len(table) >= LEAST:
        found, _ = cv2.findHomography(source, target, cv2.RANSAC, threshold, maxIters=500)
        return None if found is None else found.astype(np.float64)
    affine, _ = cv2.estimateAffine2D(source, target, None, cv2.RANSAC, threshold, 300)
    return None if affine is None else np.vstack((affine, (0.0, 0.0, 1.0)))


def _refit(
    source: NDArray[np.float32], target: NDArray[np.float32], before: Homography
) -> Homography | None:
    middle = source.mean(axis=0)
    threshold = (
        0.5 * NEAR * max(1.0, float(_map_points(before, middle[None].astype(np.float64))[1][0]))
    )
    # A tight threshold with local optimization: two planes at a small angle are not averaged.
    found, _ = cv2.findHomography(source, target, cv2.USAC_ACCURATE, threshold, maxIters=1000)
    return None if found is None else found.astype(np.float64)


def _is_plausible(homography: Homography, view: ModelView, image: SortedFeatures) -> bool:
    """Return whether a camera can see the front of a flat object under this homography."""
    middles = np.column_stack((view.corners, np.ones(4))) @ homography.T
    depths = middles[:, 2]
    if not np.isfinite(middles).all() or depths.min() <= 0.0:
        return False
    if depths.max() > _PERSPECTIVE * depths.min():
        return False
    corners = middles[:, :2] / depths[:, None]
    sides = np.roll(corners, -1, axis=0) - corners
    following = np.roll(sides, -1, axis=0)
    turns = sides[:, 0] * following[:, 1] - sides[:, 1] * following[:, 0]
    lengths = np.linalg.norm(sides, axis=1)
    longest = 20.0 * max(image.width, image.height)
    return bool((turns > 0.0).all() and lengths.min() >= _SMALLEST and lengths.max() <= longest)


def _map_points(
    homography: Homography, points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return mapped points (n, 2), local scale factors (n,), and Jacobians (n, 2, 2)."""
    mapped = np.column_stack((points, np.ones(len(points)))) @ homography.T
    depths = mapped[:, 2:3]
    projected = mapped[:, :2] / depths
    # d(u / w) = (du - (u / w) dw) / w
    jacobians = (
        homography[None, :2, :2] - projected[:, :, None] * homography[None, 2:, :2]
    ) / depths[:, :, None]
    scales = np.sqrt(np.abs(np.linalg.det(jacobians)))
    return projected, scales, jacobians


def _project_features(
    homography: Homography, view: ModelView, image: SortedFeatures
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Project the view's features: points, stretch factors, angles, and which should be visible."""
    features = view.features
    projected, stretch, jacobians = _map_points(homography, features.points.astype(np.float64))
    directions = np.column_stack((np.cos(features.angles), np.sin(features.angles)))
    turned = np.einsum("nij,nj->ni", jacobians, directions)
    scales = features.scales * stretch
    size = np.array([image.width, image.height])
    inside = ((projected > 0.0) & (projected < size - 1.0)).all(axis=1) & (scales >= _FINEST)
    return projected, stretch, np.arctan2(turned[:, 1], turned[:, 0]), inside


def _match_guided(
    image: SortedFeatures, view: ModelView, homography: Homography, radius: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Match the view's features near their projections; return rows of view and image."""
    projected, stretch, angles, inside = _project_features(homography, view, image)
    rows = np.flatnonzero(inside)
    features = image.features
    squares = np.full(len(features), np.iinfo(np.int32).max, np.int32)
    assigned = np.full(len(features), -1, np.int64)
    _assign(
        projected[rows],
        radius * np.maximum(1.0, stretch[rows]),
        np.log2(view.features.scales[rows] * stretch[rows]),
        angles[rows],
        view.features.descriptors[rows],
        features.points.astype(np.float64),
        np.log2(features.scales).astype(np.float64),
        features.angles.astype(np.float64),
        features.descriptors,
        assigned,
        squares,
    )
    found = np.flatnonzero(assigned >= 0)
    return rows[assigned[found]], found


def _prove(image: SortedFeatures, view: ModelView, homography: Homography) -> VerifiedMatch | None:
    """Return the verified match, None if it may have arisen by chance."""
    rows, image_rows = _match_guided(image, view, homography, NEAR)
    # A point that SIFT described in two directions counts once.
    _, distinct = np.unique(np.rint(view.features.points[rows]), axis=0, return_index=True)
    rows, image_rows = rows[np.sort(distinct)], image_rows[np.sort(distinct)]
    if len(rows) < LEAST or not _are_spread(view, rows):
        return None
    _, stretch, _, inside = _project_features(homography, view, image)
    scales = view.features.scales * stretch
    # A blurred image shows nothing finer than this, so missing fine features are no evidence.
    coarse = scales >= np.quantile(scales[rows], _BLURRED)
    visible = view.features.points[inside & coarse]
    hull = cv2.convexHull(view.features.points[rows])
    within = sum(cv2.pointPolygonTest(hull, (float(x), float(y)), False) >= 0.0 for x, y in visible)
    matched = int(coarse[rows].sum())
    share = matched / len(visible)
    spread = cv2.contourArea(hull) / (view.width * view.height)
    if share < _LEAST_SHARE or spread < _LEAST_SPREAD or matched < _LEAST_DENSITY * within:
        return None
    corners = cv2.perspectiveTransform(view.corners[None], homography)[0].astype(np.float64)
    return VerifiedMatch(homography, corners, rows, image_rows, share)


def _are_spread(view: ModelView, rows: NDArray[np.intp]) -> bool:
    """Return whether `_LEAST_POINTS` of these features are `_APART` from each other."""
    apart = _APART * math.hypot(view.width, view.height)
    chosen: list[list[float]] = []
    for point in view.features.points[rows].tolist():
        if all(math.dist(point, other) > apart for other in chosen):
            chosen.append(point)
            if len(chosen) == _LEAST_POINTS:
                return True
    return False


@kernel(
    "void(f8[:,::1], f8[::1], f8[::1], f8[::1], u1[:,::1],"
    " f8[:,::1], f8[::1], f8[::1], u1[:,::1], i8[::1], i4[::1])"
)
def _assign(
    projected: NDArray[np.float64],
    radii: NDArray[np.float64],
    octaves: NDArray[np.float64],
    angles: NDArray[np.float64],
    descriptors: NDArray[np.uint8],
    points: NDArray[np.float64],
    point_octaves: NDArray[np.float64],
    point_angles: NDArray[np.float64],
    point_descriptors: NDArray[np.uint8],
    assigned: NDArray[np.int64],
    squares: NDArray[np.int32],
) -> None:
    """Assign to each projected feature the most similar of `points` (sorted by x) near it."""
    for row in range(projected.shape[0]):
        x, y, radius = projected[row, 0], projected[row, 1], radii[row]
        best, nearest = -1, np.int32(_SIMILAR * _SIMILAR)
        for point in range(np.searchsorted(points[:, 0], x - radius), points.shape[0]):
            dx, dy = points[point, 0] - x, points[point, 1] - y
            if dx > radius:
                break
            if dx * dx + dy * dy > radius * radius:
                continue
            if abs(point_octaves[point] - octaves[row]) > _OCTAVES:
                continue
            turn = abs(point_angles[point] - angles[row])
            while turn > math.pi:
                turn = abs(turn - 2.0 * math.pi)
            if turn > _TURN:
                continue
            square = np.int32(0)
            for element in range(descriptors.shape[1]):
                difference = np.int32(descriptors[row, element]) - np.int32(
                    point_descriptors[point, element]
                )
                square += difference * difference
            if square < nearest:
                best, nearest = point, square
        if best >= 0 and nearest < squares[best]:
            squares[best] = nearest
            assigned[best] = row
