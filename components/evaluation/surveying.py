"""Makes a world ready for runs: its maps as its importers survey it, and the robot's start."""

from __future__ import annotations

from pathlib import Path

from components.map_builder.importing import altered, write_map
from components.simulation.survey import surveyed_grid, surveyed_objects
from components.simulation.world_file import read_world
from planar.map_file import write_map as write_grid
from planar.poses import Pose


def survey(world: Path, map_file: Path, visual_map: Path) -> Pose:
    """Write the maps of a world as it stands at the beginning; where the robot then stands."""
    write_grid(map_file, surveyed_grid(world))
    objects = altered(surveyed_objects(world), {}, ())
    write_map(visual_map, f"surveyed of {world.name}", objects)
    return read_world(world).robot.pose
