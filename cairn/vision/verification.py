"""Whether a view of an object is where some of its matches say: a homography, and its proof."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from cairn.vision.features import Features
from cairn.vision.taught import View

LEAST = 8
"""Matched features without which nothing is recognized: a homography always fits four."""

NEAR = 3.0
"""How far a match may lie off [px]: in the image, or in the view if that is the coarser one."""

_LIKE = 290.0  # between descriptors: nine in ten of the same thing are nearer, few others
_TURN = math.radians(30.0)
_OCTAVES = 0.8
_FINEST = 2.0  # px, scale of the finest features that SIFT finds
_LEAST_SHARE = 0.1  # of the features that are to be seen: the rest may be covered
_LEAST_DENSITY = 0.12  # the same where the matched ones lie, so where nothing covers it
_LEAST_SPREAD = 0.03  # of the view's area, for what the matched ones enclose
_LEAST_PLACES = 5  # a homography takes any four places to any four others
_APART = 0.08  # of the view's diagonal: nearer features are of one place, such as a dot or a ring
_BLURRED = 0.2  # quantile of the matched features' scales below which none is missed
_SMALLEST = 12.0  # px, of a side in the image
_PERSPECTIVE = 6.0  # the far corner at most so many times as far as the near one

Homography = NDArray[np.float64]


@dataclass(frozen=True)
class Placed:
    """A view in an image: homography (view to image), corners there (4, 2) [px], and the evidence.

    `view_rows` and `image_rows` (n,) are the features matched; `share` is how many were matched of
    those of the view that are to be seen in the image.
    """

    homography: Homography
    corners: NDArray[np.float64]
    view_rows: NDArray[np.intp]
    image_rows: NDArray[np.intp]
    share: float


@dataclass(frozen=True)
class Scene:
    """An image's features sorted by x, and the image's size [px]."""

    features: Features
    width: int
    height: int


def scene_of(features: Features, width: int, height: int) -> Scene:
    """The scene of an image of `width` x `height` [px] with these features."""
    return Scene(features.at(np.argsort(features.points[:, 0], kind="stable")), width, height)


def place(scene: Scene, view: View, table: NDArray[np.float64]) -> Placed | None:
    """Where the view is, if the matches in `table` (`similarities.Groups`) lead to a proof of it.

    These are a start only: what they imply is matched again where it ought to be seen.
    """
    homography = _start(table)
    for radius in (3.0, 1.5, 1.0):
        if homography is None or not _sane(homography, view, scene):
            return None
        rows, mates = _guided(scene, view, homography, radius * NEAR)
        if len(rows) < LEAST:
            return None
        homography = _fitted(view.features.points[rows], scene.features.points[mates], homography)
    if homography is None or not _sane(homography, view, scene):
        return None
    return _proven(scene, view, homography)


def _start(table: NDArray[np.float64]) -> Homography | None:
    source, target = table[:, 2:4].astype(np.float32), table[:, 0:2].astype(np.float32)
    off = 2.0 * NEAR * max(1.0, float(np.exp2(np.median(table[:, 6]))))
    if len(table) >= LEAST:
        found, _ = cv2.findHomography(source, target, cv2.RANSAC, off, maxIters=500)
        return None if found is None else found.astype(np.float64)
    affine, _ = cv2.estimateAffine2D(source, target, None, cv2.RANSAC, off, 300)
    return None if affine is None else np.vstack((affine, (0.0, 0.0, 1.0)))


def _fitted(
    source: NDArray[np.float32], target: NDArray[np.float32], before: Homography
) -> Homography | None:
    middle = source.mean(axis=0)
    off = 0.5 * NEAR * max(1.0, float(_local(before, middle[None].astype(np.float64))[1][0]))
    # Tight, with local optimization: two planes at a small angle are not averaged.
    found, _ = cv2.findHomography(source, target, cv2.USAC_ACCURATE, off, maxIters=1000)
    return None if found is None else found.astype(np.float64)


def _sane(homography: Homography, view: View, scene: Scene) -> bool:
    """Whether it is how a camera may see the front of a flat thing."""
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
    longest = 20.0 * max(scene.width, scene.height)
    return bool((turns > 0.0).all() and lengths.min() >= _SMALLEST and lengths.max() <= longest)


def _local(
    homography: Homography, points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Where points (n, 2) go, by how much things there are scaled (n,), and the Jacobians."""
    mapped = np.column_stack((points, np.ones(len(points)))) @ homography.T
    depths = mapped[:, 2:3]
    places = mapped[:, :2] / depths
    # d(u / w) = (du - (u / w) dw) / w
    jacobians = (homography[None, :2, :2] - places[:, :, None] * homography[None, 2:, :2]) / depths[
        :, :, None
    ]
    scales = np.sqrt(np.abs(np.linalg.det(jacobians)))
    return places, scales, jacobians


def _seen(
    homography: Homography, view: View, scene: Scene
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Places, scales and angles of the view's features in the image; which are to be seen there."""
    features = view.features
    places, stretch, jacobians = _local(homography, features.points.astype(np.float64))
    directions = np.column_stack((np.cos(features.angles), np.sin(features.angles)))
    turned = np.einsum("nij,nj->ni", jacobians, directions)
    scales = features.scales * stretch
    size = np.array([scene.width, scene.height])
    inside = ((places > 0.0) & (places < size - 1.0)).all(axis=1) & (scales >= _FINEST)
    return places, stretch, np.arctan2(turned[:, 1], turned[:, 0]), inside


def _guided(
    scene: Scene, view: View, homography: Homography, radius: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The view's features that are found again where they ought to be, and their rows there."""
    places, stretch, angles, inside = _seen(homography, view, scene)
    rows = np.flatnonzero(inside)
    features = scene.features
    squares = np.full(len(features), np.iinfo(np.int32).max, np.int32)
    takers = np.full(len(features), -1, np.int64)
    _mate(
        places[rows],
        radius * np.maximum(1.0, stretch[rows]),
        np.log2(view.features.scales[rows] * stretch[rows]),
        angles[rows],
        view.features.descriptors[rows],
        features.points.astype(np.float64),
        np.log2(features.scales).astype(np.float64),
        features.angles.astype(np.float64),
        features.descriptors,
        takers,
        squares,
    )
    found = np.flatnonzero(takers >= 0)
    return rows[takers[found]], found


def _proven(scene: Scene, view: View, homography: Homography) -> Placed | None:
    """The view at this place, unless what is matched may well be so by chance."""
    rows, mates = _guided(scene, view, homography, NEAR)
    # A point that was described in two directions is one witness.
    _, distinct = np.unique(np.rint(view.features.points[rows]), axis=0, return_index=True)
    rows, mates = rows[np.sort(distinct)], mates[np.sort(distinct)]
    if len(rows) < LEAST or not _at_several_places(view, rows):
        return None
    _, stretch, _, inside = _seen(homography, view, scene)
    scales = view.features.scales * stretch
    # A blurred image shows nothing finer than this: that it is missing tells nothing.
    coarse = scales >= np.quantile(scales[rows], _BLURRED)
    seen = view.features.points[inside & coarse]
    hull = cv2.convexHull(view.features.points[rows])
    within = sum(cv2.pointPolygonTest(hull, (float(x), float(y)), False) >= 0.0 for x, y in seen)
    matched = int(coarse[rows].sum())
    share = matched / len(seen)
    spread = cv2.contourArea(hull) / (view.width * view.height)
    if share < _LEAST_SHARE or spread < _LEAST_SPREAD or matched < _LEAST_DENSITY * within:
        return None
    corners = cv2.perspectiveTransform(view.corners[None], homography)[0].astype(np.float64)
    return Placed(homography, corners, rows, mates, share)


def _at_several_places(view: View, rows: NDArray[np.intp]) -> bool:
    """Whether `_LEAST_PLACES` of these features lie apart from each other, by `_APART`."""
    apart = _APART * math.hypot(view.width, view.height)
    chosen: list[list[float]] = []
    for point in view.features.points[rows].tolist():
        if all(math.dist(point, other) > apart for other in chosen):
            chosen.append(point)
            if len(chosen) == _LEAST_PLACES:
                return True
    return False


@numba.njit(
    "void(f8[:,::1], f8[::1], f8[::1], f8[::1], u1[:,::1],"
    " f8[:,::1], f8[::1], f8[::1], u1[:,::1], i8[::1], i4[::1])",
    error_model="numpy",
    cache=True,
    nogil=True,
)
def _mate(
    places: NDArray[np.float64],
    radii: NDArray[np.float64],
    octaves: NDArray[np.float64],
    angles: NDArray[np.float64],
    descriptors: NDArray[np.uint8],
    points: NDArray[np.float64],
    point_octaves: NDArray[np.float64],
    point_angles: NDArray[np.float64],
    point_descriptors: NDArray[np.uint8],
    takers: NDArray[np.int64],
    squares: NDArray[np.int32],
) -> None:
    """Who of `places` takes which of `points` (sorted by x): each the most alike near by."""
    for row in range(places.shape[0]):
        x, y, radius = places[row, 0], places[row, 1], radii[row]
        best, nearest = -1, np.int32(_LIKE * _LIKE)
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
            takers[best] = row
