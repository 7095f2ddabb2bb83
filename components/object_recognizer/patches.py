"""Patches: flat things with much detail in a pair of images, pictured from the front."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from cairn.vision.features import Features
from cairn.vision.images import Gray
from cairn.vision.object_model import ModelView
from cairn.vision.ranging import PlaneFit, fit_plane
from cairn.vision.stereo import StereoRig, disparities
from cairn.vision.teaching import make_view, repeats, why_unrecognizable

Array = NDArray[np.float64]

# The strongest features of an image are of printed things; the others are of their surroundings.
_STRONGEST = 400
# Features nearer to each other than this [m] are of one thing, which has at least so many.
_GAP_M, _LEAST_FEATURES = 0.12, 30
# Of a thing that is larger than this [m], the part of this size with most features is taken. A
# smaller thing is recognized only from near by.
_LARGEST_M, _SMALLEST_M = 0.8, 0.12
# The border around the outermost features, as a share of the extent between them.
_BORDER = 0.06
# Largest angle between the direction of view and the perpendicular, and least picture [px].
_MOST_SLANTED, _LEAST_PX = math.radians(50.0), 60
# A picture of fewer features is mistaken too easily.
_LEAST_OF_VIEW = 50
_MARGIN_PX = 4.0  # rectified images have no content at their edges


@dataclass(frozen=True)
class Patch:
    """A flat thing in an image: `view` shows it from the front, `size` is what it shows [m]."""

    view: ModelView
    size: tuple[float, float]


def find_patches(
    left: Gray,
    right: Gray,
    features: Features,
    rig: StereoRig,
    taken: Sequence[Array],
    nearest: float,
    farthest: float,
) -> list[Patch]:
    """Return the patches in a rectified pair of images, those with most features first.

    Args:
        left: left image (h, w).
        right: right image (h, w).
        features: of the left image, strongest first.
        rig: geometry of the pair.
        taken: outlines (4, 2) [px] of things that are known already.
        nearest: nearest patch [m].
        farthest: farthest patch [m].

    """
    points = _outside(features.points[:_STRONGEST].astype(np.float64), taken)
    if len(points) < _LEAST_FEATURES:
        return []
    found = disparities(left, right, points, rig)
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = rig.fx * rig.baseline / found
    good = np.isfinite(found) & (depth >= nearest) & (depth <= farthest)
    points, found, depth = points[good], found[good], depth[good]
    if len(points) < _LEAST_FEATURES:
        return []
    patches = [
        patch
        for group in _groups(_in_space(points, depth, rig))
        if (patch := _patch(left, points[group], found[group], rig, taken)) is not None
    ]
    return sorted(patches, key=lambda one: -len(one.view.features))


def _outside(points: Array, taken: Sequence[Array]) -> Array:
    """Return the points (n, 2) that are in no outline."""
    for outline in taken:
        corners = outline.astype(np.float32)
        middle = corners.mean(axis=0)
        wider = middle + 1.1 * (corners - middle)
        points = points[
            [cv2.pointPolygonTest(wider, (u, v), False) < 0.0 for u, v in points.tolist()]
        ]
    return points


def _in_space(points: Array, depth: Array, rig: StereoRig) -> Array:
    """Return points (n, 3) [m] in the left optical frame."""
    x = (points[:, 0] - rig.cx) / rig.fx * depth
    y = (points[:, 1] - rig.cy) / rig.fy * depth
    return np.column_stack((x, y, depth))


def _groups(space: Array) -> list[NDArray[np.intp]]:
    """Return the indices of points (n, 3) that are connected by gaps of at most `_GAP_M`."""
    pairs = cKDTree(space).query_pairs(_GAP_M, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(space), len(space)))
    count, labels = connected_components(links, directed=False)
    groups = [np.flatnonzero(labels == number) for number in range(count)]
    return [group for group in groups if len(group) >= _LEAST_FEATURES]


def _patch(
    left: Gray, points: Array, found: Array, rig: StereoRig, taken: Sequence[Array]
) -> Patch | None:
    """Return the patch of points (n, 2) [px] with disparities (n,) [px], None if it is useless."""
    plane = fit_plane(points, found)
    if plane is None:
        return None
    outline, size = _outline(points[plane.agree], plane, rig)
    inside = (outline >= _MARGIN_PX) & (outline < np.array([rig.width, rig.height]) - _MARGIN_PX)
    if min(size) < _SMALLEST_M or not inside.all() or _overlaps(outline, taken):
        return None
    picture = _picture(left, outline, size)
    if picture is None:
        return None
    view = make_view(picture)
    if len(view.features) < _LEAST_OF_VIEW or why_unrecognizable(view) or repeats(view):
        return None
    return Patch(view, size)


def _outline(points: Array, plane: PlaneFit, rig: StereoRig) -> tuple[Array, tuple[float, float]]:
    """Return the corners (4, 2) [px] of the upright rectangle around points, and its size [m].

    Corners are those of a view: top left, top right, bottom right, bottom left. The size is 0 if
    the plane is too slanted.
    """
    offset, along, down = plane.coefficients
    # The disparity is affine in the image, and fx * baseline / depth: so is the plane in space.
    normal = np.array([along * rig.fx, down * rig.fy, offset + along * rig.cx + down * rig.cy])
    distance = rig.fx * rig.baseline / float(np.linalg.norm(normal))
    normal /= np.linalg.norm(normal)
    rays = _in_space(points, np.ones(len(points)), rig)
    facing = rays @ normal
    middle_ray = rays.mean(axis=0)
    slant = math.acos(min(1.0, abs(float(middle_ray @ normal)) / float(np.linalg.norm(middle_ray))))
    if slant > _MOST_SLANTED or facing.min() <= 0.0:
        return np.zeros((4, 2)), (0.0, 0.0)
    space = rays * (distance / facing)[:, None]
    right = np.cross((0.0, 1.0, 0.0), normal)
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(normal, right)])
    flat = (space - space[0]) @ axes.T
    low, high = _extent(flat)
    border = _BORDER * (high - low)
    low, high = low - border, high + border
    corners = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    corner_space = space[0] + corners @ axes
    projected = corner_space[:, :2] / corner_space[:, 2:] * (rig.fx, rig.fy) + (rig.cx, rig.cy)
    return projected, (float(high[0] - low[0]), float(high[1] - low[1]))


def _extent(flat: Array) -> tuple[Array, Array]:
    """Return the corners of the rectangle around points (n, 2) [m], or of the densest part."""
    low, high = flat.min(axis=0), flat.max(axis=0)
    if (high - low).max() > _LARGEST_M:
        half = _LARGEST_M / 2
        tree = cKDTree(flat)
        counts = tree.query_ball_point(flat, half, p=np.inf, return_length=True)
        part = flat[np.abs(flat - flat[int(np.argmax(counts))]).max(axis=1) <= half]
        low, high = part.min(axis=0), part.max(axis=0)
    return low, high


def _overlaps(outline: Array, taken: Sequence[Array]) -> bool:
    quad = outline.astype(np.float32)
    return any(
        float(cv2.intersectConvexConvex(quad, other.astype(np.float32))[0]) > 0.0 for other in taken
    )


def _picture(left: Gray, outline: Array, size: tuple[float, float]) -> Gray | None:
    """Return what is inside of an outline (4, 2) [px], from the front; None if it is too small."""
    sides = np.linalg.norm(outline - np.roll(outline, -1, axis=0), axis=1)
    scale = max(max(sides[0], sides[2]) / size[0], max(sides[1], sides[3]) / size[1])
    width, height = (round(float(scale) * side) for side in size)
    if min(width, height) < _LEAST_PX:
        return None
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height)], np.float32) - 0.5
    to_front = cv2.getPerspectiveTransform(outline.astype(np.float32), corners.astype(np.float32))
    return np.asarray(cv2.warpPerspective(left, to_front, (width, height)), np.uint8)
