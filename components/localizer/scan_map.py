"""The grid map as the localizer uses it: likelihood fields and free space, kept up to date."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.free_space import FreeSpace
from cairn.components.localizer.likelihood_field import LikelihoodField
from cairn.planar.grid import Grid, OccupancyCells, changed_window

# Deviation of a beam [m] for a first look at the whole map, where few poses are drawn near any.
_WIDE_M = 0.35


class ScanMap:
    """Likelihood fields of one grid map: `field` for a beam of deviation `beam_sd_m`, and, made
    when they are first asked for, `wide` for a loose one and the map's `free` space.
    """

    def __init__(self, grid: OccupancyCells, beam_sd_m: float, stray: float) -> None:
        self._grid: OccupancyCells = Grid(np.array(grid.values), grid.frame)
        self._stray = stray
        self.field = LikelihoodField(grid, beam_sd_m, stray)
        self._wide: LikelihoodField | None = None
        self._free: FreeSpace | None = None

    @property
    def wide(self) -> LikelihoodField:
        """The field of a loose beam."""
        if self._wide is None:
            self._wide = LikelihoodField(self._grid, _WIDE_M, self._stray)
        return self._wide

    @property
    def free(self) -> FreeSpace:
        """Where a robot may be."""
        if self._free is None:
            self._free = FreeSpace(self._grid)
        return self._free

    def take(self, grid: OccupancyCells) -> bool:
        """Take a new map in place of the last; False if it lies elsewhere or has another size."""
        if grid.frame != self._grid.frame or grid.values.shape != self._grid.values.shape:
            return False
        window = changed_window(self._grid.values, grid.values)
        if window is not None:
            self.renew(window[0].start, window[1].start, grid.values[window])
        return True

    def fits(self, row: int, column: int, values: NDArray[np.int8]) -> bool:
        """Whether a window of cells lies on the map."""
        rows, columns = self._grid.values.shape
        height, width = values.shape
        return bool(0 <= row <= rows - height and 0 <= column <= columns - width)

    def renew(self, row: int, column: int, values: NDArray[np.int8]) -> None:
        """Take new `values` (rows, columns) of the window that begins at a cell of the map."""
        height, width = values.shape
        self._grid.values[row : row + height, column : column + width] = values
        self.field.renew(row, column, values)
        self._wide = self._free = None
