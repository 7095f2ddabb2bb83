"""Detours: find a path around an obstacle on the way, on a small grid around the robot."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.components.motion_control.collision_checks import check_straight_lines
from cairn.components.motion_control.velocity_limits import MotionLimits
from cairn.planar.grid import distance_field
from cairn.planar.shortest_path import CLOSED, MARGIN, MIN_COST, PathSearch, open_costs

Array = NDArray[np.float64]

# Where no other reason is given, these constants were chosen by hand; `lab/constants.yaml`
# has the effect of half and double.

_CELL_M, _HALF = 0.05, 48  # size of a cell [m]; cells from the robot to the grid's edge
SEARCH_RANGE_M = _CELL_M * (_HALF - 2)
"""Detours end within this distance [m] ahead and aside."""

# Within this distance beyond the margin [m] cells are more expensive, by up to this cost.
_COST_RANGE_M, _MAX_EXTRA_COST = 0.2, 60.0
# Corners are cut only with so much more clearance [m], as scans are noisy.
_SPARE_M = 0.06
# A cell's center may be so far [m] from the point in it; the margin allows for that. A cell that is
# nearer to an obstacle than the robot by no more than this [m] is as far from it.
_ROUNDING_M = 0.01
# A detour may be longer than the straight line by this factor [1] and length [m]; a longer one is
# left to the path planner.
_MAX_FACTOR, _MAX_EXTRA_M = 2.0, 0.6


class DetourSearch:
    """Finds paths of the robot among points, in memory that is allocated once."""

    def __init__(self, limits: MotionLimits) -> None:
        self._limits = limits
        self._costs = open_costs(2 * _HALF, 2 * _HALF)
        self._search = PathSearch(self._costs.shape)

    def find(self, points: Array, x: float, y: float) -> Array | None:
        """Return a path (n, 2) [m] from the robot's center to x, y [m] in its frame, or None.

        `points` (m, 2) [m] are the obstacles. A robot that stands within the margin of some is led
        out of it.
        """
        goal = _cell(x, y)
        start = (_HALF, _HALF)
        distances = self._distances(points)
        limits = self._limits
        free_radius = limits.keepout_radius - _ROUNDING_M
        wide = np.clip((free_radius + _COST_RANGE_M - distances) / _COST_RANGE_M, 0.0, 1.0)
        inner = self._costs[MARGIN:-MARGIN, MARGIN:-MARGIN]
        inner[:] = MIN_COST + _MAX_EXTRA_COST * wide
        closed = distances < free_radius
        inner[closed] = CLOSED
        if closed[start]:
            self._open_exit(inner, closed, distances)
        if inner[goal] >= CLOSED:
            return None
        cells = self._search.find(self._costs, start, goal).cells
        if cells is None:
            return None
        path: Array = (cells[:, ::-1].astype(np.float64) - _HALF + 0.5) * _CELL_M
        path[0], path[-1] = (0.0, 0.0), (x, y)
        length = float(np.hypot(*np.diff(path, axis=0).T).sum())
        if length > _MAX_FACTOR * math.hypot(x, y) + _MAX_EXTRA_M:
            return None
        return self._only_corners(path, points)

    def _distances(self, points: Array) -> NDArray[np.float32]:
        occupied = np.zeros((2 * _HALF, 2 * _HALF), np.bool_)
        cells = np.floor(points / _CELL_M).astype(np.int64) + _HALF
        cells = cells[((cells >= 0) & (cells < 2 * _HALF)).all(axis=1)]
        occupied[cells[:, 1], cells[:, 0]] = True
        return distance_field(occupied, _CELL_M)

    def _open_exit(
        self,
        costs: NDArray[np.uint8],
        closed: NDArray[np.bool_],
        distances: NDArray[np.float32],
    ) -> None:
        """Open the cells that are as far from obstacles as the robot is now, at a high cost."""
        reach = math.ceil(self._limits.keepout_radius / _CELL_M) + 1
        near = slice(_HALF - reach, _HALF + reach + 1)
        least = distances[_HALF, _HALF] - _ROUNDING_M
        opened = closed[near, near] & (distances[near, near] >= least)
        costs[near, near][opened] = round(MIN_COST + 2.0 * _MAX_EXTRA_COST)

    def _only_corners(self, path: Array, points: Array) -> Array:
        """Return the corners of the path: what lies between two that see each other is dropped."""
        corners = [0]
        last = path.shape[0] - 1
        while corners[-1] < last:
            here = corners[-1]
            beyond = np.arange(here + 1, last + 1)
            visible = np.empty(beyond.size, np.bool_)
            x, y = path[here]
            check_straight_lines(
                points, path[beyond], x, y, self._limits.keepout_radius + _SPARE_M, visible
            )
            hidden = np.flatnonzero(~visible)
            reached = int(hidden[0]) if hidden.size else int(beyond.size)
            corners.append(here + max(1, reached))
        straightened: Array = path[corners]
        return straightened


def _cell(x: float, y: float) -> tuple[int, int]:
    """Return row and column of a position in the robot's frame."""
    return math.floor(y / _CELL_M) + _HALF, math.floor(x / _CELL_M) + _HALF
