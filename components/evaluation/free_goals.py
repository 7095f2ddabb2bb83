"""Random goals that can be reached, and how long the shortest way to them is."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planar.distance import distance_field
from planar.grid import UNKNOWN, OccupancyCells
from planar.path_shape import taut
from planar.poses import Pose
from planar.shortest_path import CLOSED, MARGIN, PathSearch, priced

_TRIES = 1000
# From this probability [%] on a cell is an obstacle.
_OBSTACLE = 65


class FreeGoals:
    """The free space of a map for a robot of `radius` [m]; goals keep `clearance` [m] more."""

    def __init__(self, grid: OccupancyCells, radius: float, clearance: float) -> None:
        self._grid = grid
        blocked = (grid.values >= _OBSTACLE) | (grid.values == UNKNOWN)
        room = distance_field(blocked, grid.frame.resolution)
        self._prices = priced(*grid.values.shape)
        inner = self._prices[MARGIN:-MARGIN, MARGIN:-MARGIN]
        # Distances are between centres of cells: the obstacle begins half a cell nearer.
        inner[room < radius + 0.5 * grid.frame.resolution] = CLOSED
        self._roomy = np.argwhere(room > radius + clearance)
        self._search = PathSearch(self._prices.shape)

    def draw(self, start: Pose, least_m: float, random: np.random.Generator) -> Pose | None:
        """A goal at least `least_m` [m] from `start` that can be reached; None if there is none."""
        if not len(self._roomy):
            return None
        for _ in range(_TRIES):
            row, column = self._roomy[random.integers(0, len(self._roomy))]
            x, y = self._grid.frame.point(int(row), int(column))
            if math.hypot(x - start[0], y - start[1]) < least_m:
                continue
            goal = (x, y, float(random.uniform(-math.pi, math.pi)))
            if math.isfinite(self.shortest(start, goal)):
                return goal
        return None

    def shortest(self, start: Pose, goal: Pose) -> float:
        """Length [m] of the shortest way between two poses; infinite if there is none."""
        frame = self._grid.frame
        first, last = (self._nearest_open(*frame.cell(p[0], p[1])) for p in (start, goal))
        if first is None or last is None:
            return math.inf
        way = self._search.way(self._prices, first, last)
        if way.cells is None:
            return math.inf
        points = np.ascontiguousarray(way.cells[:, ::-1] + 0.5, np.float64)
        pulled = taut(self._prices, points)
        steps = np.hypot(*np.diff(pulled, axis=0).T)
        return float(steps.sum()) * frame.resolution

    def _nearest_open(self, row: int, column: int) -> tuple[int, int] | None:
        """The cell itself, or an open one within 0.3 m: the robot may stand beside a wall."""
        inner = self._prices[MARGIN:-MARGIN, MARGIN:-MARGIN]
        rows, columns = inner.shape
        reach = math.ceil(0.3 / self._grid.frame.resolution)
        top, left = max(0, row - reach), max(0, column - reach)
        window = inner[top : min(rows, row + reach + 1), left : min(columns, column + reach + 1)]
        if window.size == 0:
            return None
        cells = np.argwhere(window < CLOSED)
        if not len(cells):
            return None
        apart = np.hypot(cells[:, 0] + top - row, cells[:, 1] + left - column)
        best = cells[int(np.argmin(apart))]
        return int(best[0]) + top, int(best[1]) + left


def painted(grid: OccupancyCells) -> NDArray[np.uint8]:
    """The map as a picture: white free, black occupied, grey unknown; row 0 at the bottom."""
    picture = np.full(grid.values.shape, 200, np.uint8)
    picture[(grid.values >= 0) & (grid.values <= 25)] = 255
    picture[grid.values >= _OBSTACLE] = 0
    return picture
