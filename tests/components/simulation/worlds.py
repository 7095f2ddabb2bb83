"""Small worlds for the tests."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from cairn.components.simulation.world import RobotBody, SlipConfig, World
from cairn.components.simulation.world_file import WorldFile

RADIUS = 0.22
NO_SLIP = SlipConfig(distance=0.0, turn=0.0, turn_per_meter=0.0)


def box(width: float = 6.0, depth: float = 4.0, **more: Any) -> dict[str, Any]:
    """A closed room from (0, 0) to (width, depth), the robot in its middle, as in a file."""
    corners = [[0.0, 0.0], [width, 0.0], [width, depth], [0.0, depth], [0.0, 0.0]]
    middle = {"x": width / 2, "y": depth / 2}
    return {"walls": [{"points": corners}], "robot": middle, **more}


def world_of(slip: SlipConfig = NO_SLIP, others: Sequence[RobotBody] = (), **more: Any) -> World:
    """A world in such a room, with `others` beside its robot."""
    random = np.random.default_rng(0)
    return World(world_file(**more), RADIUS, slip, random, others=others)


def world_file(**more: Any) -> WorldFile:
    """The same as a parsed world file."""
    return WorldFile.model_validate(box(**more))
