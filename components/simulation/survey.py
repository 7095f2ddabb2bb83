"""The true maps of a simulated world: its grid map, visual map and object pictures."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np

from cairn import CairnError
from cairn.components.simulation.layout import WorldLayout
from cairn.components.simulation.textures import object_picture
from cairn.components.simulation.world_checks import wall_gaps, world_problems
from cairn.components.simulation.world_file import WorldFile, read_world
from cairn.planar.grid import FREE, OCCUPIED, UNKNOWN, Frame, Grid, OccupancyCells
from cairn.schemas.cairn_msgs import VisualMap, VisualObject
from cairn.vision.object_model import ObjectModel
from cairn.vision.teaching import make_view

RESOLUTION = 0.05
# Width of unknown cells around the world [m].
_BORDER_M = 0.5
# Room that the checks require around the robot's start [m], as the robot's radius is not known.
_ROOM_M = 0.05


def surveyed_grid(file: Path, resolution: float = RESOLUTION) -> OccupancyCells:
    """Return the grid map of a world file: walls, furniture, and the reachable space.

    Cells have a size of `resolution` [m]. What the robot cannot reach from inside is unknown.
    People are left out.
    """
    world = _checked(file)
    try:
        return grid_of_world(world, resolution)
    except CairnError as error:
        raise CairnError(f"{file}: {error}") from error


def grid_of_world(world: WorldFile, resolution: float = RESOLUTION) -> OccupancyCells:
    """Return the grid map of a world; `CairnError` if walls have gaps or cells are too large."""
    layout = WorldLayout.of(world)
    segments = layout.solid_segments.segments
    ends = segments.reshape(-1, 2)
    # Shifted by half a cell: walls are at round coordinates and then pass through the middle of
    # cells.
    margin = math.ceil(_BORDER_M / resolution) * resolution
    least = ends.min(axis=0) - margin - resolution / 2
    most = ends.max(axis=0) + margin
    columns, rows = np.ceil((most - least) / resolution).astype(int)
    frame = Frame(resolution, (float(least[0]), float(least[1]), 0.0))
    solid = np.zeros((rows, columns), np.uint8)
    for x1, y1, x2, y2 in segments.tolist():
        # A cell is occupied if a wall passes through it.
        length = float(np.hypot(x2 - x1, y2 - y1))
        share = np.linspace(0.0, 1.0, max(2, int(length / (0.2 * resolution)) + 1))
        column = np.floor((x1 + share * (x2 - x1) - least[0]) / resolution).astype(int)
        row = np.floor((y1 + share * (y2 - y1) - least[1]) / resolution).astype(int)
        solid[row, column] = 1
    cells = np.full((rows, columns), UNKNOWN, np.int8)
    start = frame.cell(world.robot.x, world.robot.y)
    if solid[start]:
        raise CairnError(
            f"with cells of {resolution:g} m the robot starts in an occupied cell; choose a finer "
            "--resolution"
        )
    reached = 1 - solid
    # Fill across sides, not corners, so that outlines keep the fill out of furniture.
    cv2.floodFill(reached, None, start[::-1], 2, flags=4)
    border = np.concatenate((reached[[0, -1]].ravel(), reached[:, [0, -1]].ravel()))
    if np.any(border == 2):
        gaps = wall_gaps(layout, world.robot.pose, 0.0)
        where = " and one ".join(map(str, gaps)) or "to the outside"
        raise CairnError(f"the walls leave a gap {where}; close it")
    cells[reached == 2] = FREE
    cells[(solid == 1)] = OCCUPIED
    return Grid(cells, frame)


def surveyed_objects(file: Path) -> VisualMap:
    """Return the objects of a world file at their poses at the start."""
    world = _checked(file)
    return VisualMap(
        objects=tuple(
            VisualObject(
                object_id=thing.id,
                name=thing.display_name,
                x=thing.x,
                y=thing.y,
                covariance=np.array([1e-4, 0.0, 0.0, 1e-4]),
                reliability=0.5,
            )
            for thing in world.objects
        )
    )


def surveyed_models(file: Path) -> tuple[ObjectModel, ...]:
    """Return the object models of a world file: each by the picture on it, with its size."""
    return tuple(
        ObjectModel(
            thing.id,
            thing.display_name,
            thing.size,
            (make_view(object_picture(thing.texture or "", thing.id, thing.size)),),
        )
        for thing in _checked(file).objects
    )


def _checked(file: Path) -> WorldFile:
    world = read_world(file)
    problems = world_problems(world, _ROOM_M)
    if problems:
        raise CairnError(f"{file}: " + "; ".join(problems))
    return world
