"""Frontiers: where the known free space that the robot can reach borders on unknown space."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.planar.grid import FREE_TO, OCCUPIED_FROM, Frame, OccupancyCells, distance_field
from cairn.planar.poses import Pose
from cairn.planar.shortest_path import CLOSED, MARGIN, MIN_COST, Cell, PathSearch, open_costs

# A robot that seems to be in an obstacle starts from the nearest free position within this [m]; the
# path planner leads it out of an obstacle by as much.
_START_M = 0.4
# The robot faces the unknown cells that are so near to its goal [m].
_FACED_M = 0.5
# The goal is chosen at the frontier's middle rather than at its near end if the way is not longer
# by more than this share of the distance between them [1].
_TO_MIDDLE = 0.5


@dataclass(frozen=True)
class Frontier:
    """A connected border between free and unknown cells, parts of which the robot can reach.

    Attributes:
        pose: at the frontier, from where the robot looks into the unknown [m, rad].
        path_m: length of the shortest path to it [m].
        width_m: extent of the frontier [m].
        points: (n, 2) positions of its cells that the robot can reach [m].

    """

    pose: Pose
    path_m: float
    width_m: float
    points: NDArray[np.float64]

    def is_near(self, x: float, y: float, within_m: float) -> bool:
        """Return whether a reachable cell of it is within `within_m` [m] of a position."""
        return bool((np.hypot(*(self.points - (x, y)).T) <= within_m).any())


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
        self, grid: OccupancyCells, here: Pose, needs: Clearance
    ) -> tuple[Frontier, ...] | None:
        """Return the frontiers that a robot at `here` can reach; None if it cannot move at all.

        The robot reaches free cells far enough from mapped obstacles. An unknown area that is
        smaller than the robot, such as one between distant beams, has no frontier.
        """
        values, resolution = grid.values, grid.frame.resolution
        free = (values >= 0) & (values <= FREE_TO)
        _free_body(free, values, grid.frame, here, needs.body_m)
        unknown = _large(~free & (values < 0), needs.width_m / resolution)
        borders = free & _beside(unknown)
        roomy = free & (distance_field(values >= OCCUPIED_FROM, resolution) > needs.fits_m)
        start = _nearest(roomy, grid.frame, here)
        if start is None:
            return None
        lengths = self._lengths(roomy, start) * resolution
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
                found.append(_frontier(cells, lengths, unknown, grid.frame, width_m))
        return tuple(found)

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


def nearest_of(frontiers: Sequence[Frontier], x: float, y: float, within_m: float) -> bool:
    """Return whether any frontier has a reachable cell within `within_m` [m] of a position."""
    return any(frontier.is_near(x, y, within_m) for frontier in frontiers)


def _frontier(
    cells: NDArray[np.intp],
    lengths: NDArray[np.float32],
    unknown: NDArray[np.bool_],
    frame: Frame,
    width_m: float,
) -> Frontier:
    rows, columns = np.unravel_index(cells, lengths.shape)
    apart = np.hypot(rows - rows.mean(), columns - columns.mean()) * frame.resolution
    path_m = lengths[rows, columns]
    best = int(np.argmin(path_m + _TO_MIDDLE * apart))
    row, column = int(rows[best]), int(columns[best])
    x, y = frame.point(row, column)
    heading = frame.origin[2] + _direction_to(unknown, row, column, _FACED_M / frame.resolution)
    points = np.column_stack(_points(frame, rows, columns))
    return Frontier((x, y, math.remainder(heading, math.tau)), float(path_m[best]), width_m, points)


def _direction_to(unknown: NDArray[np.bool_], row: int, column: int, far: float) -> float:
    """Return the direction [rad] from a cell to the middle of the unknown cells around it."""
    reach = math.ceil(far)
    top, left = max(0, row - reach), max(0, column - reach)
    rows, columns = np.nonzero(unknown[top : row + reach + 1, left : column + reach + 1])
    rows, columns = rows + (top - row), columns + (left - column)
    near = np.hypot(rows, columns) <= far
    return math.atan2(float(rows[near].sum()), float(columns[near].sum()))


def _free_body(
    free: NDArray[np.bool_], values: NDArray[np.int8], frame: Frame, here: Pose, body_m: float
) -> None:
    """Count the unknown ground below the robot as free: its scanner does not see it."""
    column, row = frame.cells(here[0], here[1])
    reach = math.ceil(body_m / frame.resolution)
    top, left = max(0, int(row) - reach), max(0, int(column) - reach)
    window = np.s_[top : int(row) + reach + 1, left : int(column) + reach + 1]
    rows, columns = np.ogrid[top : top + free[window].shape[0], left : left + free[window].shape[1]]
    below = np.hypot(rows + 0.5 - row, columns + 0.5 - column) * frame.resolution <= body_m
    free[window] |= below & (values[window] < 0)


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


def _points(
    frame: Frame, rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return x and y [m] of the centers of cells."""
    ox, oy, theta = frame.origin
    along, across = (columns + 0.5) * frame.resolution, (rows + 0.5) * frame.resolution
    cosine, sine = math.cos(theta), math.sin(theta)
    return ox + cosine * along - sine * across, oy + sine * along + cosine * across
