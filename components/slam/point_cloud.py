"""Points of scans with the directions of the surfaces that they lie on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
from cairn.planar.poses import Pose

Array = NDArray[np.float64]

# A point belongs to the surface of a neighboring beam if it is nearer than this [m], or than this
# multiple of the distance between the ends of two beams on a wall that faces the scanner.
_SURFACE_M, _SURFACE_SPACINGS = 0.15, 4.0
# A surface is estimated from at most so many beams on each side, and at least so many in all.
_SIDE = 5
DENSE_M = 0.04
"""Points nearer than this to each other are one [m]: a little more than the noise of scanners.

The points of a surface deviate by no more from its line.
"""


@dataclass(frozen=True)
class PointCloud:
    """Points x, y (n, 2) [m], and the unit normals (n, 2) of their surfaces, toward the scanner.

    A point without a known surface has the normal (0, 0).
    """

    points: Array
    normals: Array

    @property
    def count(self) -> int:
        """Number of points."""
        return len(self.points)

    def placed(self, base: Pose) -> PointCloud:
        """Return the cloud in the frame in which the frame of this one is at `base`."""
        x, y, turn = base
        cosine, sine = math.cos(turn), math.sin(turn)
        rotation = np.array([[cosine, sine], [-sine, cosine]])
        return PointCloud(self.points @ rotation + (x, y), self.normals @ rotation)

    def thinned(self, cell: float = DENSE_M) -> PointCloud:
        """Return the mean point and normal of each cell of `cell` [m].

        The two sides of a thin wall stay apart: points of one cell whose normals are opposite are
        not averaged.
        """
        if not self.count:
            return self
        points, normals = _thin(self.points, self.normals, cell)
        return PointCloud(points, normals)


NOTHING: Final = PointCloud(np.zeros((0, 2)), np.zeros((0, 2)))
"""What a scan shows that hits nothing."""


def joined(clouds: Sequence[PointCloud]) -> PointCloud:
    """Return the points of all clouds, which are in one frame; there is at least one."""
    return PointCloud(
        np.concatenate([cloud.points for cloud in clouds]),
        np.concatenate([cloud.normals for cloud in clouds]),
    )


def cloud_of(
    points: Array, indices: NDArray[np.int64], scanner: Array, spacing: float
) -> PointCloud:
    """Return the hits of one scan with the normals of their surfaces.

    Args:
        points: x, y (n, 2) [m], in the order of the beams.
        indices: numbers (n,) of their beams, increasing.
        scanner: x, y (2,) [m] of the scanner.
        spacing: angle between two beams [rad].

    """
    return PointCloud(points, _normals(points, indices, scanner, spacing))


@compiled("float64[:, ::1](float64[:, ::1], int64[::1], float64[::1], float64)")
def _normals(points: Array, indices: NDArray[np.int64], scanner: Array, spacing: float) -> Array:
    count = len(points)
    normals = np.zeros((count, 2))
    for i in range(count):
        x, y = points[i, 0], points[i, 1]
        to_scanner_x, to_scanner_y = scanner[0] - x, scanner[1] - y
        reach = math.hypot(to_scanner_x, to_scanner_y)
        step = max(_SURFACE_M, _SURFACE_SPACINGS * reach * spacing)
        number, sum_x, sum_y, sum_xx, sum_xy, sum_yy = 0, 0.0, 0.0, 0.0, 0.0, 0.0
        for side in (-1, 1):
            last_x, last_y = x, y
            k = i
            while 0 <= k < count and abs(indices[k] - indices[i]) <= _SIDE:
                px, py = points[k, 0], points[k, 1]
                if math.hypot(px - last_x, py - last_y) > step:
                    break
                if k != i or side == 1:
                    dx, dy = px - x, py - y
                    number += 1
                    sum_x += dx
                    sum_y += dy
                    sum_xx += dx * dx
                    sum_xy += dx * dy
                    sum_yy += dy * dy
                last_x, last_y = px, py
                k += side
        if number < _SIDE:
            continue
        mean_x, mean_y = sum_x / number, sum_y / number
        xx = sum_xx / number - mean_x * mean_x
        xy = sum_xy / number - mean_x * mean_y
        yy = sum_yy / number - mean_y * mean_y
        half = 0.5 * (xx + yy)
        root = math.sqrt(max(0.0, 0.25 * (xx - yy) * (xx - yy) + xy * xy))
        least, most = half - root, half + root
        if least > DENSE_M * DENSE_M or most < 4.0 * least or most <= 0.0:
            continue
        angle = 0.5 * math.atan2(2.0 * xy, xx - yy)  # along the surface
        nx, ny = -math.sin(angle), math.cos(angle)
        if nx * to_scanner_x + ny * to_scanner_y < 0.0:
            nx, ny = -nx, -ny
        normals[i, 0], normals[i, 1] = nx, ny
    return normals


@compiled("Tuple((float64[:, ::1], float64[:, ::1]))(float64[:, ::1], float64[:, ::1], float64)")
def _thin(points: Array, normals: Array, cell: float) -> tuple[Array, Array]:
    count = len(points)
    keys = np.empty(count, np.int64)
    for i in range(count):
        column = np.int64(math.floor(points[i, 0] / cell))
        row = np.int64(math.floor(points[i, 1] / cell))
        # Quadrant of the normal, so that opposite sides differ; 4 for a point without a surface.
        side = 4
        if normals[i, 0] != 0.0 or normals[i, 1] != 0.0:
            if abs(normals[i, 0]) > abs(normals[i, 1]):
                side = 0 if normals[i, 0] > 0.0 else 1
            else:
                side = 2 if normals[i, 1] > 0.0 else 3
        keys[i] = ((row + (1 << 28)) * (1 << 30) + (column + (1 << 28))) * 8 + side
    order = np.argsort(keys, kind="mergesort")
    thin_points, thin_normals = np.empty((count, 2)), np.empty((count, 2))
    number, i = 0, 0
    while i < count:
        key = keys[order[i]]
        x, y, nx, ny, members = 0.0, 0.0, 0.0, 0.0, 0
        while i < count and keys[order[i]] == key:
            k = order[i]
            x += points[k, 0]
            y += points[k, 1]
            nx += normals[k, 0]
            ny += normals[k, 1]
            members += 1
            i += 1
        length = math.hypot(nx, ny)
        thin_points[number, 0], thin_points[number, 1] = x / members, y / members
        thin_normals[number, 0] = nx / length if length > 0.0 else 0.0
        thin_normals[number, 1] = ny / length if length > 0.0 else 0.0
        number += 1
    return thin_points[:number].copy(), thin_normals[:number].copy()
