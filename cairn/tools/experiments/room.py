"""What may be moved where in a world, drawn at random; it is read before any run."""

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

# Places along the walls are looked at every so many meters, so far from corners.
_EVERY_M, _FROM_CORNERS_M = 0.05, 0.25
# An object needs so much free space before it, or nobody could see it [m].
_BEFORE_M, _ROOM_M = 0.6, 0.15
# Objects hang no nearer to each other than this [m]; nearer than the localizer's 0.35 m they are
# taken for one another.
APART_M = 0.35
# Without a distance asked for, objects are moved at least so far [m].
LEAST_MOVE_M = 0.6
# How far [m] a move may be from the distance asked for.
_NEAR_ENOUGH_M = 0.03


class Room:
    """A world as it stands at the beginning."""

    def __init__(self, world_file: Path) -> None:
        """`CairnError` if there is no such world, or it is wrong."""
        self._file = world_file
        world = read_world(world_file)
        self._scene = WorldLayout.of(world)
        self._start = world.robot.pose
        furniture = [self._scene.shapes[name] for name in self._scene.furniture]
        self._furniture = shapely.union_all(furniture)

    def moves(
        self, count: int, distance: float | None, at: float, random: np.random.Generator
    ) -> list[dict[str, Any]]:
        """`count` objects put elsewhere along the walls at `at` [s], as events of a world.

        `distance` [m] away, or at least 0.6 m if None. `CairnError` if there is no room for that
        many.
        """
        objects = self._scene.objects
        taken = [(name, thing.pose) for name, thing in objects.items()]
        events: list[dict[str, Any]] = []
        for name in random.permutation(sorted(objects)).tolist():
            if len(events) == count:
                break
            thing = objects[name]
            free = [place for place in self._places if _fits(place, thing, distance, taken)]
            if not free:
                continue
            x, y, theta = free[int(random.integers(len(free)))]
            taken.append(("", (x, y, theta)))
            events.append({"at": at, "move": name, "to": {"x": x, "y": y, "theta": theta}})
        if len(events) < count:
            how = "" if distance is None else f" by {distance:g} m"
            raise CairnError(
                f"{self._file}: of {len(objects)} objects only {len(events)} can be "
                f"moved{how} "
                f"along the walls, not {count}; ask for fewer with --moved, or for another "
                "--move-distance"
            )
        return events

    def somewhere(self, room: float, random: np.random.Generator) -> Pose:
        """A place that the robot could drive to, with `room` [m] around it.

        `CairnError` if there is none.
        """
        shapes = list(self._scene.shapes.values())
        space = shapely.box(*shapely.union_all(shapes).bounds)
        parts = shapely.get_parts(space.difference(shapely.union_all(shapes).buffer(room)))
        here = shapely.Point(self._start[:2])
        reached = min(parts, key=lambda part: part.distance(here), default=None)
        if reached is None:
            raise CairnError(f"{self._file}: there is no place to carry the robot to")
        left, bottom, right, top = reached.bounds
        while True:
            x, y = float(random.uniform(left, right)), float(random.uniform(bottom, top))
            if reached.contains(shapely.Point(x, y)):
                return x, y, float(random.uniform(-math.pi, math.pi))

    @cached_property
    def _places(self) -> tuple[Pose, ...]:
        """Where an object could hang and be seen: along the walls, facing inwards."""
        outside = self._scene.outside_of(0.01)
        return tuple(
            place
            for wall in self._scene.walls
            for begin, end in pairwise(wall.points)
            for place in _along(begin, end)
            if not outside(*_before(place, _BEFORE_M)) and self._has_room_before(place)
        )

    def _has_room_before(self, place: Pose) -> bool:
        view = shapely.LineString([_before(place, 0.05), _before(place, _BEFORE_M)])
        return bool(self._furniture.distance(view) >= _ROOM_M)


def _along(begin: tuple[float, float], end: tuple[float, float]) -> Iterator[Pose]:
    """Places on a wall, facing away from it to either side."""
    along = math.atan2(end[1] - begin[1], end[0] - begin[0])
    for reach in np.arange(_FROM_CORNERS_M, math.dist(begin, end) - _FROM_CORNERS_M, _EVERY_M):
        x = begin[0] + float(reach) * math.cos(along)
        y = begin[1] + float(reach) * math.sin(along)
        for side in (math.pi / 2, -math.pi / 2):
            theta = math.remainder(along + side, math.tau)
            yield round(x, 3), round(y, 3), round(theta, 4)


def _before(place: Pose, meters: float) -> tuple[float, float]:
    return compose(place, (meters, 0.0, 0.0))[:2]


def _fits(
    place: Pose, thing: VisibleObject, distance: float | None, taken: Sequence[tuple[str, Pose]]
) -> bool:
    """Whether a thing can be put there; `taken` is where all hang, by name, or are put ("")."""
    way = math.dist(place[:2], (thing.x, thing.y))
    far_enough = way >= LEAST_MOVE_M if distance is None else abs(way - distance) <= _NEAR_ENOUGH_M
    return far_enough and all(
        math.dist(place[:2], other[:2]) >= APART_M
        for name, other in taken
        if name != thing.display_name
    )
