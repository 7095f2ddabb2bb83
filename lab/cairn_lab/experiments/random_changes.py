"""Random changes of a world: objects moved along its walls, and poses for a kidnapped robot."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from cairn import CairnError
from cairn.components.simulation.layout import WorldLayout
from cairn.components.simulation.world_file import VisibleObject, read_world
from cairn.planar.poses import Pose, compose

# Candidate positions along the walls: their spacing, and their least distance from corners.
_SPACING_M, _FROM_CORNERS_M = 0.05, 0.25
# Free space in front of an object, to this distance and on both sides, or nothing could see it [m].
_IN_FRONT_M, _CLEARANCE_M = 0.6, 0.15
# Least distance between objects [m]: the localizer treats objects closer than 0.35 m as one.
APART_M = 0.35
# Least distance of a move [m] if none is specified.
LEAST_MOVE_M = 0.6
# Tolerance of a specified distance of a move [m].
_DISTANCE_TOLERANCE_M = 0.03


class RandomChanges:
    """Draws random changes of a world, which is read as it is at the beginning."""

    def __init__(self, world_file: Path) -> None:
        """Read the world; raises `CairnError` if the file does not exist or is invalid."""
        self._file = world_file
        world = read_world(world_file)
        self._layout = WorldLayout.of(world)
        self._start = world.robot.pose
        furniture = [self._layout.shapes[name] for name in self._layout.furniture]
        self._furniture = shapely.union_all(furniture)

    def draw_moves(
        self, count: int, distance: float | None, at: float, random: np.random.Generator
    ) -> list[dict[str, Any]]:
        """Return events of a world that move `count` objects along the walls at `at` [s].

        They are moved by `distance` [m], or by at least 0.6 m if None. Raises `CairnError` if there
        is not enough room.
        """
        objects = self._layout.objects
        taken = [(name, thing.pose) for name, thing in objects.items()]
        events: list[dict[str, Any]] = []
        for name in random.permutation(sorted(objects)).tolist():
            if len(events) == count:
                break
            thing = objects[name]
            free = [pose for pose in self._poses if _fits(pose, thing, distance, taken)]
            if not free:
                continue
            x, y, theta = free[int(random.integers(len(free)))]
            taken.append(("", (x, y, theta)))
            events.append({"at": at, "move": name, "to": {"x": x, "y": y, "theta": theta}})
        if len(events) < count:
            by = "" if distance is None else f" by {distance:g} m"
            raise CairnError(
                f"{self._file}: only {len(events)} of {len(objects)} objects can be moved{by} "
                f"along the walls, not {count}; use a smaller --moved or another --move-distance"
            )
        return events

    def draw_kidnap_pose(self, clearance: float, random: np.random.Generator) -> Pose:
        """Return a pose that the robot could drive to, with `clearance` [m] around it.

        Raises `CairnError` if there is no such pose.
        """
        shapes = list(self._layout.shapes.values())
        space = shapely.box(*shapely.union_all(shapes).bounds)
        parts = shapely.get_parts(space.difference(shapely.union_all(shapes).buffer(clearance)))
        start = shapely.Point(self._start[:2])
        reachable = min(parts, key=lambda part: part.distance(start), default=None)
        if reachable is None:
            raise CairnError(
                f"{self._file}: there is no free position for a kidnapped robot; omit --kidnap"
            )
        left, bottom, right, top = reachable.bounds
        while True:
            x, y = float(random.uniform(left, right)), float(random.uniform(bottom, top))
            if reachable.contains(shapely.Point(x, y)):
                return x, y, float(random.uniform(-math.pi, math.pi))

    @cached_property
    def _poses(self) -> tuple[Pose, ...]:
        """Poses at which an object could be seen: along the walls, facing inwards."""
        outside = self._layout.outside_of(0.01)
        return tuple(
            pose
            for wall in self._layout.walls
            for begin, end in pairwise(wall.points)
            for pose in _along(begin, end)
            if not outside(*_in_front(pose, _IN_FRONT_M)) and self._is_visible(pose)
        )

    def _is_visible(self, pose: Pose) -> bool:
        line = shapely.LineString([_in_front(pose, 0.05), _in_front(pose, _IN_FRONT_M)])
        return bool(self._furniture.distance(line) >= _CLEARANCE_M)


def _along(begin: tuple[float, float], end: tuple[float, float]) -> Iterator[Pose]:
    """Yield poses along a wall, facing away from it on either side."""
    along = math.atan2(end[1] - begin[1], end[0] - begin[0])
    length = math.dist(begin, end)
    for distance in np.arange(_FROM_CORNERS_M, length - _FROM_CORNERS_M, _SPACING_M).tolist():
        x = begin[0] + distance * math.cos(along)
        y = begin[1] + distance * math.sin(along)
        for side in (math.pi / 2, -math.pi / 2):
            theta = math.remainder(along + side, math.tau)
            yield round(x, 3), round(y, 3), round(theta, 4)


def _in_front(pose: Pose, meters: float) -> tuple[float, float]:
    return compose(pose, (meters, 0.0, 0.0))[:2]


def _fits(
    pose: Pose, thing: VisibleObject, distance: float | None, taken: Sequence[tuple[str, Pose]]
) -> bool:
    """Return whether an object can be moved to a pose.

    `taken` are the poses of all objects by name, and the new poses of moved ones (name "").
    """
    moved = math.dist(pose[:2], (thing.x, thing.y))
    if distance is None:
        far_enough = moved >= LEAST_MOVE_M
    else:
        far_enough = abs(moved - distance) <= _DISTANCE_TOLERANCE_M
    return far_enough and all(
        math.dist(pose[:2], other[:2]) >= APART_M
        for name, other in taken
        if name != thing.display_name
    )
