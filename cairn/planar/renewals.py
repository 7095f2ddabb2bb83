"""Renewed places of a map: parts of it in which only newer scans count."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Versions = NDArray[np.int32]

PATCH_M: Final = 0.1
"""Size of a patch [m]: the smallest place that is renewed."""

TILE: Final = 16
"""Patches on each side of a tile."""


class Renewals:
    """The version of the map since which scans count, for each patch of 0.1 m x 0.1 m.

    A scan counts in a patch if its version is not smaller. Patches that were never renewed have
    version 0. They are stored as tiles (TILE, TILE) by column and row; a tile has the rows of its
    patches first. A `Renewals` does not change; `renewed` returns another one.
    """

    def __init__(self, tiles: Mapping[tuple[int, int], Versions] | None = None) -> None:
        """Take the tiles by their column and row, counted from the map's origin."""
        self._tiles = dict(tiles or {})

    @property
    def tiles(self) -> Mapping[tuple[int, int], Versions]:
        """The tiles with renewed patches, by column and row."""
        return MappingProxyType(self._tiles)

    def renewed(self, patches: NDArray[np.int64], version: int) -> Renewals:
        """Return these renewals and those of some patches, (n, 2) columns and rows, by `version`.

        Raises `ValueError` if one of them has a newer version.
        """
        tiles = dict(self._tiles)
        homes = np.floor_divide(patches, TILE)
        for column, row in np.unique(homes, axis=0).tolist():
            inside = patches[(homes == (column, row)).all(axis=1)] - (column * TILE, row * TILE)
            tile = tiles.get((column, row), np.zeros((TILE, TILE), np.int32)).copy()
            if (tile[inside[:, 1], inside[:, 0]] > version).any():
                raise ValueError(f"version {version} is older than that of a patch")
            tile[inside[:, 1], inside[:, 0]] = version
            tiles[column, row] = tile
        return Renewals(tiles)

    def since(self, points: Array) -> Versions:
        """Return the version (n,) since which scans count at points (n, 2) [m] of the map."""
        patches = patches_of(points)
        homes = np.floor_divide(patches, TILE)
        found = np.zeros(len(points), np.int32)
        for column, row in np.unique(homes, axis=0).tolist():
            tile = self._tiles.get((column, row))
            if tile is not None:
                here = (homes == (column, row)).all(axis=1)
                inside = patches[here] - (column * TILE, row * TILE)
                found[here] = tile[inside[:, 1], inside[:, 0]]
        return found

    def cells(self, row: int, column: int, shape: tuple[int, int], resolution: float) -> Versions:
        """Return the version since which scans count in each cell of a window.

        Args:
            row: of the first cell, counted from the map's origin.
            column: the same.
            shape: rows and columns of the window.
            resolution: size of a cell [m].

        """
        found = np.zeros(shape, np.int32)
        rows = _patches_of_cells(row, shape[0], resolution)
        columns = _patches_of_cells(column, shape[1], resolution)
        for (tile_column, tile_row), tile in self._tiles.items():
            top, bottom = np.searchsorted(rows, (tile_row * TILE, (tile_row + 1) * TILE))
            left, right = np.searchsorted(columns, (tile_column * TILE, (tile_column + 1) * TILE))
            if top < bottom and left < right:
                inner = np.ix_(
                    rows[top:bottom] - tile_row * TILE, columns[left:right] - tile_column * TILE
                )
                found[top:bottom, left:right] = tile[inner]
        return found


def patches_of(points: Array) -> NDArray[np.int64]:
    """Return column and row (n, 2) of the patches with points (n, 2) [m] of the map."""
    return np.floor(points / PATCH_M).astype(np.int64)


def _patches_of_cells(first: int, count: int, resolution: float) -> NDArray[np.int64]:
    """Return the patches (count,) along one axis with the centers of successive cells."""
    centers: Array = (np.arange(first, first + count, dtype=np.float64) + 0.5) * resolution
    return patches_of(centers)
