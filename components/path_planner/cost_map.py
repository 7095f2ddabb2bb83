"""The cost map: obstacles and keepout zones are inflated by the robot's size and safety margin."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.components.path_planner.zone_cells import (
    ZoneCells,
    multiply_costs,
    nearest_keepout,
)
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
from cairn.planar.zone_cells import Window
from cairn.schemas.cairn_nav_msgs import Zone

BLOCKED = 255
"""Cost of a cell in which the robot itself does not fit, even without its margin."""

WALL_M = 2.0
"""An obstacle that extends so far [m] is a wall: what people move is smaller. Chosen by hand."""


@dataclass(frozen=True)
class CostParameters:
    """How obstacles are inflated.

    Cells whose centers are within `radius`, `margin` and half a cell [m] of an obstacle's center
    are closed: no path leads where motion control would not drive. Cells that only the margin
    closes do not break an existing path, and the goal may be in one. Beyond, a cell costs up to
    `inflation_weight` times its length more, decreasing to none over `inflation_distance` [m].
    Unknown cells are closed unless `allow_unknown`.

    `speed` [m/s] is the robot's outside slow zones. If the map has lanes, cells outside of them
    cost `off_lane` times as much [1].
    """

    radius: float
    inflation_distance: float
    inflation_weight: float
    margin: float
    allow_unknown: bool
    speed: float = 0.6
    off_lane: float = 1.5


class CostMap:
    """Costs of a map's cells, updated with map, zones, obstacles of the scanner, avoided positions.

    `map_costs` are those of the map and its zones alone; `cell_costs` include the scanner's
    obstacles and the avoided positions. Both have the margin of `planar.shortest_path`.
    """

    def __init__(
        self, grid: OccupancyCells, costs: CostParameters, zones: Sequence[Zone] = ()
    ) -> None:
        rows, columns = grid.values.shape
        self.frame: Frame = grid.frame
        self.costs = costs
        self._values = np.array(grid.values, np.int8)
        self._inflation_table = _inflation_table(costs, grid.frame.resolution)
        self._same_distance = max(SAME_OBSTACLE_M, _SAME_CELLS * grid.frame.resolution)
        self._inflation_cells = max(
            math.isqrt(self._inflation_table.size - 2) + 1,
            math.ceil(self._same_distance / grid.frame.resolution),
        )
        self._mapped = np.zeros((rows, columns), np.bool_)
        self.map_costs: CellCosts = open_costs(rows, columns)
        self._costs_without_keepout = self.map_costs  # the same array unless there are such zones
        self._zone_cells = ZoneCells(grid.frame, self.shape, costs.speed, costs.off_lane)
        self._replace_zones(zones)
        self._update_costs(0, rows, 0, columns)
        self.cell_costs: CellCosts = self.map_costs.copy()
        self._scanner_cells = self._unmapped_cells = self._avoided_cells = np.empty(
            (0, 2), np.int64
        )
        self._overlay_window = (0, 0, 0, 0)

    @property
    def grid(self) -> OccupancyCells:
        """The current map."""
        return Grid(self._values, self.frame)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        rows, columns = self._values.shape
        return rows, columns

    def replace_map(self, grid: OccupancyCells) -> bool:
        """Replace the map; return False if the new one has another frame or size."""
        if grid.frame != self.frame or grid.values.shape != self.shape:
            return False
        window = changed_window(self._values, grid.values)
        if window is not None:
            self.update(window[0].start, window[1].start, grid.values[window])
        return True

    def update(self, row: int, column: int, values: NDArray[np.int8]) -> bool:
        """Replace a window that starts at row, column; return False if it leaves the map."""
        rows, columns = self.shape
        bottom, right = row + values.shape[0], column + values.shape[1]
        if row < 0 or column < 0 or bottom > rows or right > columns:
            return False
        if values.size == 0:
            return True
        window = np.s_[row:bottom, column:right]
        self._values[window] = values
        self._update_around(window)
        return True

    def set_zones(self, zones: Sequence[Zone]) -> None:
        """Replace the zones of the map."""
        window = self._replace_zones(zones)
        if window is not None:
            self._update_around(window)

    def set_scanner_obstacles(self, cells: NDArray[np.int64]) -> None:
        """Set the obstacles that the scanner sees: rows and columns (n, 2) of the map.

        Only those count that are not at, or right beside, an obstacle of the current map.
        """
        if not np.array_equal(cells, self._scanner_cells):
            self._scanner_cells = cells
            self._apply_overlay()

    def set_avoided_positions(self, places: Sequence[tuple[float, float]]) -> None:
        """Raise costs near these positions x, y [m] as far as possible without closing cells."""
        cells = [cell for x, y in places if (cell := self.cell(x, y)) is not None]
        avoided_cells = np.array(cells, np.int64).reshape(-1, 2)
        if not np.array_equal(avoided_cells, self._avoided_cells):
            self._avoided_cells = avoided_cells
            self._apply_overlay()

    @property
    def has_keepout_zones(self) -> bool:
        """Whether the map has keepout zones."""
        return self._zone_cells.keepout is not None

    def is_in_keepout(self, cell: Cell) -> bool:
        """Return whether a cell of the map is in a keepout zone."""
        return self._zone_cells.keepout is not None and bool(self._zone_cells.keepout[cell])

    def is_closed_by_keepout(self, cell: Cell) -> bool:
        """Return whether a cell is closed only because of a keepout zone in it or near."""
        at = cell[0] + MARGIN, cell[1] + MARGIN
        return bool(self._costs_without_keepout[at] < CLOSED <= self.map_costs[at])

    def nearest_keepout(self, x: float, y: float) -> tuple[str, float]:
        """Return name and distance [m] of the keepout zone nearest to a position; 0 inside."""
        return nearest_keepout(self._zone_cells.zones, x, y)

    def costs_without_keepout(self) -> CellCosts:
        """Return what the cells would cost without keepout zones, with the scanner's obstacles."""
        cell_costs = self._costs_without_keepout.copy()
        _inflate(self._unmapped_cells, self._inflation_cells, self._inflation_table, cell_costs)
        return cell_costs

    def is_unknown_space(self, cell: Cell) -> bool:
        """Return whether a cell of the map is closed because it is unknown."""
        return bool(self._values[cell] < 0) and not self.costs.allow_unknown

    def is_obstacle(self, cell: Cell) -> bool:
        """Return whether a cell of the map is an obstacle."""
        return bool(self._values[cell] >= OCCUPIED_FROM)

    def is_at_wall(self, cell: Cell) -> bool:
        """Return whether the robot does not fit into a cell because of a wall of the map.

        A wall is what reaches at least `WALL_M` away from the cell without a free cell between:
        obstacles, and unknown space unless that may be passed.
        """
        resolution = self.frame.resolution
        near = (self.costs.radius + 0.5 * resolution) / resolution
        far = WALL_M / resolution
        reach = math.ceil(max(near, far)) + 1
        top, left = max(0, cell[0] - reach), max(0, cell[1] - reach)
        around = self._values[top : cell[0] + reach + 1, left : cell[1] + reach + 1]
        solid = around >= OCCUPIED_FROM
        if not self.costs.allow_unknown:
            solid |= around < 0
        _, labels = cv2.connectedComponents(solid.astype(np.uint8))
        rows, columns = np.ogrid[: around.shape[0], : around.shape[1]]
        apart = np.hypot(rows - (cell[0] - top), columns - (cell[1] - left))
        beside = np.unique(labels[apart <= near])
        return bool(np.isin(labels[apart >= far], beside[beside > 0]).any())

    def cell(self, x: float, y: float) -> Cell | None:
        """Return the cell at the position x, y [m]; None if it is outside the map."""
        column, row = self.frame.cells(x, y)
        rows, columns = self.shape
        return (int(row), int(column)) if 0 <= row < rows and 0 <= column < columns else None

    @property
    def has_scanner_obstacles(self) -> bool:
        """Whether the scanner sees obstacles that are not in the map."""
        return len(self._unmapped_cells) > 0

    def nearest_scanner_obstacle(self, x: float, y: float) -> tuple[float, float]:
        """Return x, y [m] of the nearest obstacle that only the scanner sees."""
        column, row = self.frame.cells(x, y)
        apart = np.hypot(
            self._unmapped_cells[:, 0] + 0.5 - row, self._unmapped_cells[:, 1] + 0.5 - column
        )
        nearest = self._unmapped_cells[int(np.argmin(apart))]
        return self.frame.point(float(nearest[0]), float(nearest[1]))

    def _replace_zones(self, zones: Sequence[Zone]) -> Window | None:
        """Take the cells of zones; return the window of which the costs must be computed."""
        window = self._zone_cells.replace(zones)
        if self._zone_cells.keepout is None:
            self._costs_without_keepout = self.map_costs
        elif self._costs_without_keepout is self.map_costs:
            self._costs_without_keepout = self.map_costs.copy()
        return window

    def _update_around(self, window: Window) -> None:
        """Compute the costs in a window whose content has changed, and around it."""
        rows, columns = self.shape
        far = self._inflation_cells
        top, bottom = max(0, window[0].start - far), min(rows, window[0].stop + far)
        left, right = max(0, window[1].start - far), min(columns, window[1].stop + far)
        self._update_costs(top, bottom, left, right)
        inner = np.s_[top + MARGIN : bottom + MARGIN, left + MARGIN : right + MARGIN]
        self.cell_costs[inner] = self.map_costs[inner]
        self._apply_overlay()

    def _update_costs(self, top: int, bottom: int, left: int, right: int) -> None:
        """Compute the map's costs in a window from the obstacles in and around it."""
        rows, columns = self.shape
        up, low = max(0, top - self._inflation_cells), min(rows, bottom + self._inflation_cells)
        west, east = (
            max(0, left - self._inflation_cells),
            min(columns, right + self._inflation_cells),
        )
        obstacles = self._values[up:low, west:east] >= OCCUPIED_FROM
        resolution = self.frame.resolution
        distance = distance_field(obstacles, resolution)[
            top - up : bottom - up, left - west : right - west
        ]
        window = np.s_[top + MARGIN : bottom + MARGIN, left + MARGIN : right + MARGIN]
        without_keepout = self._costs_without_keepout[window]
        _fill_costs(
            np.ascontiguousarray(distance),
            resolution,
            self._inflation_table,
            self._values[top:bottom, left:right],
            self.costs.allow_unknown,
            without_keepout,
        )
        np.less_equal(distance, self._same_distance, out=self._mapped[top:bottom, left:right])
        zones = self._zone_cells
        if zones.factors is not None:
            multiply_costs(zones.factors[top:bottom, left:right], without_keepout)
        if zones.keepout is None:
            return
        distance = distance_field(zones.keepout[up:low, west:east], resolution)[
            top - up : bottom - up, left - west : right - west
        ]
        near_keepout = np.empty(distance.shape, np.uint8)
        _fill_costs(
            np.ascontiguousarray(distance),
            resolution,
            self._inflation_table,
            self._values[top:bottom, left:right],
            True,  # unknown cells are closed already, where they are to be
            near_keepout,
        )
        np.maximum(near_keepout, without_keepout, out=self.map_costs[window])

    def _apply_overlay(self) -> None:
        """Remove the previous overlay, and apply obstacles of the scanner and avoided positions."""
        top, bottom, left, right = self._overlay_window
        self.cell_costs[top:bottom, left:right] = self.map_costs[top:bottom, left:right]
        held = self._mapped[self._scanner_cells[:, 0], self._scanner_cells[:, 1]]
        self._unmapped_cells = np.ascontiguousarray(self._scanner_cells[~held])
        overlay_cells = np.vstack((self._unmapped_cells, self._avoided_cells))
        if not len(overlay_cells):
            self._overlay_window = (0, 0, 0, 0)
            return
        _inflate(
            self._unmapped_cells, self._inflation_cells, self._inflation_table, self.cell_costs
        )
        around = math.ceil(AVOIDED_M / self.frame.resolution)
        _mark_avoided(self._avoided_cells, around, self.cell_costs)
        far = max(self._inflation_cells, around)
        low, high = overlay_cells.min(axis=0), overlay_cells.max(axis=0)
        rows, columns = self.cell_costs.shape
        self._overlay_window = (
            max(0, int(low[0]) + MARGIN - far),
            min(rows, int(high[0]) + MARGIN + far + 1),
            max(0, int(low[1]) + MARGIN - far),
            min(columns, int(high[1]) + MARGIN + far + 1),
        )


AVOIDED_M = 0.45
"""Radius around an avoided position [m]: driving straight through costs as much as some 13 m of
free space."""
SAME_OBSTACLE_M = 0.15
"""An obstacle of the scanner this near [m] to an obstacle of the map is the same obstacle: a pose
of full health errs by as much."""

# On coarse maps the distance is so many cells instead: an obstacle and its neighbors, also
# diagonal.
_SAME_CELLS = 1.5


def nearest_open(cell_costs: CellCosts, row: float, column: float) -> tuple[Cell, float] | None:
    """Return the nearest open cell to a position in cells, and the distance in cells.

    None if all cells are closed.
    """
    found = _nearest_open(cell_costs, row, column)
    if found[0] < 0:
        return None
    cell = (int(found[0]), int(found[1]))
    return cell, math.hypot(cell[0] + 0.5 - row, cell[1] + 0.5 - column)


def _inflation_table(costs: CostParameters, resolution: float) -> NDArray[np.uint8]:
    """Return the cost by squared distance [cells^2] to the nearest obstacle; the last one for
    beyond.
    """
    blocked = costs.radius + 0.5 * resolution
    closed = blocked + costs.margin
    last = math.ceil((closed + costs.inflation_distance) / resolution)
    distance = np.sqrt(np.arange(last * last + 2, dtype=np.float64)) * resolution
    share = np.clip(1.0 - (distance - closed) / max(costs.inflation_distance, 1e-9), 0.0, 1.0)
    price = np.minimum(np.rint(MIN_COST * (1.0 + costs.inflation_weight * share**2)), MAX_COST)
    price[distance <= closed + 1e-9] = CLOSED
    price[distance <= blocked + 1e-9] = BLOCKED
    price[-1] = MIN_COST
    table: NDArray[np.uint8] = price.astype(np.uint8)
    return table


@compiled("void(float32[:,::1], float64, uint8[::1], int8[:,:], boolean, uint8[:,:])")
def _fill_costs(
    distance: NDArray[np.float32],
    resolution: float,
    table: NDArray[np.uint8],
    values: NDArray[np.int8],
    allow_unknown: bool,
    cell_costs: CellCosts,
) -> None:
    """Set the costs of cells by their distance to obstacles."""
    last = table.size - 1
    cut = math.sqrt(last) * resolution
    scale = 1.0 / (resolution * resolution)
    for row in range(distance.shape[0]):
        for column in range(distance.shape[1]):
            if values[row, column] < 0 and not allow_unknown:
                cell_costs[row, column] = BLOCKED
                continue
            d = float(distance[row, column])
            if d >= cut:
                cell_costs[row, column] = table[last]
            else:
                cell_costs[row, column] = table[int(d * d * scale + 0.5)]


@compiled("void(int64[:,::1], int64, uint8[::1], uint8[:,::1])")
def _inflate(
    cells: NDArray[np.int64], far: int, table: NDArray[np.uint8], cell_costs: CellCosts
) -> None:
    """Raise the costs around each obstacle by the inflation table."""
    last = table.size - 1
    for i in range(len(cells)):
        row, column = cells[i, 0] + MARGIN, cells[i, 1] + MARGIN
        for r in range(max(0, row - far), min(cell_costs.shape[0], row + far + 1)):
            for c in range(max(0, column - far), min(cell_costs.shape[1], column + far + 1)):
                apart = (r - row) * (r - row) + (c - column) * (c - column)
                if apart < last and table[apart] > cell_costs[r, c]:
                    cell_costs[r, c] = table[apart]


@compiled("void(int64[:,::1], int64, uint8[:,::1])")
def _mark_avoided(cells: NDArray[np.int64], far: int, cell_costs: CellCosts) -> None:
    """Raise the costs around each cell to the highest of open cells."""
    for i in range(len(cells)):
        row, column = cells[i, 0] + MARGIN, cells[i, 1] + MARGIN
        for r in range(max(0, row - far), min(cell_costs.shape[0], row + far + 1)):
            for c in range(max(0, column - far), min(cell_costs.shape[1], column + far + 1)):
                within = (r - row) * (r - row) + (c - column) * (c - column) <= far * far
                if within and cell_costs[r, c] < CLOSED:
                    cell_costs[r, c] = MAX_COST


@compiled("UniTuple(int64, 2)(uint8[:,::1], float64, float64)")
def _nearest_open(cell_costs: CellCosts, row: float, column: float) -> tuple[int, int]:
    """Search in growing squares around the position; return (-1, -1) if all is closed."""
    rows, columns = cell_costs.shape[0] - 2 * MARGIN, cell_costs.shape[1] - 2 * MARGIN
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
                if c < 0 or c >= columns or cell_costs[r + MARGIN, c + MARGIN] >= CLOSED:
                    continue
                apart = (r + 0.5 - row) ** 2 + (c + 0.5 - column) ** 2
                if apart < least:
                    found_row, found_column, least = r, c, apart
    return found_row, found_column
