"""Tells whether a scan contradicts what was seen before, or shows something new."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cairn.components.slam.point_cloud import PointCloud, joined
from cairn.planar.poses import Pose, inverse

Array = NDArray[np.float64]

# Surfaces are counted in cells of this size [m].
_SURFACE_CELL = 0.25
# A surface stands still if so many keyframes saw it in one cell of this size [m]. People leave the
# cell before.
_STANDING, _STANDING_CELL = 3, 0.2
# A scan and what was seen before are compared in directions of this width [rad]. They contradict
# each other where one is behind the other by this at least [m].
_DIRECTION_RAD, _BEHIND_M = math.radians(2.0), 0.3
# A scan contradicts the place if it sees through surfaces in more than this share of the compared
# directions, and these fill so many cells, more than two people who have left; or if it sees
# through them or something before them in that share, with so many cells. People hide surfaces, but
# hardly on all sides.
_PASSED, _PASSED_CELLS = 0.25, 10
_DIFFERENT, _DIFFERENT_CELLS = 0.8, 12


def surface_cells(points: Array) -> int:
    """Return in how many cells of 0.25 m points (n, 2) [m] show surfaces."""
    return len(np.unique(_cells(points, _SURFACE_CELL), axis=0))


def standing(clouds: Sequence[PointCloud]) -> PointCloud:
    """Return the points where several keyframes have seen a surface.

    Args:
        clouds: what each keyframe shows, at least one, in one frame.

    """
    seen = np.concatenate(
        [np.unique(_cells(cloud.points, _STANDING_CELL), axis=0) for cloud in clouds]
    )
    places, count = np.unique(seen, axis=0, return_counts=True)
    stands = places[count >= min(_STANDING, len(clouds))]
    cloud = joined(clouds)
    kept = np.isin(_keys(_cells(cloud.points, _STANDING_CELL)), _keys(stands))
    return PointCloud(cloud.points[kept], cloud.normals[kept])


def contradicts(surroundings: PointCloud, cloud: PointCloud, pose: Pose) -> bool:
    """Return whether a scan from a pose cannot show the place with these surroundings.

    It may show more than was seen before, and people may hide a part.

    Args:
        surroundings: the surfaces that stand still, in the map.
        cloud: the surfaces that the scan shows, in the frame of the base.
        pose: of the base in the map.

    """
    known, surfaces = _nearest(surroundings.placed(inverse(pose)).points)
    seen, ends = _nearest(cloud.points)
    compared = np.isfinite(known) & np.isfinite(seen)
    passed = compared & (seen > known + _BEHIND_M)
    hidden = compared & (seen < known - _BEHIND_M)
    places = np.where(passed[:, None], surfaces, ends)
    return any(
        np.count_nonzero(differs) > share * np.count_nonzero(compared)
        and surface_cells(places[differs]) >= cells
        for differs, share, cells in (
            (passed, _PASSED, _PASSED_CELLS),
            (passed | hidden, _DIFFERENT, _DIFFERENT_CELLS),
        )
    )


def _nearest(points: Array) -> tuple[Array, Array]:
    """Return the distance (n,) [m] of the nearest point in each direction, and the point (n, 2).

    The distance is infinite where there is none.
    """
    directions = round(2.0 * math.pi / _DIRECTION_RAD)
    angles = np.arctan2(points[:, 1], points[:, 0]) + math.pi
    numbers = np.floor(angles / _DIRECTION_RAD).astype(np.int64) % directions
    distances = np.hypot(points[:, 0], points[:, 1])
    farthest_first = np.argsort(-distances, kind="stable")
    nearest, found = np.full(directions, np.inf), np.zeros((directions, 2))
    nearest[numbers[farthest_first]] = distances[farthest_first]
    found[numbers[farthest_first]] = points[farthest_first]
    return nearest, found


def _cells(points: Array, size: float) -> NDArray[np.int64]:
    cells: NDArray[np.int64] = np.floor(points / size).astype(np.int64)
    return cells


def _keys(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    keys: NDArray[np.int64] = cells[:, 0] * 2**32 + cells[:, 1]
    return keys
