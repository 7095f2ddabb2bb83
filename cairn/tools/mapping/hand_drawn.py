"""Obstacles that were drawn into a grid map by hand, such as stairs, and that no scan shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cairn.planar.grid import OCCUPIED, OCCUPIED_FROM, UNKNOWN, Frame, Grid, OccupancyCells

Array = NDArray[np.float64]

# An obstacle cell this near [cells] to the end of a ray is a surface that a scan has seen.
_NEAR_CELLS = 2.5


def drawn_by_hand(grid: OccupancyCells, seen: Array) -> Array:
    """Return the centers (n, 2) [m] of the obstacles of a map that no scan has seen.

    `seen`: ends of rays (m, 2) [m].
    """
    from scipy.spatial import cKDTree  # takes 0.2 s

    rows, columns = np.argwhere(grid.values >= OCCUPIED_FROM).T.astype(np.float64)
    centers = np.column_stack(grid.frame.point(rows, columns))
    if not len(seen) or not len(centers):
        return centers
    near_m = _NEAR_CELLS * grid.frame.resolution
    apart, _ = cKDTree(seen).query(centers, distance_upper_bound=near_m)
    drawn: Array = centers[np.isinf(apart)]
    return drawn


def with_obstacles(grid: OccupancyCells, points: Array) -> OccupancyCells:
    """Return a map with obstacles at some points (n, 2) [m]; it grows where they are outside."""
    if not len(points):
        return grid
    x, y = grid.frame.cells(points[:, 0], points[:, 1])
    rows, columns = np.floor(y).astype(int), np.floor(x).astype(int)
    shape = grid.values.shape
    top, left = max(0, -int(rows.min())), max(0, -int(columns.min()))
    bottom = max(0, int(rows.max()) + 1 - shape[0])
    right = max(0, int(columns.max()) + 1 - shape[1])
    values = np.pad(grid.values, ((top, bottom), (left, right)), constant_values=UNKNOWN)
    values[rows + top, columns + left] = OCCUPIED
    theta, cell = grid.frame.origin[2], grid.frame.resolution
    corner = grid.frame.point(-top - 0.5, -left - 0.5)
    return Grid(values, Frame(cell, (*corner, theta)))
