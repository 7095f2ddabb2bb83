"""A simulated world as a surveyor would map it: its grid map and its visual map."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from cairn.errors import CairnError
from components.simulation.scene import Scene, corners_of, problems_of
from components.simulation.world_file import WorldFile, read_world
from planar.grid import FREE, OCCUPIED, UNKNOWN, Frame, Grid, OccupancyCells
from schemas.cairn_msgs import VisualMap, VisualObject

RESOLUTION = 0.05
# Unknown cells around the world [m].
_BORDER_M = 0.5


def surveyed_grid(file: Path) -> OccupancyCells:
    """The grid map of a world file: what stands, and the space around the robot's start.

    What the robot cannot see from within is unknown. People are not surveyed.
    """
    world = read_world(file)
    _check(file, world)
    return grid_of_world(world)


def grid_of_world(world: WorldFile) -> OccupancyCells:
    """The grid map of a world."""
    scene = Scene.of(world)
    segments, _ = scene.segments()
    ends = segments.reshape(-1, 2)
    # Half a cell off round numbers, on which walls stand: they pass through the middle of cells.
    least = ends.min(axis=0) - _BORDER_M - RESOLUTION / 2
    most = ends.max(axis=0) + _BORDER_M
    columns, rows = np.ceil((most - least) / RESOLUTION).astype(int)
    frame = Frame(RESOLUTION, (float(least[0]), float(least[1]), 0.0))
    solid = np.zeros((rows, columns), np.uint8)
    for x1, y1, x2, y2 in segments.tolist():
        # A cell is occupied where a wall passes through it.
        length = float(np.hypot(x2 - x1, y2 - y1))
        share = np.linspace(0.0, 1.0, max(2, int(length / (0.2 * RESOLUTION)) + 1))
        column = np.floor((x1 + share * (x2 - x1) - least[0]) / RESOLUTION).astype(int)
        row = np.floor((y1 + share * (y2 - y1) - least[1]) / RESOLUTION).astype(int)
        solid[row, column] = 1
    inside = np.zeros((rows, columns), np.uint8)
    for piece in scene.furniture.values():
        corners = (np.array(corners_of(piece)) - least) / RESOLUTION - 0.5
        cv2.fillPoly(inside, [np.rint(corners).astype(np.int32)], 1)
    cells = np.full((rows, columns), UNKNOWN, np.int8)
    row, column = frame.cell(world.robot.x, world.robot.y)
    reached = ((solid == 0) & (inside == 0)).astype(np.uint8)
    cv2.floodFill(reached, None, (column, row), 2, flags=4)
    cells[reached == 2] = FREE
    cells[(solid == 1)] = OCCUPIED
    return Grid(cells, frame)


def surveyed_objects(file: Path) -> VisualMap:
    """The objects of a world file, where they stand at the beginning."""
    world = read_world(file)
    _check(file, world)
    return VisualMap(
        objects=tuple(
            VisualObject(
                object_id=thing.id,
                name=thing.called,
                x=thing.x,
                y=thing.y,
                covariance=np.array([1e-4, 0.0, 0.0, 1e-4]),
                reliability=0.5,
            )
            for thing in world.objects
        )
    )


def _check(file: Path, world: WorldFile) -> None:
    problems = problems_of(Scene.of(world), world.robot.pose, 0.0)
    if problems:
        raise CairnError(f"{file}: " + "; ".join(problems))
