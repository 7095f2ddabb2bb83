"""Zones of the map as cells of the cost map, and the shortest way out of keepout zones."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
from cairn.planar.grid import Frame
from cairn.planar.polygons import (
    Cells,
    cells_along,
    covered_cells,
    distance_to_edges,
    inside_cells,
    is_inside,
)
from cairn.planar.shortest_path import CLOSED, MARGIN, MAX_COST, Cell, CellCosts
from cairn.planar.zone_cells import Window, part_of, window_of
from cairn.planar.zones import zone_edges
from cairn.schemas.cairn_nav_msgs import Zone

Factors = NDArray[np.float32]


class ZoneCells:
    """The zones of a map as cells (rows, columns), updated where zones have changed.

    `keepout` has all cells that a keepout zone touches. `factors` [1] is by how much the cost of a
    cell is multiplied: by the time that a slow zone costs, and outside lanes, if there are any, by
    `off_lane`. So no cell is cheaper than a free one, as the search requires. Both are None without
    zones of that kind.
    """

    def __init__(self, frame: Frame, shape: tuple[int, int], speed: float, off_lane: float) -> None:
        """Start without zones; `speed` [m/s] is the robot's outside slow zones."""
        self.zones: tuple[Zone, ...] = ()
        self.keepout: Cells | None = None
        self.factors: Factors | None = None
        self._frame, self._shape = frame, shape
        self._speed, self._off_lane = speed, off_lane

    def replace(self, zones: Sequence[Zone]) -> Window | None:
        """Replace the zones; return the window that this changes, None if it changes nothing."""
        before, self.zones = self.zones, tuple(zones)
        changed = set(before).symmetric_difference(self.zones)
        if _has_lanes(before) != _has_lanes(self.zones):
            window: Window | None = (slice(0, self._shape[0]), slice(0, self._shape[1]))
        else:
            window = window_of(changed, self._frame, self._shape)
        if not any(zone.kind == Zone.KEEPOUT for zone in zones):
            self.keepout = None
        elif self.keepout is None:
            self.keepout = np.zeros(self._shape, np.bool_)
        if not any(zone.kind in (Zone.SLOW, Zone.LANE) for zone in zones):
            self.factors = None
        elif self.factors is None:
            self.factors = np.ones(self._shape, np.float32)
        if window is not None:
            self._fill(window)
        return window

    def _fill(self, window: Window) -> None:
        """Compute the cells of a window; each zone is drawn where it overlaps with the window."""
        parts = [(zone, window_of([zone], self._frame, self._shape)) for zone in self.zones]
        drawn = [(zone, _common(part, window)) for zone, part in parts]
        near = [(zone, part) for zone, part in drawn if part is not None]
        if self.keepout is not None:
            self.keepout[window] = False
            for zone, part in near:
                if zone.kind == Zone.KEEPOUT:
                    self.keepout[part] |= covered_cells(
                        zone_edges(zone), *part_of(self._frame, part)
                    )
        if self.factors is None:
            return
        self.factors[window] = self._off_lane if _has_lanes(self.zones) else 1.0
        for zone, part in near:
            if zone.kind == Zone.LANE:
                edges, half = zone_edges(zone), 0.5 * zone.width
                self.factors[part][cells_along(edges, half, *part_of(self._frame, part))] = 1.0
        slowest = np.ones_like(self.factors[window])
        rows, columns = window
        for zone, (part_rows, part_columns) in near:
            if zone.kind == Zone.SLOW:
                inside = inside_cells(
                    zone_edges(zone), *part_of(self._frame, (part_rows, part_columns))
                )
                ratio = np.float32(max(1.0, self._speed / zone.speed))
                there = slowest[
                    part_rows.start - rows.start : part_rows.stop - rows.start,
                    part_columns.start - columns.start : part_columns.stop - columns.start,
                ]
                np.maximum(there, ratio, out=there, where=inside)
        self.factors[window] *= slowest


def _has_lanes(zones: Iterable[Zone]) -> bool:
    return any(zone.kind == Zone.LANE for zone in zones)


def _common(one: Window | None, other: Window) -> Window | None:
    """Return the common part of two windows, None if there is none."""
    if one is None:
        return None
    (top, bottom), (left, right) = (
        (max(a.start, b.start), min(a.stop, b.stop)) for a, b in zip(one, other, strict=True)
    )
    return (slice(top, bottom), slice(left, right)) if top < bottom and left < right else None


def multiply_costs(factors: Factors, cell_costs: CellCosts) -> None:
    """Multiply the costs of open cells; both arrays have the same shape."""
    _multiply(factors, cell_costs)


def nearest_keepout(zones: Sequence[Zone], x: float, y: float) -> tuple[str, float]:
    """Return name and distance [m] of the keepout zone nearest to a position; 0 inside of it."""
    name, least = "", math.inf
    for zone in zones:
        if zone.kind == Zone.KEEPOUT:
            edges = zone_edges(zone)
            apart = 0.0 if is_inside(edges, x, y) else distance_to_edges(edges, x, y)
            if apart < least:
                name, least = zone.name, apart
    return name, least


def way_out(
    passable: CellCosts, cell_costs: CellCosts, start: Cell, reach: int
) -> NDArray[np.int64] | None:
    """Return the cells (n, 2) of the shortest way to an open cell of `cell_costs`, from `start` on.

    It leads over open cells of `passable`, in eight directions; it is sought up to `reach` [cells]
    around the start, and then farther away. None if there is no such way.
    """
    row, column = start[0] + MARGIN, start[1] + MARGIN
    while True:
        top, left = max(0, row - reach), max(0, column - reach)
        window = np.s_[top : row + reach + 1, left : column + reach + 1]
        cells, length = _way_out(
            np.ascontiguousarray(passable[window]),
            np.ascontiguousarray(cell_costs[window]),
            row - top,
            column - left,
        )
        # A shorter way would have to leave the window and to come back.
        if length <= reach or reach >= max(passable.shape):
            break
        reach *= 4
    offset = np.array([top - MARGIN, left - MARGIN])
    return cells + offset if len(cells) else None


@compiled("void(float32[:,:], uint8[:,:])")
def _multiply(factors: Factors, cell_costs: CellCosts) -> None:
    for row in range(cell_costs.shape[0]):
        for column in range(cell_costs.shape[1]):
            cost = cell_costs[row, column]
            if cost < CLOSED:
                cell_costs[row, column] = min(
                    MAX_COST, int(np.float64(cost) * factors[row, column] + 0.5)
                )


@compiled("Tuple((int64[:,::1], float64))(uint8[:,::1], uint8[:,::1], int64, int64)")
def _way_out(
    passable: CellCosts, cell_costs: CellCosts, row: int, column: int
) -> tuple[NDArray[np.int64], float]:
    """Search by Dijkstra's algorithm; return the cells and the length of the way [cells].

    No cell is returned, and infinity, if there is no way. No step leaves the arrays.
    """
    rows, columns = passable.shape
    reached = np.full((rows, columns), np.inf)
    before = np.full((rows, columns), -1, np.int64)
    reached[row, column] = 0.0
    queue = [(0.0, np.int64(row * columns + column))]
    found = np.int64(-1)
    while len(queue) > 0:
        way, cell = heapq.heappop(queue)
        r, c = cell // columns, cell % columns
        if way > reached[r, c]:
            continue
        if cell_costs[r, c] < CLOSED:
            found = cell
            break
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                if not (0 <= r + dr < rows and 0 <= c + dc < columns):
                    continue
                if passable[r + dr, c + dc] >= CLOSED:
                    continue
                if passable[r + dr, c] >= CLOSED or passable[r, c + dc] >= CLOSED:
                    continue  # no corner is cut
                farther = way + math.hypot(dr, dc)
                if farther < reached[r + dr, c + dc]:
                    reached[r + dr, c + dc] = farther
                    before[r + dr, c + dc] = cell
                    heapq.heappush(queue, (farther, (r + dr) * columns + c + dc))
    count = 0
    cell = found
    while cell >= 0:
        count += 1
        cell = before[cell // columns, cell % columns]
    cells = np.empty((count, 2), np.int64)
    cell = found
    for i in range(count - 1, -1, -1):
        cells[i, 0], cells[i, 1] = cell // columns, cell % columns
        cell = before[cell // columns, cell % columns]
    if count == 0:
        return cells, np.inf
    return cells, reached[found // columns, found % columns]
