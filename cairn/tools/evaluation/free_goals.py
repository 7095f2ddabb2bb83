"""Random goals that can be reached."""

from __future__ import annotations

import math

import numpy as np

from cairn.planar.poses import Pose
from cairn.tools.evaluation.shortest_ways import ShortestWays

_TRIES = 1000


def free_goal(
    ways: ShortestWays, start: Pose, least_m: float, room_m: float, random: np.random.Generator
) -> Pose | None:
    """A goal at least `least_m` [m] from `start`, with `room_m` [m] around it; None if none."""
    left, bottom, right, top = ways.bounds
    for _ in range(_TRIES):
        x, y = float(random.uniform(left, right)), float(random.uniform(bottom, top))
        far = math.hypot(x - start[0], y - start[1]) >= least_m
        if far and ways.room((x, y)) >= room_m and math.isfinite(ways.length(start[:2], (x, y))):
            return x, y, float(random.uniform(-math.pi, math.pi))
    return None
