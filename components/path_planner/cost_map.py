"""What it costs to pass each cell of the map: dear near obstacles, closed where the robot hits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
from cairn.planar.grid import (
    OCCUPIED_FROM,
    Frame,
    Grid,
    OccupancyCells,
    changed_window,
    distance_field,
)
from cairn.planar.shortest_path import (
    CLOSED,
    MARGIN,
    MAX_COST,
    MIN_COST,
    Cell,
    CellCosts,
    open_costs,
)

BLOCKED = 255
"""Price of a cell where the robot itself does not fit, let alone its margin."""


@dataclass(frozen=True)
class Costs:
    """How obstacles make cells dear.

    Cells whose cell_centers are within the robot's `radius`, its `margin` and half a cell [m] of an
    obstacle's are closed: no path leads through what motion control will not pass. Those closed by
    the margin alone do not break a path that exists, and the goal may be there. Beyond, a cell
    costs up to `weight` times its length more, falling to none over `reach` [m]. Unknown cells are
    closed unless `allow_unknown`.
    """

    radius: float
    reach: float
    weight: float
    margin: float
    allow_unknown: bool


class CostMap:
    """CellCosts of a map's cells, kept up with its changes, and with what the scanner sees on top.

    `map_prices` are those of the map alone, `prices` those with the scanner's obstacles, and with
    where motion control did not get on; both have the margin of `planar.shortest_path`.
    """

    def __init__(self, grid: OccupancyCells, costs: Costs) -> None:
        rows, columns = grid.values.shape
        self.frame: Frame = grid.frame
        self.costs = costs
        self._values = np.array(grid.values, np.int8)
        self._table = _table(costs, grid.frame.resolution)
        self._near = max(HELD_M, 1.5 * grid.frame.resolution)
        self._far = max(
            math.isqrt(self._table.size - 2) + 1, math.ceil(self._near / grid.frame.resolution)
        )
        self._held = np.zeros((rows, columns), np.bool_)
        self.map_prices: CellCosts = open_costs(rows, columns)
        self._price(0, rows, 0, columns)
        self.prices: CellCosts = self.map_prices.copy()
        self._overlaid = self._seen = self._hindered = np.empty((0, 2), np.int64)
        self._stained = (0, 0, 0, 0)

    @property
    def grid(self) -> OccupancyCells:
        """The map of the moment."""
        return Grid(self._values, self.frame)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        rows, columns = self._values.shape
        return rows, columns

    def take(self, grid: OccupancyCells) -> bool:
        """Take a new map in place of the last; False if it lies elsewhere or has another size."""
        if grid.frame != self.frame or grid.values.shape != self.shape:
            return False
        window = changed_window(self._values, grid.values)
        if window is not None:
            self.update(window[0].start, window[1].start, grid.values[window])
        return True

    def update(self, row: int, column: int, values: NDArray[np.int8]) -> bool:
        """Take new values of a window that begins at row, column; False if it leaves the map."""
        rows, columns = self.shape
        bottom, right = row + values.shape[0], column + values.shape[1]
        if row < 0 or column < 0 or bottom > rows or right > columns:
            return False
        if values.size == 0:
            return True
        self._values[row:bottom, column:right] = values
        top, bottom = max(0, row - self._far), min(rows, bottom + self._far)
        left, right = max(0, column - self._far), min(columns, right + self._far)
        self._price(top, bottom, left, right)
        window = np.s_[top + MARGIN : bottom + MARGIN, left + MARGIN : right + MARGIN]
        self.prices[window] = self.map_prices[window]
        self._lay()
        return True

    def overlay(self, cells: NDArray[np.int64]) -> None:
        """Lay the obstacles that the scanner sees, rows and columns (n, 2) of the map, on top.

        Those count which the map of the moment does not hold, nor an obstacle right beside.
        """
        if not np.array_equal(cells, self._overlaid):
            self._overlaid = cells
            self._lay()

    def hinder(self, places: Sequence[tuple[float, float]]) -> None:
        """Make all that is near these places x, y [m] as dear as can be, but close nothing."""
        cells = [cell for x, y in places if (cell := self.cell(x, y)) is not None]
        hindered = np.array(cells, np.int64).reshape(-1, 2)
        if not np.array_equal(hindered, self._hindered):
            self._hindered = hindered
            self._lay()

    def unknown(self, cell: Cell) -> bool:
        """Whether a cell of the map is closed because nobody knows what is there."""
        return bool(self._values[cell] < 0) and not self.costs.allow_unknown

    def obstacle(self, cell: Cell) -> bool:
        """Whether a cell of the map is an obstacle."""
        return bool(self._values[cell] >= OCCUPIED_FROM)

    def cell(self, x: float, y: float) -> Cell | None:
        """The cell that holds the place x, y [m]; None if it is outside the map."""
        column, row = self.frame.cells(x, y)
        rows, columns = self.shape
        return (int(row), int(column)) if 0 <= row < rows and 0 <= column < columns else None

    @property
    def overlaid(self) -> bool:
        """Whether the scanner sees obstacles that the map does not hold."""
        return len(self._seen) > 0

    def nearest_seen(self, x: float, y: float) -> tuple[float, float]:
        """x, y [m] of that obstacle seen by the scanner alone which is nearest to a place."""
        column, row = self.frame.cells(x, y)
        apart = np.hypot(self._seen[:, 0] + 0.5 - row, self._seen[:, 1] + 0.5 - column)
        nearest = self._seen[int(np.argmin(apart))]
        return self.frame.point(float(nearest[0]), float(nearest[1]))

    def _price(self, top: int, bottom: int, left: int, right: int) -> None:
        """Price a window anew by the obstacles in it and around."""
        rows, columns = self.shape
        up, low = max(0, top - self._far), min(rows, bottom + self._far)
        west, east = max(0, left - self._far), min(columns, right + self._far)
        obstacles = self._values[up:low, west:east] >= OCCUPIED_FROM
        resolution = self.frame.resolution
        distance = distance_field(obstacles, resolution)[
            top - up : bottom - up, left - west : right - west
        ]
        _fill(
            np.ascontiguousarray(distance),
            resolution,
            self._table,
            self._values[top:bottom, left:right],
            self.costs.allow_unknown,
            self.map_prices[top + MARGIN : bottom + MARGIN, left + MARGIN : right + MARGIN],
        )
        np.less_equal(distance, self._near, out=self._held[top:bottom, left:right])

    def _lay(self) -> None:
        """Take off what lay on top of the map, and lay on what it does not hold now."""
        top, bottom, left, right = self._stained
        self.prices[top:bottom, left:right] = self.map_prices[top:bottom, left:right]
        held = self._held[self._overlaid[:, 0], self._overlaid[:, 1]]
        self._seen = np.ascontiguousarray(self._overlaid[~held])
        laid = np.vstack((self._seen, self._hindered))
        if not len(laid):
            self._stained = (0, 0, 0, 0)
            return
        _stamp(self._seen, self._far, self._table, self.prices)
        around = math.ceil(HINDERED_M / self.frame.resolution)
        _make_dear(self._hindered, around, self.prices)
        far = max(self._far, around)
        low, high = laid.min(axis=0), laid.max(axis=0)
        rows, columns = self.prices.shape
        self._stained = (
            max(0, int(low[0]) + MARGIN - far),
            min(rows, int(high[0]) + MARGIN + far + 1),
            max(0, int(low[1]) + MARGIN - far),
            min(columns, int(high[1]) + MARGIN + far + 1),
        )


HINDERED_M = 0.45
"""Where motion control did not get on, the way is dear within this distance [m]: as if some 13 m
longer, straight through."""
HELD_M = 0.15
"""What the scanner sees this near [m] to an obstacle of the map is that obstacle."""


def nearest_open(prices: CellCosts, row: float, column: float) -> tuple[Cell, float] | None:
    """The cell that is not closed nearest to a place, given in cells, and how many cells off.

    None if all are closed.
    """
    found = _nearest_open(prices, row, column)
    if found[0] < 0:
        return None
    cell = (int(found[0]), int(found[1]))
    return cell, math.hypot(cell[0] + 0.5 - row, cell[1] + 0.5 - column)


def _table(costs: Costs, resolution: float) -> NDArray[np.uint8]:
    """Price by squared distance [cells^2] to the nearest obstacle; the last one holds beyond."""
    blocked = costs.radius + 0.5 * resolution
    closed = blocked + costs.margin
    last = math.ceil((closed + costs.reach) / resolution)
    distance = np.sqrt(np.arange(last * last + 2, dtype=np.float64)) * resolution
    share = np.clip(1.0 - (distance - closed) / max(costs.reach, 1e-9), 0.0, 1.0)
    price = np.minimum(np.rint(MIN_COST * (1.0 + costs.weight * share**2)), MAX_COST)
    price[distance <= closed + 1e-9] = CLOSED
    price[distance <= blocked + 1e-9] = BLOCKED
    price[-1] = MIN_COST
    table: NDArray[np.uint8] = price.astype(np.uint8)
    return table


@compiled("void(float32[:,::1], float64, uint8[::1], int8[:,:], boolean, uint8[:,:])")
def _fill(
    distance: NDArray[np.float32],
    resolution: float,
    table: NDArray[np.uint8],
    values: NDArray[np.int8],
    allow_unknown: bool,
    prices: CellCosts,
) -> None:
    """Price cells by their distance to obstacles."""
    last = table.size - 1
    cut = math.sqrt(last) * resolution
    scale = 1.0 / (resolution * resolution)
    for row in range(distance.shape[0]):
        for column in range(distance.shape[1]):
            if values[row, column] < 0 and not allow_unknown:
                prices[row, column] = BLOCKED
                continue
            d = float(distance[row, column])
            if d >= cut:
                prices[row, column] = table[last]
            else:
                prices[row, column] = table[int(d * d * scale + 0.5)]


@compiled("void(int64[:,::1], int64, uint8[::1], uint8[:,::1])")
def _stamp(cells: NDArray[np.int64], far: int, table: NDArray[np.uint8], prices: CellCosts) -> None:
    """Raise the prices around each obstacle to what its distance makes them."""
    last = table.size - 1
    for i in range(len(cells)):
        row, column = cells[i, 0] + MARGIN, cells[i, 1] + MARGIN
        for r in range(max(0, row - far), min(prices.shape[0], row + far + 1)):
            for c in range(max(0, column - far), min(prices.shape[1], column + far + 1)):
                apart = (r - row) * (r - row) + (c - column) * (c - column)
                if apart < last and table[apart] > prices[r, c]:
                    prices[r, c] = table[apart]


@compiled("void(int64[:,::1], int64, uint8[:,::1])")
def _make_dear(cells: NDArray[np.int64], far: int, prices: CellCosts) -> None:
    """Raise the prices around each cell to the highest of those that are not closed."""
    for i in range(len(cells)):
        row, column = cells[i, 0] + MARGIN, cells[i, 1] + MARGIN
        for r in range(max(0, row - far), min(prices.shape[0], row + far + 1)):
            for c in range(max(0, column - far), min(prices.shape[1], column + far + 1)):
                within = (r - row) * (r - row) + (c - column) * (c - column) <= far * far
                if within and prices[r, c] < CLOSED:
                    prices[r, c] = MAX_COST


@compiled("UniTuple(int64, 2)(uint8[:,::1], float64, float64)")
def _nearest_open(prices: CellCosts, row: float, column: float) -> tuple[int, int]:
    """Search in growing squares around the place; (-1, -1) if all is closed."""
    rows, columns = prices.shape[0] - 2 * MARGIN, prices.shape[1] - 2 * MARGIN
    middle_row = int(min(max(math.floor(row), 0), rows - 1))
    middle_column = int(min(max(math.floor(column), 0), columns - 1))
    found_row, found_column, least = -1, -1, math.inf
    beside = max(abs(row - middle_row - 0.5), abs(column - middle_column - 0.5))
    for ring in range(max(rows, columns)):
        if max(0.0, ring - beside) ** 2 > least:
            break
        for r in range(max(0, middle_row - ring), min(rows, middle_row + ring + 1)):
            whole = abs(r - middle_row) == ring
            step = 1 if whole else max(1, 2 * ring)
            for c in range(middle_column - ring, middle_column + ring + 1, step):
                if c < 0 or c >= columns or prices[r + MARGIN, c + MARGIN] >= CLOSED:
                    continue
                apart = (r + 0.5 - row) ** 2 + (c + 0.5 - column) ** 2
                if apart < least:
                    found_row, found_column, least = r, c, apart
    return found_row, found_column
