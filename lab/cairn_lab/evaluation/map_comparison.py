"""Compares a robot's map with the world: its walls, and the known share of the reachable area."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares

from cairn.components.simulation.survey import surveyed_grid
from cairn.components.simulation.world_file import read_world
from cairn.planar.grid import (
    FREE,
    OCCUPIED,
    OCCUPIED_FROM,
    UNKNOWN,
    Frame,
    Grid,
    OccupancyCells,
    distance_field,
)
from cairn.planar.poses import Pose, compose, inverse

Array = NDArray[np.float64]

WALL_M = 0.05
"""A wall of a map that is so near to one of the world agrees with it [m]."""
ROBOT_RADIUS_M = 0.22
"""Radius of the shipped deployments' robot [m]."""

# Cells [m] of the world's map in which distances to its walls are measured.
_FINE_M = 0.01
# Walls farther than this [m] do not pull: in the alignment of the maps, they have no counterpart.
_PULL_M = 0.3


@dataclass(frozen=True)
class MapComparison:
    """How well a map agrees with the world.

    Attributes:
        pose: of the map's frame in the world's, so that the walls agree best [m, m, rad].
        known: share of the reachable area that the map knows: what the robot's body covers where
            it can drive [1].
        wall_errors_m: (n,) distance of each obstacle cell's center to the nearest surface [m].

    """

    pose: Pose
    known: float
    wall_errors_m: Array

    def within(self, meters: float) -> float:
        """Return the share of the map's obstacle cells that are so near to a surface [1]."""
        return float(np.mean(self.wall_errors_m <= meters))


def compare_with_world(
    grid: OccupancyCells, world: Path, frame: Pose, radius: float
) -> MapComparison:
    """Compare a map with a world.

    Args:
        grid: the robot's map.
        world: world file.
        frame: pose of the map's frame in the world's, to some decimeters [m, m, rad].
        radius: of the robot [m].

    """
    fine = surveyed_grid(world, _FINE_M)
    rows, columns = np.nonzero(grid.values >= OCCUPIED_FROM)
    walls = _points(grid.frame, rows, columns)
    surfaces = distance_field(fine.values == OCCUPIED, _FINE_M)

    def errors(pose: Array) -> Array:
        return _at(surfaces, fine.frame, _placed(pose, walls))

    found = least_squares(
        lambda pose: np.minimum(errors(pose), _PULL_M), np.array(frame), loss="soft_l1",
        f_scale=0.05, x_scale=(1.0, 1.0, 0.1), diff_step=1e-4,
    )  # fmt: skip
    x, y, theta = found.x.tolist()
    pose = (x, y, theta)
    area = _reachable(surveyed_grid(world), read_world(world).robot.pose, radius)
    known = _known(grid, _placed(np.array(inverse(pose)), area))
    return MapComparison(pose, float(np.mean(known)), errors(found.x))


def placed_map(grid: OccupancyCells, pose: Pose) -> OccupancyCells:
    """Return the map in the frame in which its own frame has the pose `pose`."""
    return Grid(grid.values, Frame(grid.frame.resolution, compose(pose, grid.frame.origin)))


def _reachable(true: OccupancyCells, start: Pose, radius: float) -> Array:
    """Return the centers (n, 2) [m] of the cells that the robot's body can cover."""
    resolution = true.frame.resolution
    fits = (true.values == FREE) & (
        distance_field(true.values == OCCUPIED, resolution) > radius + 0.5 * resolution
    )
    _, labels = cv2.connectedComponents(fits.view(np.uint8), connectivity=4)
    reached = labels == labels[true.frame.cell(start[0], start[1])]
    covered = (distance_field(reached, resolution) <= radius) & (true.values == FREE)
    rows, columns = np.nonzero(covered)
    return _points(true.frame, rows, columns)


def _known(grid: OccupancyCells, points: Array) -> NDArray[np.bool_]:
    rows, columns = (np.floor(one).astype(np.int64) for one in _cells(grid.frame, points))
    inside = (rows >= 0) & (rows < grid.values.shape[0])
    inside &= (columns >= 0) & (columns < grid.values.shape[1])
    known = np.zeros(len(points), np.bool_)
    known[inside] = grid.values[rows[inside], columns[inside]] != UNKNOWN
    return known


def _at(field: NDArray[np.float32], frame: Frame, points: Array) -> Array:
    """Return the values of a field at points, interpolated; outside, those at its edge."""
    cells = [one - 0.5 for one in _cells(frame, points)]
    return np.asarray(map_coordinates(field, cells, np.float64, order=1, mode="nearest"))


def _placed(pose: Array, points: Array) -> Array:
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    placed: Array = points @ np.array([[cosine, sine], [-sine, cosine]]) + pose[:2]
    return placed


def _points(frame: Frame, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Array:
    cells = np.column_stack((columns + 0.5, rows + 0.5)) * frame.resolution
    return _placed(np.array(frame.origin), cells)


def _cells(frame: Frame, points: Array) -> tuple[Array, Array]:
    """Return rows and columns of points, from the grid's corner."""
    columns, rows = (_placed(np.array(inverse(frame.origin)), points) / frame.resolution).T
    return rows, columns
