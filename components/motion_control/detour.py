"""Looks for a way around what stands on the path, on a small grid of what the scanner sees."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.components.motion_control.arcs import sees
from cairn.components.motion_control.limits import Limits
from cairn.planar.grid import distance_field
from cairn.planar.shortest_path import CLOSED, MARGIN, MIN_COST, PathSearch, open_costs

Array = NDArray[np.float64]

_CELL, _HALF = 0.05, 48  # size of a cell [m]; cells from the robot to the grid's edge
WITHIN = _CELL * (_HALF - 2)
"""A place this far [m] ahead and aside can be looked for."""

# Nearer to obstacles than this beyond the margin [m] a way is dearer, up to that price.
_WIDE, _DEAR = 0.2, 60.0
# Corners are cut only with so much more room [m], as scans are noisy.
_SPARE = 0.06
# A cell's center may be so far [m] from the point in it, which the margin allows for.
_ROUNDING = 0.01
# A detour may be so much longer than the straight line, by share [1] and by length [m].
_LONGER, _MORE = 2.0, 0.6


class DetourSearch:
    """Finds ways of the robot among points; keeps the memory that it works in."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._prices = open_costs(2 * _HALF, 2 * _HALF)
        self._search = PathSearch(self._prices.shape)

    def find(self, points: Array, x: float, y: float) -> Array | None:
        """A way (n, 2) [m] from the robot's center to x, y [m] in its frame; None if there is none.

        `points` (m, 2) [m] are the obstacles. Where the robot stands within the margin of some the
        way leads out of it.
        """
        goal = _cell(x, y)
        start = (_HALF, _HALF)
        distances = self._distances(points)
        limits = self._limits
        kept = limits.kept - _ROUNDING
        wide = np.clip((kept + _WIDE - distances) / _WIDE, 0.0, 1.0)
        inner = self._prices[MARGIN:-MARGIN, MARGIN:-MARGIN]
        inner[:] = MIN_COST + _DEAR * wide
        closed = distances < kept
        inner[closed] = CLOSED
        if closed[start]:
            self._leave(inner, closed, distances)
        if inner[goal] >= CLOSED:
            return None
        cells = self._search.find(self._prices, start, goal).cells
        if cells is None:
            return None
        way: Array = (cells[:, ::-1].astype(np.float64) - _HALF + 0.5) * _CELL
        way[0], way[-1] = (0.0, 0.0), (x, y)
        length = float(np.hypot(*np.diff(way, axis=0).T).sum())
        if length > _LONGER * math.hypot(x, y) + _MORE:
            return None
        return self._straightened(way, points)

    def _distances(self, points: Array) -> NDArray[np.float32]:
        taken = np.zeros((2 * _HALF, 2 * _HALF), np.bool_)
        cells = np.floor(points / _CELL).astype(np.int64) + _HALF
        cells = cells[((cells >= 0) & (cells < 2 * _HALF)).all(axis=1)]
        taken[cells[:, 1], cells[:, 0]] = True
        return distance_field(taken, _CELL)

    def _leave(
        self,
        prices: NDArray[np.uint8],
        closed: NDArray[np.bool_],
        distances: NDArray[np.float32],
    ) -> None:
        """Open what is as far from obstacles as the robot is now, dear as it is."""
        reach = math.ceil(self._limits.kept / _CELL) + 1
        near = slice(_HALF - reach, _HALF + reach + 1)
        least = distances[_HALF, _HALF] - 0.01
        opened = closed[near, near] & (distances[near, near] >= least)
        prices[near, near][opened] = round(MIN_COST + 2.0 * _DEAR)

    def _straightened(self, way: Array, points: Array) -> Array:
        """The way by those of its points that see one another."""
        corners = [0]
        last = way.shape[0] - 1
        while corners[-1] < last:
            here = corners[-1]
            beyond = np.arange(here + 1, last + 1)
            seen = np.empty(beyond.size, np.bool_)
            x, y = way[here]
            sees(points, way[beyond], x, y, self._limits.kept + _SPARE, seen)
            hidden = np.flatnonzero(~seen)
            reached = int(hidden[0]) if hidden.size else int(beyond.size)
            corners.append(here + max(1, reached))
        straightened: Array = way[corners]
        return straightened


def _cell(x: float, y: float) -> tuple[int, int]:
    """Row and column of a place in the robot's frame."""
    return math.floor(y / _CELL) + _HALF, math.floor(x / _CELL) + _HALF
