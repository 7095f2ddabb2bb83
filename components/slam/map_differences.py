"""Where the repaired grid map and the drawing of the graph have different obstacles."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.errors import CairnError
from cairn.planar.grid import OCCUPIED_FROM, OccupancyCells
from cairn.planar.poses import Pose
from cairn.planar.scan_grid import ScanGrid
from cairn.planar.scans import Rays

Block = tuple[int, int]
"""Column and row of a square of `BLOCK_M`, counted from the map's origin."""

Cells = NDArray[np.int8]
Mask = NDArray[np.bool_]

BLOCK_M = 0.5
"""Size of the squares by which differences are collected [m]."""

# Obstacles this near to each other are the same [cells]: as in the repair of the grid map.
_NEAR = 2
_TURNED = 1e-3  # heading of the grid map from which on it is not that of the graph [rad]


class MapDifferences:
    """The cells in which the repaired grid map differs from the drawing of a graph.

    A cell differs if it is an obstacle in one of them, and no cell nearer than three cells is one
    in the other. Rows and columns of windows count from the map's origin.
    """

    def __init__(self, grid: OccupancyCells, drawing: ScanGrid) -> None:
        """Compare a grid map with a drawing of the same resolution.

        Raises `CairnError` if the grid map's axes are not those of the map.
        """
        x, y, theta = grid.frame.origin
        if abs(theta) > _TURNED:
            raise CairnError(
                f"the grid map is turned by {theta:.3f} rad, so it is not drawn from the graph; "
                "give the grid map that was made with the graph"
            )
        self.resolution = grid.frame.resolution
        self.row, self.column = round(y / self.resolution), round(x / self.resolution)
        self.cells: Cells = np.array(grid.values)
        self._drawing = drawing
        self._differs = np.zeros(self.cells.shape, bool)
        self.compare()

    @property
    def count(self) -> int:
        """Number of cells that differ."""
        return int(np.count_nonzero(self._differs))

    def update(self, row: int, column: int, values: Cells) -> None:
        """Replace cells of the grid map from this row and column of it on."""
        rows = slice(row, row + values.shape[0])
        columns = slice(column, column + values.shape[1])
        self.cells[rows, columns] = values
        self._compare(rows, columns)

    def compare(self) -> None:
        """Compare all cells, as after the drawing has changed."""
        rows, columns = self.cells.shape
        self._compare(slice(0, rows), slice(0, columns))

    def blocks(self) -> dict[Block, frozenset[tuple[int, int]]]:
        """Return the cells that differ, as rows and columns of the grid map, by their block."""
        found: dict[Block, set[tuple[int, int]]] = defaultdict(set)
        rows, columns = np.nonzero(self._differs)
        block_rows, block_columns = self._blocks_of(rows, columns)
        for key, cell in zip(
            zip(block_columns.tolist(), block_rows.tolist(), strict=True),
            zip(rows.tolist(), columns.tolist(), strict=True),
            strict=True,
        ):
            found[key].add(cell)
        return {key: frozenset(cells) for key, cells in found.items()}

    def window_of(self, blocks: Iterable[Block], margin: int) -> tuple[slice, slice, Mask]:
        """Return rows and columns of the grid map with some blocks, and which cells are theirs.

        The window is larger by `margin` cells on each side, as far as the grid map goes, and the
        blocks by two cells.
        """
        keys = np.array(sorted(blocks))
        per_block = BLOCK_M / self.resolution
        most_rows, most_columns = self.cells.shape
        rows = slice(
            max(0, math.floor(keys[:, 1].min() * per_block) - self.row - margin),
            min(most_rows, math.ceil((keys[:, 1].max() + 1) * per_block) - self.row + margin),
        )
        columns = slice(
            max(0, math.floor(keys[:, 0].min() * per_block) - self.column - margin),
            min(most_columns, math.ceil((keys[:, 0].max() + 1) * per_block) - self.column + margin),
        )
        block_rows, block_columns = self._blocks_of(
            np.arange(rows.start, rows.stop), np.arange(columns.start, columns.stop)
        )
        inside = np.zeros((len(block_rows), len(block_columns)), bool)
        for column, row in keys.tolist():
            inside |= (block_rows == row)[:, None] & (block_columns == column)[None, :]
        return rows, columns, _widened(inside)

    def drawn(self, rows: slice, columns: slice) -> Cells:
        """Return the cells of the drawing in a window of the grid map."""
        shape = rows.stop - rows.start, columns.stop - columns.start
        return self._drawing.window(self.row + rows.start, self.column + columns.start, shape)

    def explained(self, pose: Pose, rays: Rays) -> Rays:
        """Return the rays of a scan without those that end where the grid map has no obstacle.

        These ended at people and other things that do not stay.
        """
        placed = rays.placed(pose)
        hit = np.isfinite(placed.ranges)
        ends = np.floor(placed.points() / self.resolution).astype(np.int64)
        row, column = ends[:, 1] - self.row, ends[:, 0] - self.column
        rows, columns = self.cells.shape
        known = np.zeros(len(ends), bool)
        for dy in range(-_NEAR, _NEAR + 1):
            for dx in range(-_NEAR, _NEAR + 1):
                r, c = row + dy, column + dx
                inside = (r >= 0) & (r < rows) & (c >= 0) & (c < columns)
                known[inside] |= self.cells[r[inside], c[inside]] >= OCCUPIED_FROM
        ranges = rays.ranges.copy()
        ranges[np.flatnonzero(hit)[~known]] = math.nan
        return Rays(rays.starts, rays.angles, ranges, rays.reach)

    def _blocks_of(
        self, rows: NDArray[np.int64], columns: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return rows and columns of the blocks with cells of these rows and columns."""
        cells_per_block = BLOCK_M / self.resolution
        block_rows = np.floor((rows + self.row + 0.5) / cells_per_block).astype(np.int64)
        block_columns = np.floor((columns + self.column + 0.5) / cells_per_block).astype(np.int64)
        return block_rows, block_columns

    def _compare(self, rows: slice, columns: slice) -> None:
        """Compare the cells of a window, and those around it that its cells may explain."""
        wide, inner = (
            tuple(
                slice(max(0, part.start - margin), min(most, part.stop + margin))
                for part, most in zip((rows, columns), self.cells.shape, strict=True)
            )
            for margin in (2 * _NEAR, _NEAR)
        )
        found = differing(self.cells[wide], self.drawn(*wide))
        self._differs[inner] = found[
            inner[0].start - wide[0].start : inner[0].stop - wide[0].start,
            inner[1].start - wide[1].start : inner[1].stop - wide[1].start,
        ]


def differing(first: Cells, second: Cells) -> Mask:
    """Return which cells of two windows differ, as in `MapDifferences`."""
    a, b = first >= OCCUPIED_FROM, second >= OCCUPIED_FROM
    differs: Mask = (a & ~_widened(b)) | (b & ~_widened(a))
    return differs


def _widened(mask: Mask) -> Mask:
    size = 2 * _NEAR + 1
    wide: Mask = cv2.dilate(mask.view(np.uint8), np.ones((size, size), np.uint8)) > 0
    return wide
