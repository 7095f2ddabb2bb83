"""The occupancy of a grid map, kept up to date by scans from known poses."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.components.map_builder.ray_walk import first_step
from cairn.components.map_builder.undo import Undo
from cairn.components.map_builder.window import Window
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
from cairn.planar.scans import Rays

# Log-odds. What the map holds begins at the limits, so that it takes many contrary scans.
_LEAST, _MOST = -2.0, 3.5
# From here on a cell is occupied, down to there free; in between it stays what it was.
_OCCUPIED, _FREE = 0.6, -0.6
# A ray that ends: confirms an obstacle of the map, of which it says more than many that pass, as
# glass returns few; or speaks for a new one.
_CONFIRMS, _SUGGESTS = 3.0, 0.3
# A scan of which rays pass a cell, and none ends near it: speaks once against an obstacle of the
# map, or forgets a suggestion. The first is small against what confirms: glass lets most rays pass.
_CONTRADICTS, _FORGETS = -0.2, -0.4
# An end this near an obstacle of the map [cells] is that obstacle, seen from a pose that is not
# quite right.
_NEAR = 2
# One this near confirms it [cells].
_BESIDE = 1
# Up to this share of the reach even what is dark returns a ray.
_SURE_SHARE = 0.35
# Until an obstacle is so old [s], what is seen beside it belongs to it, and is drawn as well.
_YOUNG_S = 60.0
# A ray tells nothing of what lies this far [cells] before its end, or where it grazes a surface.
_END_CELLS = 3.0
_GRAZES_M = 1.5


class Occupancy:
    """Free, occupied and unknown cells, changed by rays.

    A new obstacle is one that stood for `settle_s` seconds: who walks past leaves no trace. An
    obstacle of the map is gone when rays pass where it stood. A ray without a return says nothing
    of far obstacles, because what is dark returns none. Changes of the last `undo_s` seconds can be
    taken back.
    """

    def __init__(self, grid: OccupancyCells, settle_s: float, undo_s: float) -> None:
        self.frame: Frame = grid.frame
        self.settle_s = settle_s
        self.cells: NDArray[np.int8] = np.full(grid.values.shape, UNKNOWN, np.int8)
        self.cells[(grid.values >= 0) & (grid.values <= FREE_TO)] = FREE
        self.cells[grid.values >= OCCUPIED_FROM] = OCCUPIED
        self._odds = _certain(self.cells)
        self._since: NDArray[np.float32] = np.full(self.cells.shape, np.nan, np.float32)
        # The number of the last scan that spoke for a cell, negative if it spoke against it.
        self._spoke = np.zeros(self.cells.shape, np.int32)
        self._scans = 0
        self._undo = Undo(self.cells, undo_s)
        self._began: float | None = None

    @property
    def grid(self) -> OccupancyCells:
        """The map as it is now."""
        return Grid(self.cells, self.frame)

    def take_back(self, stamp_s: float) -> Window | None:
        """Undo what was changed since `stamp_s` [s]; gives what has changed by that.

        Evidence that has changed nothing yet is dropped, of whatever time it is.
        """
        window = self._undo.take_back(stamp_s)
        if self._began is not None:
            # What was not decided yet is of doubtful poses, too.
            self._odds = _certain(self.cells)
            lost = self._since >= stamp_s - self._began
            self._since[lost | (self.cells != OCCUPIED)] = np.nan
        return window

    def integrate(self, stamp_s: float, pose: Pose, rays: Rays) -> Window | None:
        """Take the rays of a scan from `pose`; gives what has changed, None if nothing has."""
        if self._began is None:
            self._began = stamp_s
        starts, ends, keep, hit = _in_cells(self.frame, pose, rays)
        if not len(hit):
            return None
        self._scans += 1
        box = np.array([self.cells.shape[0], self.cells.shape[1], -1, -1])
        _confirm(ends, hit, self._spoke, self._scans, self._odds, self.cells)
        _pass(
            starts,
            ends,
            hit,
            keep,
            self._spoke,
            self._scans,
            self._odds,
            self.cells,
            self._since,
            box,
        )
        _end(
            ends,
            hit,
            stamp_s - self._began,
            self.settle_s,
            self._odds,
            self.cells,
            self._since,
            box,
        )
        top, left, bottom, right = (int(edge) for edge in box)
        if bottom < 0:
            return None
        window = Window(top, left, self.cells[top : bottom + 1, left : right + 1].copy())
        self._undo.note(stamp_s, window)
        return window


def _certain(cells: NDArray[np.int8]) -> NDArray[np.float32]:
    """Log-odds of a map that nothing speaks against."""
    odds = np.zeros(cells.shape, np.float32)
    odds[cells == FREE] = _LEAST
    odds[cells == OCCUPIED] = _MOST
    return odds


def _in_cells(
    frame: Frame, pose: Pose, rays: Rays
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Starts and ends (n, 2) [cells], how much before its end a ray tells nothing, who hit."""
    told = ~np.isnan(rays.ranges)
    ranges = rays.ranges[told]
    hit = np.isfinite(ranges)
    reach = np.where(hit, ranges, rays.reach)
    grazing = np.zeros(reach.size)
    if reach.size > 2:
        step = np.abs(np.diff(reach))
        grazing[1:] = step
        grazing[:-1] = np.maximum(grazing[:-1], step)
    keep = np.minimum(grazing, _GRAZES_M) / frame.resolution
    keep = np.where(hit, np.maximum(keep, _END_CELLS), 0.0)
    starts = _placed(frame, pose, rays.starts[told])
    angles = rays.angles[told] + pose[2] - frame.origin[2]
    length = reach / frame.resolution
    ends = starts + np.column_stack((length * np.cos(angles), length * np.sin(angles)))
    return starts, ends, keep, hit


def _placed(frame: Frame, pose: Pose, points: NDArray[np.float64]) -> NDArray[np.float64]:
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
def _passed(
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
    spoke: NDArray[np.int32],
    scan: int,
    odds: NDArray[np.float32],
    cells: NDArray[np.int8],
) -> None:
    rows, columns = spoke.shape
    for i in range(len(ends)):
        if not hit[i]:
            continue
        row, column = math.floor(ends[i, 1]), math.floor(ends[i, 0])
        for r in range(max(0, row - _NEAR), min(rows, row + _NEAR + 1)):
            for c in range(max(0, column - _NEAR), min(columns, column + _NEAR + 1)):
                spoke[r, c] = scan
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
    keep: NDArray[np.float64],
    spoke: NDArray[np.int32],
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
        if length <= keep[i]:
            continue
        until = 1.0 - keep[i] / length
        sure = 1.0 if hit[i] else _SURE_SHARE
        column, row = math.floor(x), math.floor(y)
        step_x, next_x, every_x = first_step(x, dx)
        step_y, next_y, every_y = first_step(y, dy)
        at = 0.0
        while at < until:
            if not (0 <= row < rows and 0 <= column < columns):
                break
            if at > sure and cells[row, column] == OCCUPIED:
                break
            if abs(spoke[row, column]) != scan:
                spoke[row, column] = -scan
                _passed(odds, cells, since, row, column, box)
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
                # NaN: from the beginning.
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
