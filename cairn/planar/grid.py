"""Grids of square cells in the plane: occupancy grids as in ROS, and distances to obstacles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from cairn.planar.messages import planar_pose, pose_message
from cairn.planar.poses import Pose
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.nav_msgs import MapMetaData, OccupancyGrid
from cairn.schemas.std_msgs import Header

FREE, OCCUPIED, UNKNOWN = 0, 100, -1
"""Values of an occupancy grid's cells; 1 to 99 are probabilities of an obstacle [%]."""

OCCUPIED_FROM, FREE_TO = 65, 25
"""Least probability [%] of an obstacle cell, and highest of a free cell; between them neither.

These are the defaults of ROS's map_server: occupied_thresh 0.65 and free_thresh 0.25.
"""

Value = TypeVar("Value", bound=np.generic)
Coordinate = TypeVar("Coordinate", float, NDArray[np.float64])


@dataclass(frozen=True)
class Frame:
    """Position of a grid: size of a cell [m], pose of the outer corner of cell (0, 0) [m, rad].

    Cell (row, column) covers column..column + 1 cells along the origin's x axis and
    row..row + 1 along its y axis; its center is half a cell in.
    """

    resolution: float
    origin: Pose = (0.0, 0.0, 0.0)

    def cell(self, x: float, y: float) -> tuple[int, int]:
        """Return row and column of the cell with the point x, y [m]; it may be outside the grid."""
        columns, rows = self.cells(x, y)
        return math.floor(rows), math.floor(columns)

    def cells(self, x: Coordinate, y: Coordinate) -> tuple[Coordinate, Coordinate]:
        """Return the point x, y [m] in cells along the grid's x and y axes, from its corner."""
        ox, oy, theta = self.origin
        cosine, sine = math.cos(theta), math.sin(theta)
        dx, dy = x - ox, y - oy
        return (
            (cosine * dx + sine * dy) / self.resolution,
            (cosine * dy - sine * dx) / self.resolution,
        )

    def point(self, row: Coordinate, column: Coordinate) -> tuple[Coordinate, Coordinate]:
        """Return x, y [m] of the center of a cell."""
        ox, oy, theta = self.origin
        along, across = (column + 0.5) * self.resolution, (row + 0.5) * self.resolution
        cosine, sine = math.cos(theta), math.sin(theta)
        return ox + cosine * along - sine * across, oy + sine * along + cosine * across


def changed_window(old: NDArray[Value], new: NDArray[Value]) -> tuple[slice, slice] | None:
    """Return the smallest window (rows, columns) with all cells in which two grids differ.

    None if they are equal. Both have the same shape.
    """
    other = old != new
    rows = np.flatnonzero(other.any(axis=1))
    if not rows.size:
        return None
    columns = np.flatnonzero(other.any(axis=0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


@dataclass(frozen=True)
class Grid(Generic[Value]):
    """Cell values (rows, columns), row 0 at the origin, and their position in the plane."""

    values: NDArray[Value]
    frame: Frame

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height [m] along the grid's own axes."""
        rows, columns = self.values.shape
        return columns * self.frame.resolution, rows * self.frame.resolution

    def holds(self, row: int, column: int) -> bool:
        """Return whether a cell is on the grid."""
        rows, columns = self.values.shape
        return bool(0 <= row < rows and 0 <= column < columns)


OccupancyCells = Grid[np.int8]


def grid_of(message: OccupancyGrid) -> OccupancyCells:
    """Return the cells of a map message; they share its memory and are read-only."""
    info = message.info
    values = message.data.reshape(info.height, info.width)
    return Grid(values, Frame(info.resolution, planar_pose(info.origin)))


def map_message(header: Header, grid: OccupancyCells, loaded: Time) -> OccupancyGrid:
    """Return a map as a message; `loaded` is the time at which it was made."""
    rows, columns = grid.values.shape
    info = MapMetaData(
        map_load_time=loaded,
        resolution=grid.frame.resolution,
        width=columns,
        height=rows,
        origin=pose_message(grid.frame.origin),
    )
    return OccupancyGrid(header=header, info=info, data=grid.values.ravel())


def distance_field(obstacles: NDArray[np.bool_], resolution: float) -> NDArray[np.float32]:
    """Return the exact distance [m] of each cell's center to that of the nearest obstacle cell.

    Infinite everywhere in a grid without obstacles. `obstacles` (rows, columns). Felzenszwalb and
    Huttenlocher 2012, by OpenCV's precise distance transform.
    """
    if not obstacles.any():
        return np.full(obstacles.shape, np.inf, np.float32)
    free = np.logical_not(obstacles).view(np.uint8)
    # Intel's routine (IPP) rounds differently depending on the arrays' memory addresses, so that
    # its results are not reproducible.
    used = cv2.ipp.useIPP()
    cv2.ipp.setUseIPP(False)
    try:
        cells = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    finally:
        cv2.ipp.setUseIPP(used)
    field: NDArray[np.float32] = np.asarray(cells, np.float32)
    field *= np.float32(resolution)  # in place: a large map's field takes 100 MB
    return field
