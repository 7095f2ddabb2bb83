"""Zones of the map as cells of the cost map, and the shortest way out of keepout zones."""

from __future__ import annotations

import heapq
import math
from collections.abc import Sequence
from dataclasses import dataclass

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
from cairn.planar.zones import zone_edges
from cairn.schemas.cairn_nav_msgs import Zone

Factors = NDArray[np.float32]


@dataclass(frozen=True)
class ZoneCells:
    """The zones of a map as cells (rows, columns); None without zones of that kind.

    `keepout` has all cells that a keepout zone touches. `factors` [1] is by how much the cost of a
    cell is multiplied: by the time that a slow zone costs, and outside lanes, if there are any, by
    `off_lane`. So no cell is cheaper than a free one, as the search requires.
    """

    keepout: Cells | None = None
    factors: Factors | None = None


NO_ZONES = ZoneCells()


def zone_cells(
    zones: Sequence[Zone], frame: Frame, shape: tuple[int, int], speed: float, off_lane: float
) -> ZoneCells:
    """Return the cells of zones on a map; `speed` [m/s] is the robot's without slow zones."""
    keepout: Cells | None = None
    factors: Factors | None = None
    lanes = [zone for zone in zones if zone.kind == Zone.LANE]
    if lanes:
        factors = np.full(shape, off_lane, np.float32)
        for lane in lanes:
            factors[cells_along(zone_edges(lane), 0.5 * lane.width, frame, shape)] = 1.0
    slowness: Factors | None = None
    for zone in zones:
        if zone.kind == Zone.KEEPOUT:
            keepout = np.zeros(shape, np.bool_) if keepout is None else keepout
            keepout |= covered_cells(zone_edges(zone), frame, shape)
        elif zone.kind == Zone.SLOW and zone.speed < speed:
            slowness = np.ones(shape, np.float32) if slowness is None else slowness
            inside = inside_cells(zone_edges(zone), frame, shape)
            np.maximum(slowness, np.float32(speed / zone.speed), out=slowness, where=inside)
    if slowness is not None:
        factors = slowness if factors is None else factors * slowness
    return ZoneCells(keepout, factors)


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


def way_out(passable: CellCosts, cell_costs: CellCosts, start: Cell) -> NDArray[np.int64] | None:
    """Return the cells (n, 2) of the shortest way to an open cell of `cell_costs`, from `start` on.

    It leads over open cells of `passable`, in eight directions. None if there is no such way.
    """
    cells = _way_out(passable, cell_costs, start[0] + MARGIN, start[1] + MARGIN)
    return cells if len(cells) else None


@compiled("void(float32[:,:], uint8[:,:])")
def _multiply(factors: Factors, cell_costs: CellCosts) -> None:
    for row in range(cell_costs.shape[0]):
        for column in range(cell_costs.shape[1]):
            cost = cell_costs[row, column]
            if cost < CLOSED:
                cell_costs[row, column] = min(
                    MAX_COST, int(np.float64(cost) * factors[row, column] + 0.5)
                )


@compiled("int64[:,::1](uint8[:,::1], uint8[:,::1], int64, int64)")
def _way_out(
    passable: CellCosts, cell_costs: CellCosts, row: int, column: int
) -> NDArray[np.int64]:
    """Search by Dijkstra's algorithm; no cell is returned if there is no way."""
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
        cells[i, 0], cells[i, 1] = cell // columns - MARGIN, cell % columns - MARGIN
        cell = before[cell // columns, cell % columns]
    return cells
