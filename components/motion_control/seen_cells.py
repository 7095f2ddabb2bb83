"""Where the ground around the robot was seen, and when last: in cells of the odometry frame."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
from cairn.planar.scans import Rays

Array = NDArray[np.float64]
Cells = NDArray[np.int64]

SEEN_REACH = 1.6
"""Cells are looked at up to this distance [m] from the scanner."""
CELL = 0.1
"""Size of a cell [m]."""

_SIDE = 64  # cells that are kept each way; those so many apart share a place
_STAMP, _ROW, _COLUMN = 0, 1, 2
_NEVER = -(2**62)


class SeenCells:
    """The time [ns] when each cell was seen last, of those seen last."""

    def __init__(self) -> None:
        self._cells = np.zeros((_SIDE, _SIDE, 3), np.int64)
        self.forget()

    def forget(self) -> None:
        """Forget all."""
        self._cells[:, :, _STAMP] = _NEVER

    def stand(self, stamp: int, x: float, y: float, radius: float) -> None:
        """The robot stands there: so nothing else does."""
        _mark_disc(self._cells, x, y, radius, stamp)

    def see(self, stamp: int, rays: Rays) -> None:
        """Take what the rays of a scan passed through."""
        _mark_rays(self._cells, rays.starts, rays.angles, rays.ranges, stamp)

    def share(
        self, x: float, y: float, angle: float, length: float, half: float, since: int
    ) -> float:
        """Share of what is within `half` [m] of a line that was seen since that time.

        What is within `half` of the line's begin does not count.
        """
        return _share(self._cells, x, y, angle, length, half, since)


@compiled()
def _mark(cells: Cells, row: int, column: int, stamp: int) -> None:
    r, c = row % _SIDE, column % _SIDE
    cells[r, c, _STAMP], cells[r, c, _ROW], cells[r, c, _COLUMN] = stamp, row, column


@compiled("void(int64[:,:,::1], float64, float64, float64, int64)")
def _mark_disc(cells: Cells, x: float, y: float, radius: float, stamp: int) -> None:
    reach = math.ceil(radius / CELL)
    row, column = math.floor(y / CELL), math.floor(x / CELL)
    for r in range(row - reach, row + reach + 1):
        for c in range(column - reach, column + reach + 1):
            dx, dy = (c + 0.5) * CELL - x, (r + 0.5) * CELL - y
            if dx * dx + dy * dy <= (radius + 0.5 * CELL) ** 2:
                _mark(cells, r, c, stamp)


@compiled("void(int64[:,:,::1], float64[:,::1], float64[::1], float64[::1], int64)")
def _mark_rays(cells: Cells, starts: Array, angles: Array, ranges: Array, stamp: int) -> None:
    for i in range(ranges.size):
        if math.isnan(ranges[i]):
            continue
        dx, dy = 0.5 * CELL * math.cos(angles[i]), 0.5 * CELL * math.sin(angles[i])
        for k in range(int(min(ranges[i], SEEN_REACH) / (0.5 * CELL)) + 1):
            row = math.floor((starts[i, 1] + k * dy) / CELL)
            column = math.floor((starts[i, 0] + k * dx) / CELL)
            _mark(cells, row, column, stamp)


@compiled("float64(int64[:,:,::1], float64, float64, float64, float64, float64, int64)")
def _share(
    cells: Cells, x: float, y: float, angle: float, length: float, half: float, since: int
) -> float:
    cosine, sine = math.cos(angle), math.sin(angle)
    reach = math.ceil((length + half) / CELL) + 1
    row, column = math.floor(y / CELL), math.floor(x / CELL)
    count = seen = 0
    for r in range(row - reach, row + reach + 1):
        for c in range(column - reach, column + reach + 1):
            dx, dy = (c + 0.5) * CELL - x, (r + 0.5) * CELL - y
            along, across = cosine * dx + sine * dy, cosine * dy - sine * dx
            beyond = along - min(max(along, 0.0), length)
            if beyond * beyond + across * across <= half * half < dx * dx + dy * dy:
                count += 1
                place = cells[r % _SIDE, c % _SIDE]
                if place[_STAMP] >= since and place[_ROW] == r and place[_COLUMN] == c:
                    seen += 1
    return 1.0 if count == 0 else seen / count
