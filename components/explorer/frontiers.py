"""Frontiers: where the known free space that the robot can reach borders on unknown space."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.planar.grid import FREE_TO, OCCUPIED_FROM, Frame, OccupancyCells, distance_field
from cairn.planar.polygons import Cells
from cairn.planar.poses import Pose
from cairn.planar.shortest_path import CLOSED, MARGIN, MIN_COST, Cell, PathSearch, open_costs

# A robot that seems to be in an obstacle starts from the nearest free position within this [m]; the
# path planner leads it out of an obstacle by as much.
_START_M = 0.4
# The robot faces the unknown cells that are so near to the frontier [m].
_FACED_M = 0.5
# It looks at a frontier from up to so far away [m]. Of the positions there, so many are checked for
# a free view [1].
_VIEW_M, _MOST_VIEWS = 1.0, 40
# The goal is chosen at the frontier's middle rather than at its near end if the way is not longer
# by more than this share of the distance between them [1].
_TO_MIDDLE = 0.5


@dataclass(frozen=True)
class Frontier:
    """A connected border between free and unknown cells, parts of which the robot can reach.

    Attributes:
        pose: on the frontier, facing the unknown [m, rad].
        view: before the frontier, facing it: a pose that the robot can reach whatever the unknown
            hides, as no unknown cell is nearer than an obstacle may be; else the same as `pose`.
        path_m: length of the shortest path to `pose` [m].
        width_m: extent of the frontier [m].
        points: (n, 2) positions of its cells that the robot can reach [m].

    """

    pose: Pose
    view: Pose
    path_m: float
    width_m: float
    points: NDArray[np.float64]

    def is_near(self, x: float, y: float, within_m: float) -> bool:
        """Return whether a reachable cell of it is within `within_m` [m] of a position."""
        return bool((np.hypot(*(self.points - (x, y)).T) <= within_m).any())


@dataclass(frozen=True)
class Reach:
    """What the robot can reach in a map.

    Attributes:
        frontiers: those that it can reach.
        lengths: (rows, columns) of the shortest path to each cell [m]; infinite if there is none.
        frame: of these cells.

    """

    frontiers: tuple[Frontier, ...]
    lengths: NDArray[np.float32]
    frame: Frame

    def has(self, x: float, y: float) -> bool:
        """Return whether the robot can reach a position [m]."""
        row, column = self.frame.cell(x, y)
        rows, columns = self.lengths.shape
        inside = 0 <= row < rows and 0 <= column < columns
        return inside and bool(np.isfinite(self.lengths[row, column]))

    def has_frontier_near(self, x: float, y: float, within_m: float) -> bool:
        """Return whether a reachable cell of a frontier is that near [m] to a position."""
        return any(frontier.is_near(x, y, within_m) for frontier in self.frontiers)


@dataclass(frozen=True)
class Clearance:
    """What the robot needs.

    Attributes:
        fits_m: its center is farther than this from the centers of cells with obstacles [m].
        body_m: it stands on the ground up to here from its center, which is free [m].
        width_m: least extent of a frontier, and of an unknown area behind it [m].

    """

    fits_m: float
    body_m: float
    width_m: float


class FrontierSearch:
    """Finds frontiers in maps; keeps the memory for maps of one size."""

    def __init__(self) -> None:
        self._search: PathSearch | None = None

    def find(
        self, grid: OccupancyCells, here: Pose, needs: Clearance, keepout: Cells | None = None
    ) -> Reach | None:
        """Return what a robot at `here` can reach; None if it cannot move at all.

        The robot reaches free cells far enough from mapped obstacles and from cells of keepout
        zones. If it is in such a zone, it starts where it has left the zone by the shortest way. An
        unknown area that is smaller than the robot, such as one between distant beams, has no
        frontier.
        """
        values, resolution = grid.values, grid.frame.resolution
        mapped = (values >= 0) & (values <= FREE_TO)
        below = _below(grid, here, needs.body_m)
        unknown = _large((values < 0) & ~below, needs.width_m / resolution)
        borders = mapped & _beside(unknown)
        free = mapped | (below & (values < 0))
        obstacles = values >= OCCUPIED_FROM
        roomy = free & (distance_field(obstacles, resolution) > needs.fits_m)
        start = _nearest(roomy, grid.frame, here)
        if keepout is not None and start is not None:
            obstacles |= keepout
            allowed = roomy & (distance_field(keepout, resolution) > needs.fits_m)
            if not allowed[start]:
                start = self._way_out(roomy, allowed, start)
            roomy = allowed
        if start is None:
            return None
        lengths = self._lengths(roomy, start) * resolution
        safe = roomy & (distance_field(obstacles | unknown, resolution) > needs.fits_m)
        area = _MapArea(grid.frame, mapped, unknown, safe, lengths)
        _, labels, boxes, _ = cv2.connectedComponentsWithStats(
            borders.view(np.uint8), connectivity=8
        )
        reached = np.flatnonzero((borders & np.isfinite(lengths)).ravel())
        members = labels.ravel()[reached]
        order = np.argsort(members, kind="stable")
        numbers, firsts = np.unique(members[order], return_index=True)
        found: list[Frontier] = []
        for number, cells in zip(
            numbers.tolist(), np.split(reached[order], firsts[1:]), strict=False
        ):
            sides = boxes[number, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]]
            width_m = float(sides.max()) * resolution
            if width_m >= needs.width_m:
                found.append(area.frontier(cells, width_m))
        return Reach(tuple(found), lengths, grid.frame)

    def _way_out(
        self, roomy: NDArray[np.bool_], allowed: NDArray[np.bool_], start: Cell
    ) -> Cell | None:
        """Return the allowed cell that is the nearest on the ways from the start."""
        lengths = np.where(allowed, self._lengths(roomy, start), np.inf)
        row, column = divmod(int(np.argmin(lengths)), lengths.shape[1])
        return (row, column) if np.isfinite(lengths[row, column]) else None

    def _lengths(self, roomy: NDArray[np.bool_], start: Cell) -> NDArray[np.float32]:
        rows, columns = roomy.shape
        costs = open_costs(rows, columns)
        costs[MARGIN:-MARGIN, MARGIN:-MARGIN] = np.where(roomy, MIN_COST, CLOSED)
        if self._search is None or self._search.shape != costs.shape:
            self._search = PathSearch(costs.shape)
        return self._search.lengths(costs, start)


def free_area(grid: OccupancyCells) -> float:
    """Return the area of the map's free cells [m^2]."""
    free = (grid.values >= 0) & (grid.values <= FREE_TO)
    return float(np.count_nonzero(free)) * grid.frame.resolution**2


@dataclass(frozen=True)
class _MapArea:
    """Cells (rows, columns) of a map: free in it; unknown; safe whatever is unknown; paths [m]."""

    frame: Frame
    free: NDArray[np.bool_]
    unknown: NDArray[np.bool_]
    safe: NDArray[np.bool_]
    lengths: NDArray[np.float32]

    def frontier(self, cells: NDArray[np.intp], width_m: float) -> Frontier:
        """Return the frontier with these reachable cells (flat indices)."""
        frame = self.frame
        rows, columns = np.unravel_index(cells, self.lengths.shape)
        apart = np.hypot(rows - rows.mean(), columns - columns.mean()) * frame.resolution
        path_m = self.lengths[rows, columns]
        best = int(np.argmin(path_m + _TO_MIDDLE * apart))
        row, column = int(rows[best]), int(columns[best])
        turn = _direction_to(self.unknown, row, column, _FACED_M / frame.resolution)
        pose = self._pose(row, column, turn)
        view = self._view(row, column) or pose
        grid: Any = rows, columns  # arrays, with which `point` computes as with numbers
        points = np.column_stack(frame.point(*grid))
        return Frontier(pose, view, float(path_m[best]), width_m, points)

    def _view(self, row: int, column: int) -> Pose | None:
        """Return the nearest safe pose from where a cell is in view."""
        reach = math.ceil(_VIEW_M / self.frame.resolution)
        top, left = max(0, row - reach), max(0, column - reach)
        window = np.s_[top : row + reach + 1, left : column + reach + 1]
        rows, columns = np.nonzero(self.safe[window] & np.isfinite(self.lengths[window]))
        rows, columns = rows + top, columns + left
        apart = np.hypot(rows - row, columns - column)
        for index in np.argsort(apart, kind="stable")[:_MOST_VIEWS].tolist():
            y, x = int(rows[index]), int(columns[index])
            steps = np.linspace(0.0, 1.0, 2 * max(1, math.ceil(apart[index])))
            line = (
                np.rint(y + steps * (row - y)).astype(np.int64),
                np.rint(x + steps * (column - x)).astype(np.int64),
            )
            if self.free[line].all():
                return self._pose(y, x, math.atan2(row - y, column - x))
        return None

    def _pose(self, row: int, column: int, turn: float) -> Pose:
        x, y = self.frame.point(row, column)
        return x, y, math.remainder(self.frame.origin[2] + turn, math.tau)


def _direction_to(unknown: NDArray[np.bool_], row: int, column: int, far: float) -> float:
    """Return the direction [rad] from a cell to the middle of the unknown cells around it."""
    reach = math.ceil(far)
    top, left = max(0, row - reach), max(0, column - reach)
    rows, columns = np.nonzero(unknown[top : row + reach + 1, left : column + reach + 1])
    rows, columns = rows + (top - row), columns + (left - column)
    near = np.hypot(rows, columns) <= far
    return math.atan2(float(rows[near].sum()), float(columns[near].sum()))


def _below(grid: OccupancyCells, here: Pose, body_m: float) -> NDArray[np.bool_]:
    """Return the cells below the robot, which its scanner does not see."""
    resolution = grid.frame.resolution
    column, row = grid.frame.cells(here[0], here[1])
    reach = math.ceil(body_m / resolution)
    below = np.zeros(grid.values.shape, np.bool_)
    top, left = max(0, math.floor(row) - reach), max(0, math.floor(column) - reach)
    window = below[top : math.floor(row) + reach + 1, left : math.floor(column) + reach + 1]
    rows, columns = np.ogrid[top : top + window.shape[0], left : left + window.shape[1]]
    window[:] = np.hypot(rows + 0.5 - row, columns + 0.5 - column) * resolution <= body_m
    return below


def _large(unknown: NDArray[np.bool_], least: float) -> NDArray[np.bool_]:
    """Return the unknown cells without areas that are smaller than `least` cells both ways."""
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(unknown.view(np.uint8), connectivity=8)
    sides = boxes[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1)
    kept = sides >= least
    kept[0] = False  # the background
    return np.asarray(kept[labels], np.bool_)


def _beside(cells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which cells have one of `cells` as a neighbor to a side."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    return cv2.dilate(cells.view(np.uint8), cross).astype(np.bool_)


def _nearest(roomy: NDArray[np.bool_], frame: Frame, here: Pose) -> Cell | None:
    """Return the nearest cell into which the robot fits, if one is near."""
    column, row = frame.cells(here[0], here[1])
    rows, columns = np.nonzero(roomy)
    if not rows.size:
        return None
    apart = np.hypot(rows + 0.5 - row, columns + 0.5 - column)
    nearest = int(np.argmin(apart))
    if apart[nearest] * frame.resolution > _START_M:
        return None
    return int(rows[nearest]), int(columns[nearest])
