"""The grid map as the localizer uses it: likelihood fields of beams, and free space."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
from cairn.planar.grid import (
    FREE_TO,
    OCCUPIED_FROM,
    Frame,
    Grid,
    OccupancyCells,
    changed_window,
    distance_field,
)
from cairn.planar.poses import Pose

Array = NDArray[np.float64]

# The map explains a beam that ends this near to an obstacle [m]: a little more than `beam_sd`.
_EXPLAINED_M = 0.12
# A beam within so many deviations of an obstacle measures it, and nothing else: 99.7 % of them do.
_NEAR_SD = 3.0
# A beam passes an obstacle if it meets one more than this before its end [m]: a beam along a wall
# meets it early if the pose is a little off. So far from the robot's center [m] it begins.
_BEYOND_M, _NEARER_M = 0.5, 0.3


# Rows of which a field is computed at once, to limit the memory for a large map.
_BAND = 1024


class LikelihoodField:
    """The log-likelihood of a beam that ends in a cell, by the distance of the cell to an obstacle.

    A beam is a measurement of the obstacle, Gaussian with deviation `sigma` [m], or with the share
    `stray` of anything else (people, furniture that was moved): log(exp(-d^2 / 2 sigma^2) (1 -
    stray) + stray) (Thrun, Burgard, Fox 2005, 6.4, with the logarithm taken once per cell instead
    of once per beam). A ring of cells without an obstacle nearby surrounds the map, so that a point
    off the map is never compared with its border.
    """

    def __init__(self, grid: OccupancyCells, sigma: float, stray: float) -> None:
        self.frame: Frame = grid.frame
        self.sigma, self.stray = sigma, stray
        self._reach = math.ceil(4.0 * sigma / grid.frame.resolution)
        rows, columns = grid.values.shape
        far = np.float32(math.log(stray))
        self.cells: NDArray[np.float32] = np.full((rows + 2, columns + 2), far, np.float32)
        self._obstacles: NDArray[np.bool_] = np.asarray(grid.values >= OCCUPIED_FROM)
        for top in range(0, rows, _BAND):
            self._rebuild(top, min(top + _BAND, rows), 0, columns)

    def renew(self, row: int, column: int, values: NDArray[np.int8]) -> None:
        """Replace the occupancy `values` (rows, columns) of the window that starts at a cell."""
        rows, columns = self._obstacles.shape
        bottom, right = row + values.shape[0], column + values.shape[1]
        self._obstacles[row:bottom, column:right] = values >= OCCUPIED_FROM
        reach = self._reach
        self._rebuild(
            max(0, row - reach),
            min(rows, bottom + reach),
            max(0, column - reach),
            min(columns, right + reach),
        )

    def log_likelihood(self, poses: Array, points: Array) -> Array:
        """Return the sum over end points (m, 2) [m, base frame], for each pose (3, n): (n,)."""
        total = np.empty(poses.shape[1])
        _weigh(
            np.ascontiguousarray(poses),
            self._in_cells(points),
            self.cells,
            1.0 / self.frame.resolution,
            *self.frame.origin,
            total,
        )
        return total

    def fit(self, pose: Pose, points: Array) -> float:
        """Return the share (0 to 1) of the end points (m, 2) that lie within 0.12 m of an
        obstacle.
        """
        if not len(points):
            return math.nan
        explained = self._values(np.full(1, _EXPLAINED_M, np.float32))[0]
        return float(np.mean(self._each(pose, points) >= explained))

    def deviation(self, pose: Pose, points: Array) -> float:
        """Return the root mean square distance [m] of end points to the nearest obstacle.

        Of those (m, 2) [m] within three deviations of one; NaN if there are none.
        """
        peak = (np.exp(self._each(pose, points)) - self.stray) / (1.0 - self.stray)
        near = peak[peak > math.exp(-0.5 * _NEAR_SD**2)]
        if not near.size:
            return math.nan
        return self.sigma * math.sqrt(float(np.mean(np.maximum(0.0, -2.0 * np.log(near)))))

    def clear(self, pose: Pose, starts: Array, ends: Array) -> float:
        """Return the share (0 to 1) of rays, from `starts` to `ends` (m, 2) [m, base frame],
        that meet no obstacle; NaN without any.
        """
        if not len(starts):
            return math.nan
        return 1.0 - float(np.mean(self._meet(pose, starts, ends)))

    def through_walls(self, pose: Pose, points: Array) -> float:
        """Return by how much beams that pass an obstacle before they end (m, 2) [m] explain less.

        Their ends may lie at obstacles, but from this pose those are hidden: such a beam measures
        something else. The sum of log-likelihoods that `log_likelihood` counts too much, at most 0.
        """
        far = np.hypot(points[:, 0], points[:, 1])
        some = points[far > _BEYOND_M + _NEARER_M]
        if not len(some):
            return 0.0
        far = far[far > _BEYOND_M + _NEARER_M, None]
        met = self._meet(pose, some * (_NEARER_M / far), some * (1.0 - _BEYOND_M / far))
        each = self._each(pose, some[met])
        return float(np.sum(math.log(self.stray) - each))

    def _meet(self, pose: Pose, starts: Array, ends: Array) -> NDArray[np.bool_]:
        """Return which rays (m,) meet an obstacle."""
        met = np.empty(len(starts), np.bool_)
        _met(
            pose[0],
            pose[1],
            pose[2],
            np.ascontiguousarray(starts),
            np.ascontiguousarray(ends),
            self._obstacles,
            self.frame.resolution,
            *self.frame.origin,
            met,
        )
        return met

    def _each(self, pose: Pose, points: Array) -> NDArray[np.float32]:
        """Return the log-likelihood (m,) of each end point (m, 2) [m]."""
        each = np.empty(len(points), np.float32)
        _gather(
            pose[0],
            pose[1],
            pose[2],
            self._in_cells(points),
            self.cells,
            1.0 / self.frame.resolution,
            *self.frame.origin,
            each,
        )
        return each

    def _rebuild(self, top: int, bottom: int, left: int, right: int) -> None:
        """Recompute the cells of a window, from obstacles as far around it as they matter."""
        reach = self._reach
        rows, columns = self._obstacles.shape
        first_row, first_column = max(0, top - reach), max(0, left - reach)
        last_row, last_column = min(rows, bottom + reach), min(columns, right + reach)
        around = self._obstacles[first_row:last_row, first_column:last_column]
        distance = distance_field(around, self.frame.resolution)
        inner = distance[
            top - first_row : bottom - first_row, left - first_column : right - first_column
        ]
        self.cells[top + 1 : bottom + 1, left + 1 : right + 1] = self._values(inner)

    def _values(self, distance: NDArray[np.float32]) -> NDArray[np.float32]:
        values = np.full(distance.shape, math.log(self.stray), np.float32)
        near = distance < self._reach * self.frame.resolution
        peak = np.exp(np.float32(-0.5 / self.sigma**2) * np.square(distance[near]))
        values[near] = np.log(peak * np.float32(1.0 - self.stray) + np.float32(self.stray))
        return values

    def _in_cells(self, points: Array) -> NDArray[np.float32]:
        cells = points.T / self.frame.resolution
        return np.ascontiguousarray(cells, np.float32)


@compiled(
    "void(float64[:, ::1], float32[:, ::1], float32[:, ::1], float64, float64, float64, float64,"
    " float64[::1])",
    sums_in_any_order=True,
)
def _weigh(
    poses: Array,
    points: NDArray[np.float32],
    field: NDArray[np.float32],
    per_meter: float,
    origin_x: float,
    origin_y: float,
    origin_theta: float,
    total: Array,
) -> None:
    rows, columns = field.shape
    flat = field.ravel()
    beams = points.shape[1]
    across, along = math.sin(origin_theta), math.cos(origin_theta)
    last_column, last_row = np.float32(columns - 1), np.float32(rows - 1)
    zero = np.float32(0.0)
    for i in range(poses.shape[1]):
        dx, dy = poses[0, i] - origin_x, poses[1, i] - origin_y
        # In cells of the padded field: its ring is one cell wide.
        x = np.float32((along * dx + across * dy) * per_meter + 1.0)
        y = np.float32((along * dy - across * dx) * per_meter + 1.0)
        theta = poses[2, i] - origin_theta
        cosine, sine = np.float32(math.cos(theta)), np.float32(math.sin(theta))
        sum_ = zero
        for b in range(beams):
            column = x + cosine * points[0, b] - sine * points[1, b]
            row = y + sine * points[0, b] + cosine * points[1, b]
            # Points off the map fall onto the ring, which has no obstacle nearby.
            column = min(max(column, zero), last_column)
            row = min(max(row, zero), last_row)
            sum_ += flat[np.int32(row) * columns + np.int32(column)]
        total[i] = sum_


@compiled(
    "void(float64, float64, float64, float32[:, ::1], float32[:, ::1], float64, float64, float64,"
    " float64, float32[::1])"
)
def _gather(
    x: float,
    y: float,
    theta: float,
    points: NDArray[np.float32],
    field: NDArray[np.float32],
    per_meter: float,
    origin_x: float,
    origin_y: float,
    origin_theta: float,
    each: NDArray[np.float32],
) -> None:
    rows, columns = field.shape
    dx, dy = x - origin_x, y - origin_y
    across, along = math.sin(origin_theta), math.cos(origin_theta)
    begin_x = (along * dx + across * dy) * per_meter + 1.0
    begin_y = (along * dy - across * dx) * per_meter + 1.0
    cosine, sine = math.cos(theta - origin_theta), math.sin(theta - origin_theta)
    for b in range(points.shape[1]):
        column = begin_x + cosine * points[0, b] - sine * points[1, b]
        row = begin_y + sine * points[0, b] + cosine * points[1, b]
        column = min(max(column, 0.0), columns - 1.0)
        row = min(max(row, 0.0), rows - 1.0)
        each[b] = field[int(row), int(column)]


@compiled(
    "void(float64, float64, float64, float64[:, ::1], float64[:, ::1], boolean[:, ::1], float64,"
    " float64, float64, float64, boolean[::1])"
)
def _met(
    x: float,
    y: float,
    theta: float,
    starts: Array,
    ends: Array,
    obstacles: NDArray[np.bool_],
    resolution: float,
    origin_x: float,
    origin_y: float,
    origin_theta: float,
    met: NDArray[np.bool_],
) -> None:
    """Put into `met` which rays meet an obstacle, checked once per length of a cell."""
    rows, columns = obstacles.shape
    dx, dy = x - origin_x, y - origin_y
    across, along = math.sin(origin_theta), math.cos(origin_theta)
    base_x = (along * dx + across * dy) / resolution
    base_y = (along * dy - across * dx) / resolution
    cosine, sine = math.cos(theta - origin_theta), math.sin(theta - origin_theta)
    for i in range(starts.shape[0]):
        met[i] = False
        from_x, from_y = starts[i, 0] / resolution, starts[i, 1] / resolution
        far_x, far_y = ends[i, 0] / resolution - from_x, ends[i, 1] / resolution - from_y
        steps = int(math.hypot(far_x, far_y)) + 1
        for k in range(steps + 1):
            px, py = from_x + far_x * k / steps, from_y + far_y * k / steps
            column = math.floor(base_x + cosine * px - sine * py)
            row = math.floor(base_y + sine * px + cosine * py)
            if 0 <= row < rows and 0 <= column < columns and obstacles[int(row), int(column)]:
                met[i] = True
                break


class FreeSpace:
    """The free cells of a map."""

    def __init__(self, grid: OccupancyCells) -> None:
        self._frame = grid.frame
        self._columns = grid.values.shape[1]
        free = (grid.values >= 0) & (grid.values <= FREE_TO)
        self._cells = np.flatnonzero(free).astype(np.int32)

    @property
    def area(self) -> float:
        """The free area [m^2]."""
        return len(self._cells) * self._frame.resolution**2

    def draw(self, count: int, random: np.random.Generator) -> Array:
        """Return `count` poses (3, count), uniform over the free cells and all headings."""
        poses = np.empty((3, count))
        if not len(self._cells):
            return poses[:, :0]
        chosen = self._cells[random.integers(0, len(self._cells), count)]
        row, column = np.divmod(chosen, self._columns)
        along = (column + random.random(count)) * self._frame.resolution
        across = (row + random.random(count)) * self._frame.resolution
        x, y, theta = self._frame.origin
        cosine, sine = math.cos(theta), math.sin(theta)
        poses[0] = x + cosine * along - sine * across
        poses[1] = y + sine * along + cosine * across
        poses[2] = random.uniform(-math.pi, math.pi, count)
        return poses


# Deviation of a beam [m] for a first look at the whole map, where few poses are drawn near any: of
# 300 poses per m^2 (`global_search`), 115 lie within this distance of the robot, 0.05 rad apart.
_WIDE_M = 0.35


class ScanMap:
    """Likelihood fields of one grid map: `field` for a beam of deviation `beam_sd_m`, and,
    computed on first use, `wide` for a loose beam, and the `free` space.
    """

    def __init__(self, grid: OccupancyCells, beam_sd_m: float, stray: float) -> None:
        self._grid: OccupancyCells = Grid(np.array(grid.values), grid.frame)
        self._stray = stray
        self.field = LikelihoodField(grid, beam_sd_m, stray)
        self._wide: LikelihoodField | None = None
        self._free: FreeSpace | None = None

    @property
    def wide(self) -> LikelihoodField:
        """The field of a loose beam."""
        if self._wide is None:
            self._wide = LikelihoodField(self._grid, _WIDE_M, self._stray)
        return self._wide

    @property
    def free(self) -> FreeSpace:
        """Where a robot may be."""
        if self._free is None:
            self._free = FreeSpace(self._grid)
        return self._free

    def replace(self, grid: OccupancyCells) -> bool:
        """Replace the map by a new one; return False if that has another frame or size."""
        if grid.frame != self._grid.frame or grid.values.shape != self._grid.values.shape:
            return False
        window = changed_window(self._grid.values, grid.values)
        if window is not None:
            self.renew(window[0].start, window[1].start, grid.values[window])
        return True

    def fits(self, row: int, column: int, values: NDArray[np.int8]) -> bool:
        """Whether a window of cells lies on the map."""
        rows, columns = self._grid.values.shape
        height, width = values.shape
        return bool(0 <= row <= rows - height and 0 <= column <= columns - width)

    def renew(self, row: int, column: int, values: NDArray[np.int8]) -> None:
        """Replace the `values` (rows, columns) of the window that starts at a cell of the map."""
        height, width = values.shape
        self._grid.values[row : row + height, column : column + width] = values
        self.field.renew(row, column, values)
        self._wide = self._free = None
