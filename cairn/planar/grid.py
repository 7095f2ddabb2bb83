"""Grids of square cells laid over the plane, and occupancy grids in ROS's terms."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from cairn.planar.messages import planar_pose, pose_message
from cairn.planar.poses import Pose
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.nav_msgs import MapMetaData, OccupancyGrid
from cairn.schemas.std_msgs import Header

FREE, OCCUPIED, UNKNOWN = 0, 100, -1
"""Values of an occupancy grid's cells; 1 to 99 are probabilities in percent."""

OCCUPIED_FROM, FREE_TO = 65, 25
"""Probabilities [%] from which on a cell is an obstacle, and up to which it is free.

As map_server's defaults have it, occupied_thresh 0.65 and free_thresh 0.25. In between neither.
"""

Value = TypeVar("Value", bound=np.generic)


@dataclass(frozen=True)
class Frame:
    """Where a grid lies: size of a cell [m], pose of the outer corner of cell (0, 0) [m, rad].

    Cell (row, column) covers column..column + 1 cells along the origin's x axis and
    row..row + 1 along its y axis; its center is half a cell in.
    """

    resolution: float
    origin: Pose = (0.0, 0.0, 0.0)

    def cell(self, x: float, y: float) -> tuple[int, int]:
        """Row and column of the cell that holds the point x, y [m]; may lie off the grid."""
        columns, rows = self.cells(x, y)
        return math.floor(rows), math.floor(columns)

    def cells(self, x: float, y: float) -> tuple[float, float]:
        """The point x, y [m] in cells along the grid's own x and y axes from its corner."""
        ox, oy, theta = self.origin
        cosine, sine = math.cos(theta), math.sin(theta)
        dx, dy = x - ox, y - oy
        return (
            (cosine * dx + sine * dy) / self.resolution,
            (cosine * dy - sine * dx) / self.resolution,
        )

    def point(self, row: float, column: float) -> tuple[float, float]:
        """x, y [m] of the center of a cell."""
        ox, oy, theta = self.origin
        along, across = (column + 0.5) * self.resolution, (row + 0.5) * self.resolution
        cosine, sine = math.cos(theta), math.sin(theta)
        return ox + cosine * along - sine * across, oy + sine * along + cosine * across


def changed_window(old: NDArray[Value], new: NDArray[Value]) -> tuple[slice, slice] | None:
    """The least window, rows and columns, that holds all cells in which two grids of one size
    differ; None if none does.
    """
    other = old != new
    rows = np.flatnonzero(other.any(axis=1))
    if not rows.size:
        return None
    columns = np.flatnonzero(other.any(axis=0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


@dataclass(frozen=True)
class Grid(Generic[Value]):
    """Cell values (rows, columns), row 0 at the origin, and where they lie."""

    values: NDArray[Value]
    frame: Frame

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height [m] along the grid's own axes."""
        rows, columns = self.values.shape
        return columns * self.frame.resolution, rows * self.frame.resolution

    def holds(self, row: int, column: int) -> bool:
        """Whether a cell lies on the grid."""
        rows, columns = self.values.shape
        return bool(0 <= row < rows and 0 <= column < columns)


OccupancyCells = Grid[np.int8]


def grid_of(message: OccupancyGrid) -> OccupancyCells:
    """The cells of a map; they share the message's memory and are read-only."""
    info = message.info
    values = message.data.reshape(info.height, info.width)
    return Grid(values, Frame(info.resolution, planar_pose(info.origin)))


def map_message(header: Header, grid: OccupancyCells, loaded: Time) -> OccupancyGrid:
    """A map as a message; `loaded` is when it was made."""
    rows, columns = grid.values.shape
    info = MapMetaData(
        map_load_time=loaded,
        resolution=grid.frame.resolution,
        width=columns,
        height=rows,
        origin=pose_message(grid.frame.origin),
    )
    return OccupancyGrid(header=header, info=info, data=grid.values.ravel())
