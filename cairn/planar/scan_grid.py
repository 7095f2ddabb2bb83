"""Grid maps from scans whose poses are known, or known better later."""

from __future__ import annotations

import math
from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
from cairn.planar.grid import FREE, OCCUPIED, UNKNOWN, Frame, Grid, OccupancyCells
from cairn.planar.poses import Pose
from cairn.planar.renewals import Renewals
from cairn.planar.scans import SURE_SHARE, Rays, rays_of
from cairn.schemas.nav_msgs import MOST_CELLS
from cairn.schemas.sensor_msgs import LaserScan

Array = NDArray[np.float64]

# Where no other reason is given, these constants were chosen by hand; `lab/constants.yaml`
# has the effect of half and double. docs/benchmarks.md has the errors of the logs fr079 and fr101
# on maps that are made so.

OCCUPIED_SHARE = 0.3
"""A cell is occupied if at least this share of the rays that reached it ended there."""
# Margin of unknown cells around the map [m].
_BORDER_M = 1.0
# A surface is estimated from rays this many indices apart, if their ends are this near [m].
_NEIGHBOR, _SURFACE_M = 3, 1.0
# Least sine of the angle between a ray and a surface: smaller ones count as this.
_GRAZING = 0.1
NOT_SEEN, SEEN, SEEN_FREE = 0, 1, 2
"""What rays say of a cell: none came there, some did, or it is free for certain."""

# The counts grow by blocks of so many cells, so that they are rarely copied. So many rows of the
# map are computed at a time: for a map of a hectare, all at once take 60 MB.
_BLOCK = 128


class ScanGrid:
    """Counts how many rays ended in each cell, and how many passed it.

    A cell is occupied by the share of rays that ended there, among those that reached it (the
    counting model: Haehnel, Burgard, Thrun 2003). Rays longer than `reach` [m] only pass, and those
    without a return only where also dark surfaces would return them. A ray is not evidence about
    cells before its end that are within a cell's size of the surface that it hit: where it grazes a
    wall, errors of a few centimeters lead it through many cells of that wall. A scan can be removed
    again, to be added with a better pose. Where the map was renewed, only scans from a version on
    count.
    """

    def __init__(self, resolution: float, reach: float) -> None:
        self._resolution, self._reach = resolution, reach
        self._row, self._column = 0, 0  # of the first cell, counted from the map's origin
        self._ended = np.zeros((0, 0), np.int32)
        self._passed = np.zeros((0, 0), np.int32)
        self._renewals = Renewals()
        self._since = np.zeros((0, 0), np.int32)  # of each cell; empty without renewals
        self._changed: tuple[int, int, int, int] | None = None  # rows and columns, as `_row`

    def reserve(self, low: Array, high: Array) -> None:
        """Make room from x, y `low` (2,) to `high` (2,) [m]: scans there need not copy the counts.

        Raises `ValueError` if the map had more than `MOST_CELLS`.
        """
        self._cover(np.floor(low / self._resolution), np.floor(high / self._resolution))

    def add(self, base: Pose, rays: Rays, version: int = 0) -> None:
        """Add the rays of a scan from a pose of the base, and of a version of the map.

        Raises `ValueError` if the map had more than `MOST_CELLS`.
        """
        self._count(base, rays, 1, version)

    def remove(self, base: Pose, rays: Rays, version: int = 0) -> None:
        """Remove what `add` has added with the same arguments."""
        self._count(base, rays, -1, version)

    def renew(self, renewals: Renewals) -> None:
        """Count in renewed places only scans from their version on; forget what was counted there.

        Scans of a new version are added after this. Raises `ValueError` if a place had a newer
        version before.
        """
        since = renewals.cells(self._row, self._column, self.shape, self._resolution)
        before = self._since if self._since.size else np.zeros_like(since)
        if (since < before).any():
            raise ValueError("a renewed place cannot return to an older version")
        rows, columns = np.nonzero(since > before)
        self._ended[rows, columns] = 0
        self._passed[rows, columns] = 0
        self._renewals, self._since = renewals, since
        if rows.size:
            top, left = int(rows.min()) + self._row, int(columns.min()) + self._column
            bottom, right = int(rows.max()) + self._row + 1, int(columns.max()) + self._column + 1
            self._note_change(top, left, bottom, right)

    def change_without(self, base: Pose, rays: Rays, version: int = 0) -> int:
        """Return in how many cells the map would change without a scan that was added so."""
        box = self._box(_segments(rays.placed(base), self._reach, self._resolution))
        if box is None:
            return 0
        left, top, right, bottom = _edges(*box)
        shape = bottom - top, right - left
        before = self.window(top, left, shape)
        self.remove(base, rays, version)
        after = self.window(top, left, shape)
        self.add(base, rays, version)
        return int(np.count_nonzero(before != after))

    def grid(self) -> OccupancyCells:
        """Return the map, with a border of 1 m around what was seen.

        Raises `ValueError` if nothing was.
        """
        rows, columns = (
            np.flatnonzero(self._ended.any(axis=axis) | self._passed.any(axis=axis))
            for axis in (1, 0)
        )
        if not rows.size:
            raise ValueError("it has no scan with a pose")
        border = math.ceil(_BORDER_M / self._resolution)
        top, left = int(rows[0]), int(columns[0])
        inner = slice(top, int(rows[-1]) + 1), slice(left, int(columns[-1]) + 1)
        cells = np.pad(self._cells(inner), border, constant_values=UNKNOWN)
        x = (self._column + left - border) * self._resolution
        y = (self._row + top - border) * self._resolution
        return Grid(cells, Frame(self._resolution, (x, y, 0.0)))

    def on_obstacles(self) -> float:
        """Return the share of the ends of rays that lie in a drawn obstacle, or beside one.

        Wrong poses, moving things and glass reduce it; it is 0 without rays.
        """
        rows, columns = self.shape
        on, kernel = 0, np.ones((3, 3), np.uint8)
        for first in range(0, rows, _BLOCK):
            last = min(first + _BLOCK, rows)
            around = slice(max(0, first - 1), min(last + 1, rows))
            cells = self._cells((around, slice(0, columns)))
            near = cv2.dilate((cells == OCCUPIED).astype(np.uint8), kernel) > 0
            inner = near[first - around.start : last - around.start]
            on += int(self._ended[first:last][inner].sum())
        return on / max(1, int(self._ended.sum()))

    def evidence(self, passes: int) -> Grid[np.uint8]:
        """Return for each cell what the rays say of it: NOT_SEEN, SEEN or SEEN_FREE.

        A cell is seen free if at least `passes` rays passed it, and no ray ended in it or beside
        it.
        """
        if not self._ended.size:
            return Grid(np.zeros((0, 0), np.uint8), self.frame)
        beside = cv2.dilate((self._ended > 0).astype(np.uint8), np.ones((3, 3), np.uint8))
        values = np.full(self._ended.shape, NOT_SEEN, np.uint8)
        values[(self._passed > 0) | (beside > 0)] = SEEN
        values[(self._passed >= passes) & (beside == 0)] = SEEN_FREE
        return Grid(values, self.frame)

    def ended_share(self, points: Array) -> Array:
        """Return for each point (n, 2) [m] the share of rays that ended around it.

        Those are the rays that ended in its cell or beside it, of these and the ones that passed
        its cell. It is 1 where no ray came.
        """
        cells = np.floor(points / self._resolution).astype(np.int64) - (self._column, self._row)
        rows, columns = self._ended.shape
        inside = (cells >= 1).all(axis=1) & (cells[:, 1] < rows - 1) & (cells[:, 0] < columns - 1)
        column, row = cells[inside].T
        ended = sum(self._ended[row + dy, column + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1))
        reached = ended + self._passed[row, column]
        shares = np.ones(len(points))
        shares[inside] = np.where(reached > 0, ended / np.maximum(reached, 1), 1.0)
        return shares

    @property
    def frame(self) -> Frame:
        """The frame of `whole`; it changes only when the map grows."""
        x, y = self._column * self._resolution, self._row * self._resolution
        return Frame(self._resolution, (x, y, 0.0))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of `whole`."""
        rows, columns = self._ended.shape
        return rows, columns

    def whole(self) -> OccupancyCells:
        """Return the map with room around it: it can grow there without a change of its frame."""
        rows, columns = self._ended.shape
        return Grid(self._cells((slice(0, rows), slice(0, columns))), self.frame)

    def window(self, row: int, column: int, shape: tuple[int, int]) -> NDArray[np.int8]:
        """Return a window of the map whose first cell is counted from the map's origin.

        Cells that no ray can have reached are unknown.
        """
        found = np.full(shape, UNKNOWN, np.int8)
        rows, columns = self.shape
        top, left = max(row, self._row), max(column, self._column)
        bottom = min(row + shape[0], self._row + rows)
        right = min(column + shape[1], self._column + columns)
        if top < bottom and left < right:
            inner = (
                slice(top - self._row, bottom - self._row),
                slice(left - self._column, right - self._column),
            )
            found[top - row : bottom - row, left - column : right - column] = self._cells(inner)
        return found

    def take_changes(self) -> tuple[int, int, NDArray[np.int8]] | None:
        """Return first row, first column and cells of what has changed in `whole` since last time.

        None if nothing has.
        """
        if self._changed is None:
            return None
        top, left, bottom, right = self._changed
        self._changed = None
        top, left = top - self._row, left - self._column
        bottom, right = bottom - self._row, right - self._column
        return top, left, self._cells((slice(top, bottom), slice(left, right)))

    def _cells(self, window: tuple[slice, slice]) -> NDArray[np.int8]:
        ended, passed = self._ended[window], self._passed[window]
        cells = np.full(ended.shape, UNKNOWN, np.int8)
        for first in range(0, len(cells), _BLOCK):
            rows = slice(first, first + _BLOCK)
            reached = ended[rows] + passed[rows]
            cells[rows][reached > 0] = FREE
            is_occupied = (ended[rows] > 0) & (ended[rows] >= OCCUPIED_SHARE * reached)
            cells[rows][is_occupied] = OCCUPIED
        return cells

    def _count(self, base: Pose, rays: Rays, times: int, version: int) -> None:
        segments = _segments(rays.placed(base), self._reach, self._resolution)
        box = self._box(segments)
        if box is None:
            return
        self._cover(*box)
        left, top, right, bottom = _edges(*box)
        self._note_change(top, left, bottom, right)
        starts, ends, hit, free_share = segments
        _count(
            starts / self._resolution, ends / self._resolution, hit, free_share, times,
            self._row, self._column, self._ended, self._passed, self._since, version,
        )  # fmt: skip

    def _box(
        self, segments: tuple[Array, Array, NDArray[np.bool_], Array]
    ) -> tuple[Array, Array] | None:
        """Return the least and the largest column and row of rays, None without rays.

        With a cell more, into which rounding may lead a ray.
        """
        starts, ends = segments[0] / self._resolution, segments[1] / self._resolution
        if not len(starts):
            return None
        least = np.minimum(starts.min(axis=0), ends.min(axis=0)) - 1
        most = np.maximum(starts.max(axis=0), ends.max(axis=0)) + 1
        return least, most

    def _note_change(self, top: int, left: int, bottom: int, right: int) -> None:
        if self._changed is not None:
            top, left = min(top, self._changed[0]), min(left, self._changed[1])
            bottom, right = max(bottom, self._changed[2]), max(right, self._changed[3])
        self._changed = top, left, bottom, right

    def _cover(self, least: Array, most: Array) -> None:
        """Grow the counts so that they have the cells from `least` to `most`, columns first."""
        rows, columns = self._ended.shape
        first = np.floor(least / _BLOCK) * _BLOCK
        last = (np.floor(most / _BLOCK) + 1) * _BLOCK
        if rows:
            first = np.minimum(first, (self._column, self._row))
            last = np.maximum(last, (self._column + columns, self._row + rows))
        width, height = (last - first).tolist()
        if (height, width) == (rows, columns):
            return
        if not width * height <= MOST_CELLS:
            meters = self._resolution * (most - least)
            raise ValueError(
                f"its scans cover {width * self._resolution:g} x {height * self._resolution:g} m, "
                f"which are {width * height:g} cells of {self._resolution} m, more than "
                f"{MOST_CELLS} (one scan covers {meters[0]:g} x {meters[1]:g} m)"
            )
        column, row = (int(value) for value in first)
        shape, corner = (int(height), int(width)), (self._row - row, self._column - column)
        self._ended = _grown(self._ended, shape, corner)
        self._passed = _grown(self._passed, shape, corner)
        self._row, self._column = row, column
        if self._renewals.tiles:
            self._since = self._renewals.cells(row, column, self.shape, self._resolution)


def build_grid(
    posed_scans: Iterable[tuple[Pose, LaserScan]], resolution: float, mount: Pose, reach: float
) -> OccupancyCells:
    """Build a map with cells of `resolution` [m] from scans with known poses of the base.

    As by a `ScanGrid`. Raises `ValueError` if `posed_scans` is empty, or the map had more than
    `MOST_CELLS`.
    """
    grid = ScanGrid(resolution, reach)
    for pose, scan in posed_scans:
        grid.add(pose, rays_of(scan, mount, (0.0, 0.0, 0.0)))
    return grid.grid()


def _grown(
    counts: NDArray[np.int32], shape: tuple[int, int], corner: tuple[int, int]
) -> NDArray[np.int32]:
    """Return counts in a larger grid, of which their first cell has this row and column."""
    grown = np.zeros(shape, np.int32)
    rows, columns = counts.shape
    if rows:
        grown[corner[0] : corner[0] + rows, corner[1] : corner[1] + columns] = counts
    return grown


def _edges(least: Array, most: Array) -> tuple[int, int, int, int]:
    left, top = (int(value) for value in np.floor(least))
    right, bottom = (int(value) + 1 for value in np.floor(most))
    return left, top, right, bottom


def _segments(
    rays: Rays, reach: float, resolution: float
) -> tuple[Array, Array, NDArray[np.bool_], Array]:
    """Return starts and ends (n, 2) [m] of the rays, and which of them hit something.

    The last array (n,) is the share of each ray up to which it says that cells are free.
    """
    reach = min(reach, rays.reach)
    valid = ~np.isnan(rays.ranges)
    ignored = resolution / _sines(rays)
    ranges, angles = rays.ranges[valid], rays.angles[valid]
    hit = ranges <= reach
    passed = np.where(np.isinf(ranges), min(reach, SURE_SHARE * rays.reach), reach)
    length = np.where(hit, ranges, passed)
    free_share = np.where(hit, 1.0 - ignored[valid] / np.maximum(length, resolution), 1.0)
    starts = rays.starts[valid]
    ends = starts + np.column_stack((length * np.cos(angles), length * np.sin(angles)))
    return starts, ends, hit, free_share


def _sines(rays: Rays) -> Array:
    """Return the sine (n,) of the angle between each ray and the surface it hit, 1 if unknown.

    The surface runs between the ends of rays some indices before and after.
    """
    count = rays.ranges.size
    sines = np.ones(count)
    if count <= 2 * _NEIGHBOR:
        return sines
    ranges = np.where(np.isfinite(rays.ranges), rays.ranges, math.nan)
    x = rays.starts[:, 0] + ranges * np.cos(rays.angles)
    y = rays.starts[:, 1] + ranges * np.sin(rays.angles)
    along_x = x[2 * _NEIGHBOR :] - x[: -2 * _NEIGHBOR]
    along_y = y[2 * _NEIGHBOR :] - y[: -2 * _NEIGHBOR]
    apart = np.hypot(along_x, along_y)
    middle = rays.angles[_NEIGHBOR:-_NEIGHBOR]
    across = np.abs(along_y * np.cos(middle) - along_x * np.sin(middle))
    with np.errstate(invalid="ignore", divide="ignore"):
        inner = np.where(apart <= _SURFACE_M, np.clip(across / apart, _GRAZING, 1.0), 1.0)
    sines[_NEIGHBOR:-_NEIGHBOR] = inner
    return sines


@compiled()
def first_step(begin: float, direction: float) -> tuple[int, float, float]:
    """Return the first step of a ray along one axis, in cells (Amanatides and Woo 1987).

    The step of the index, and the shares of the ray at which the first and each further border is
    crossed.
    """
    cell = math.floor(begin)
    if direction > 0.0:
        return 1, (cell + 1.0 - begin) / direction, 1.0 / direction
    if direction < 0.0:
        return -1, (cell - begin) / direction, -1.0 / direction
    return 0, math.inf, math.inf


@compiled(
    "void(float64[:, ::1], float64[:, ::1], boolean[::1], float64[::1], int64, int64, int64,"
    " int32[:, ::1], int32[:, ::1], int32[:, ::1], int64)"
)
def _count(
    starts: Array,
    ends: Array,
    hit: NDArray[np.bool_],
    free_share: Array,
    times: int,
    first_row: int,
    first_column: int,
    ended: NDArray[np.int32],
    passed: NDArray[np.int32],
    since: NDArray[np.int32],
    version: int,
) -> None:
    all_count = since.shape[0] == 0
    for i in range(len(starts)):
        x, y = starts[i, 0], starts[i, 1]
        dx, dy = ends[i, 0] - x, ends[i, 1] - y
        column, row = math.floor(x) - first_column, math.floor(y) - first_row
        last_column = math.floor(ends[i, 0]) - first_column
        last_row = math.floor(ends[i, 1]) - first_row
        step_x, next_x, every_x = first_step(x, dx)
        step_y, next_y, every_y = first_step(y, dy)
        for _ in range(abs(last_column - column) + abs(last_row - row)):
            if min(next_x, next_y) <= free_share[i] and (
                all_count or since[row, column] <= version
            ):
                passed[row, column] += times
            if next_x < next_y:
                next_x += every_x
                column += step_x
            else:
                next_y += every_y
                row += step_y
        if not (all_count or since[last_row, last_column] <= version):
            continue
        if hit[i]:
            ended[last_row, last_column] += times
        else:
            passed[last_row, last_column] += times
