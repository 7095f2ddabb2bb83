"""Updates the occupancy of a grid map by scans from known poses."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn import SECOND
from cairn.components.map_builder.undo import GridJournal, GridWindow
from cairn.planar.compiled import compiled
from cairn.planar.grid import (
    FREE,
    FREE_TO,
    OCCUPIED,
    OCCUPIED_FROM,
    UNKNOWN,
    Frame,
    Grid,
    OccupancyCells,
)
from cairn.planar.poses import Pose
from cairn.planar.scan_grid import first_step
from cairn.planar.scans import SURE_SHARE, Rays

# With the increments below, mapped glass that returns one beam in ten stays while it is observed
# from up to 3 m (docs/concepts/architecture.md, limits). Where no other reason is given,
# `lab/constants.yaml` has the effect of half and double.

# Limits of the log-odds. Cells of the given map start at them, so that many contrary scans are
# needed to change them: 21 to free an obstacle.
_LEAST, _MOST = -2.0, 3.5
# Log-odds from which a cell is occupied, or free; in between it keeps its state. Two rays
# that end in a cell reach it.
_OCCUPIED, _FREE = 0.6, -0.6
# A ray that ends confirms an obstacle of the map, with more weight than many rays that pass (glass
# returns few rays), or suggests a new obstacle.
_CONFIRMS, _SUGGESTS = 3.0, 0.3
# A scan whose rays pass a cell without an end near it contradicts an obstacle of the map once, or
# forgets a suggestion. A contradiction is small against a confirmation: glass lets most rays pass.
_CONTRADICTS, _FORGETS = -0.2, -0.4
# An end this near an obstacle of the map [cells] is that obstacle, seen from a slightly wrong pose.
_NEAR = 2
# An end this near confirms it [cells].
_BESIDE = 1
# While an obstacle is younger than this [s], ends beside it belong to it and are added as well: the
# robot sees its other sides in this time. Chosen by hand.
_YOUNG_S = 60.0
# Scans are numbered by their time in steps of this [ns], at most one in each (100 per second).
_NUMBER_NS = SECOND // 100
_MOST_NUMBER = 2**31 - 2**24
# A ray is not evidence about cells this near its end [cells], or where it grazes a surface [m]:
# there a small error of the pose moves it through the obstacle. Chosen by hand.
_END_CELLS = 3.0
_GRAZES_M = 1.5


class Occupancy:
    """Free, occupied and unknown cells, updated by rays.

    An obstacle is added once it has stood for `settle_s` seconds, so people that walk past leave no
    trace. An obstacle is removed when rays pass where it stood. A ray without a return is not
    evidence about far obstacles, because dark objects return none. Changes of the last `undo_s`
    seconds can be undone.
    """

    def __init__(self, grid: OccupancyCells, settle_s: float, undo_s: float) -> None:
        self.frame: Frame = grid.frame
        self.settle_s = settle_s
        self.cells = known_cells(grid)
        self._odds = _initial_odds(self.cells)
        self._since: NDArray[np.float32] = np.full(self.cells.shape, np.nan, np.float32)
        # Number of the last scan with an end near a cell, negative if its rays only passed it.
        self._last_scan = np.zeros(self.cells.shape, np.int32)
        self._number = 0
        self._numbered_from_s = 0.0
        self._journal = GridJournal(self.cells, undo_s)
        self._start_s: float | None = None

    @property
    def grid(self) -> OccupancyCells:
        """Return the present map."""
        return Grid(self.cells, self.frame)

    def adopt(self, cells: NDArray[np.int64], values: NDArray[np.int8]) -> None:
        """Take the values of some cells (flat indices) from other robots.

        They are as cells of the given map: it needs many contrary scans to change them. The robot's
        own changes of them are not undone any more.
        """
        self.cells.flat[cells] = values
        self._odds.flat[cells] = _initial_odds(values)
        self._since.flat[cells] = np.nan
        self._journal.forget(cells)

    def confirmed_ns(self, window: tuple[slice, slice]) -> NDArray[np.int64]:
        """Return when scans have last confirmed each cell of a window [ns]; 0: never."""
        cells, last = self.cells[window], self._last_scan[window].astype(np.int64)
        confirmed = ((cells == FREE) & (last < 0)) | ((cells == OCCUPIED) & (last > 0))
        begin_ns = round(self._numbered_from_s * SECOND)
        return np.where(confirmed, begin_ns + np.abs(last) * _NUMBER_NS, 0)

    def undo(self, stamp_s: float) -> GridWindow | None:
        """Undo the changes since `stamp_s` [s]; return the window that this changes.

        Evidence that has changed nothing yet is dropped, whatever its time.
        """
        window = self._journal.undo(stamp_s)
        if self._start_s is not None:
            # Undecided evidence is of unreliable poses, too.
            self._odds = _initial_odds(self.cells)
            lost = self._since >= stamp_s - self._start_s
            self._since[lost | (self.cells != OCCUPIED)] = np.nan
            first = (stamp_s - self._numbered_from_s) * SECOND / _NUMBER_NS
            self._last_scan[np.abs(self._last_scan) >= first] = 0
        return window

    def integrate(self, stamp_s: float, pose: Pose, rays: Rays) -> GridWindow | None:
        """Integrate the rays of a scan from `pose`; return the window that this changes."""
        if self._start_s is None:
            self._start_s = stamp_s
        starts, ends, ignored, hit = _rays_in_cells(self.frame, pose, rays)
        if not len(hit):
            return None
        scan = self._next_number(stamp_s)
        box = np.array([self.cells.shape[0], self.cells.shape[1], -1, -1])
        _confirm(ends, hit, self._last_scan, scan, self._odds, self.cells)
        _pass(
            starts,
            ends,
            hit,
            ignored,
            self._last_scan,
            scan,
            self._odds,
            self.cells,
            self._since,
            box,
        )
        _end(
            ends,
            hit,
            stamp_s - self._start_s,
            self.settle_s,
            self._odds,
            self.cells,
            self._since,
            box,
        )
        top, left, bottom, right = (int(edge) for edge in box)
        if bottom < 0:
            return None
        window = GridWindow(top, left, self.cells[top : bottom + 1, left : right + 1].copy())
        self._journal.record(stamp_s, window)
        return window

    def _next_number(self, stamp_s: float) -> int:
        """Return a number for a scan that is greater than the last one and gives its time."""
        number = round((stamp_s - self._numbered_from_s) * SECOND / _NUMBER_NS)
        if not self._number or number > _MOST_NUMBER:  # after 248 days
            self._last_scan[:] = 0
            self._number, self._numbered_from_s, number = 0, stamp_s, 0
        self._number = max(self._number + 1, number)
        return self._number


def known_cells(grid: OccupancyCells) -> NDArray[np.int8]:
    """Return the cells of a map (rows, columns) as FREE, OCCUPIED or UNKNOWN."""
    cells: NDArray[np.int8] = np.full(grid.values.shape, UNKNOWN, np.int8)
    cells[(grid.values >= 0) & (grid.values <= FREE_TO)] = FREE
    cells[grid.values >= OCCUPIED_FROM] = OCCUPIED
    return cells


def _initial_odds(cells: NDArray[np.int8]) -> NDArray[np.float32]:
    """Return the log-odds of a map without contrary evidence."""
    odds = np.zeros(cells.shape, np.float32)
    odds[cells == FREE] = _LEAST
    odds[cells == OCCUPIED] = _MOST
    return odds


def _rays_in_cells(
    frame: Frame, pose: Pose, rays: Rays
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Return starts and ends (n, 2) [cells], ignored lengths before ends, and which rays hit."""
    valid = ~np.isnan(rays.ranges)
    ranges = rays.ranges[valid]
    hit = np.isfinite(ranges)
    reach = np.where(hit, ranges, rays.reach)
    grazing = np.zeros(reach.size)
    if reach.size > 2:
        step = np.abs(np.diff(reach))
        grazing[1:] = step
        grazing[:-1] = np.maximum(grazing[:-1], step)
    ignored = np.minimum(grazing, _GRAZES_M) / frame.resolution
    ignored = np.where(hit, np.maximum(ignored, _END_CELLS), 0.0)
    starts = _points_in_cells(frame, pose, rays.starts[valid])
    angles = rays.angles[valid] + pose[2] - frame.origin[2]
    length = reach / frame.resolution
    ends = starts + np.column_stack((length * np.cos(angles), length * np.sin(angles)))
    return starts, ends, ignored, hit


def _points_in_cells(frame: Frame, pose: Pose, points: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y = frame.cells(pose[0], pose[1])
    theta = pose[2] - frame.origin[2]
    cosine, sine = math.cos(theta) / frame.resolution, math.sin(theta) / frame.resolution
    placed = np.empty(points.shape)
    placed[:, 0] = x + cosine * points[:, 0] - sine * points[:, 1]
    placed[:, 1] = y + sine * points[:, 0] + cosine * points[:, 1]
    return placed


@compiled()
def _grow(box: NDArray[np.int64], row: int, column: int) -> None:
    box[0], box[1] = min(box[0], row), min(box[1], column)
    box[2], box[3] = max(box[2], row), max(box[3], column)


@compiled()
def _pass_cell(
    odds: NDArray[np.float32],
    cells: NDArray[np.int8],
    since: NDArray[np.float32],
    row: int,
    column: int,
    box: NDArray[np.int64],
) -> None:
    state = cells[row, column]
    change = _CONTRADICTS if state == OCCUPIED else _FORGETS
    value = max(_LEAST, odds[row, column] + change)
    odds[row, column] = value
    if value <= _FREE:
        since[row, column] = np.nan
        if state != FREE:
            cells[row, column] = FREE
            _grow(box, row, column)


@compiled(
    "void(float64[:, ::1], boolean[::1], int32[:, ::1], int64, float32[:, ::1], int8[:, ::1])"
)
def _confirm(
    ends: NDArray[np.float64],
    hit: NDArray[np.bool_],
    last_scan: NDArray[np.int32],
    scan: int,
    odds: NDArray[np.float32],
    cells: NDArray[np.int8],
) -> None:
    rows, columns = last_scan.shape
    for i in range(len(ends)):
        if not hit[i]:
            continue
        row, column = math.floor(ends[i, 1]), math.floor(ends[i, 0])
        for r in range(max(0, row - _NEAR), min(rows, row + _NEAR + 1)):
            for c in range(max(0, column - _NEAR), min(columns, column + _NEAR + 1)):
                last_scan[r, c] = scan
                beside = abs(r - row) <= _BESIDE and abs(c - column) <= _BESIDE
                if beside and cells[r, c] == OCCUPIED:
                    odds[r, c] = min(_MOST, odds[r, c] + _CONFIRMS)


@compiled(
    "void(float64[:, ::1], float64[:, ::1], boolean[::1], float64[::1], int32[:, ::1], int64,"
    " float32[:, ::1], int8[:, ::1], float32[:, ::1], int64[::1])"
)
def _pass(
    starts: NDArray[np.float64],
    ends: NDArray[np.float64],
    hit: NDArray[np.bool_],
    ignored: NDArray[np.float64],
    last_scan: NDArray[np.int32],
    scan: int,
    odds: NDArray[np.float32],
    cells: NDArray[np.int8],
    since: NDArray[np.float32],
    box: NDArray[np.int64],
) -> None:
    rows, columns = cells.shape
    for i in range(len(starts)):
        x, y = starts[i, 0], starts[i, 1]
        dx, dy = ends[i, 0] - x, ends[i, 1] - y
        length = math.hypot(dx, dy)
        if length <= ignored[i]:
            continue
        until = 1.0 - ignored[i] / length
        certain = 1.0 if hit[i] else SURE_SHARE
        column, row = math.floor(x), math.floor(y)
        step_x, next_x, every_x = first_step(x, dx)
        step_y, next_y, every_y = first_step(y, dy)
        at = 0.0
        while at < until:
            if not (0 <= row < rows and 0 <= column < columns):
                break
            if at > certain and cells[row, column] == OCCUPIED:
                break
            if abs(last_scan[row, column]) != scan:
                last_scan[row, column] = -scan
                _pass_cell(odds, cells, since, row, column, box)
            if next_x < next_y:
                at = next_x
                next_x += every_x
                column += step_x
            else:
                at = next_y
                next_y += every_y
                row += step_y


@compiled(
    "void(float64[:, ::1], boolean[::1], float64, float64, float32[:, ::1], int8[:, ::1],"
    " float32[:, ::1], int64[::1])"
)
def _end(
    ends: NDArray[np.float64],
    hit: NDArray[np.bool_],
    now: float,
    settle: float,
    odds: NDArray[np.float32],
    cells: NDArray[np.int8],
    since: NDArray[np.float32],
    box: NDArray[np.int64],
) -> None:
    rows, columns = cells.shape
    for i in range(len(ends)):
        if not hit[i]:
            continue
        row, column = math.floor(ends[i, 1]), math.floor(ends[i, 0])
        if not (0 <= row < rows and 0 <= column < columns):
            continue
        if cells[row, column] == OCCUPIED:
            continue
        known = False
        for r in range(max(0, row - _NEAR), min(rows, row + _NEAR + 1)):
            for c in range(max(0, column - _NEAR), min(columns, column + _NEAR + 1)):
                # NaN: since the start.
                young = now - since[r, c] < _YOUNG_S
                if cells[r, c] == OCCUPIED and not young:
                    known = True
        if known:
            continue
        if math.isnan(since[row, column]):
            since[row, column] = now
        value = min(_MOST, odds[row, column] + _SUGGESTS)
        stood = now - since[row, column] >= settle
        if not stood:
            value = min(value, _OCCUPIED)
        odds[row, column] = value
        if stood and value >= _OCCUPIED:
            cells[row, column] = OCCUPIED
            _grow(box, row, column)
