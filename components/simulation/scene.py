"""What stands in the world: walls, furniture and objects, and how they are moved about."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from cairn.errors import CairnError
from components.simulation.world_file import Furniture, Surface, VisibleObject, Wall, WorldFile
from planar.poses import Pose, compose

SURFACES: dict[Surface, int] = {"plain": 0, "dark": 1, "glass": 2}
# Things that overlap by less than this [m] touch each other.
_TOUCH_M = 0.02


@dataclass
class Scene:
    """What stands, by name. `version` goes up with every change."""

    walls: list[Wall]
    furniture: dict[str, Furniture]
    objects: dict[str, VisibleObject]
    version: int = 0
    _names: list[str] = field(default_factory=list)

    @staticmethod
    def of(world: WorldFile) -> Scene:
        """The scene at the beginning."""
        return Scene(
            list(world.walls),
            {one.name: one for one in world.furniture},
            {one.called: one for one in world.objects},
        )

    def move(self, name: str, pose: Pose) -> None:
        """Put furniture or an object somewhere else; `CairnError` if there is no such thing."""
        x, y, theta = pose
        new = {"x": x, "y": y, "theta": theta}
        if name in self.furniture:
            self.furniture[name] = self.furniture[name].model_copy(update=new)
        elif name in self.objects:
            self.objects[name] = self.objects[name].model_copy(update=new)
        else:
            raise unknown(name, [*self.furniture, *self.objects])
        self.version += 1

    def remove(self, name: str) -> None:
        """Take furniture or an object away; `CairnError` if there is no such thing."""
        if name in self.furniture:
            del self.furniture[name]
        elif name in self.objects:
            del self.objects[name]
        else:
            raise unknown(name, [*self.furniture, *self.objects])
        self.version += 1

    def add(self, thing: Furniture | VisibleObject) -> None:
        """Put something new there; `CairnError` if its name, or its number, is taken."""
        name = thing.name if isinstance(thing, Furniture) else thing.called
        if name in self.furniture or name in self.objects:
            raise CairnError(f"there is a {name} already; give another name")
        if isinstance(thing, Furniture):
            self.furniture[name] = thing
        else:
            if any(one.id == thing.id for one in self.objects.values()):
                raise CairnError(f"there is an object {thing.id} already; give another id")
            self.objects[name] = thing
        self.version += 1

    def pose_of(self, name: str) -> Pose:
        """Where a thing stands; `CairnError` if there is no such thing."""
        thing = self.furniture.get(name) or self.objects.get(name)
        if thing is None:
            raise unknown(name, [*self.furniture, *self.objects])
        return thing.pose

    def segments(self) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """All that stops beams: segments (m, 4) x1, y1, x2, y2 [m] and their surfaces (m,)."""
        rows: list[tuple[float, float, float, float]] = []
        surfaces: list[int] = []
        names: list[str] = []
        for number, wall in enumerate(self.walls, start=1):
            for begin, end in zip(wall.points, wall.points[1:], strict=False):
                rows.append((*begin, *end))
                surfaces.append(SURFACES[wall.surface])
                names.append(f"wall {number}")
        for one in self.furniture.values():
            corners = corners_of(one)
            for begin, end in zip(corners, [*corners[1:], corners[0]], strict=True):
                rows.append((*begin, *end))
                surfaces.append(SURFACES[one.surface])
                names.append(one.name)
        for thing in self.objects.values():
            if thing.solid:
                half = thing.width / 2
                left, right = compose(thing.pose, (0, half, 0)), compose(thing.pose, (0, -half, 0))
                rows.append((left[0], left[1], right[0], right[1]))
                surfaces.append(SURFACES["plain"])
                names.append(thing.called)
        self._names = names
        return np.array(rows, np.float64).reshape(-1, 4), np.array(surfaces, np.uint8)

    def name_of_segment(self, number: int) -> str:
        """What a segment of the last `segments()` belongs to."""
        return self._names[number]


def unknown(name: str, known: list[str]) -> CairnError:
    """The error for a thing that is not there."""
    return CairnError(f"there is no {name}; there are {', '.join(sorted(known)) or 'none'}")


def corners_of(one: Furniture) -> list[tuple[float, float]]:
    """The corners [m] of a piece of furniture in the world."""
    return [compose(one.pose, (x, y, 0.0))[:2] for x, y in one.corners]


def problems_of(scene: Scene, robot: Pose, radius: float) -> list[str]:
    """What cannot be in a world, each as a sentence: things that overlap, a robot inside one."""
    problems = []
    shapes = {}
    for one in scene.furniture.values():
        shape = shapely.Polygon(corners_of(one))
        if not shape.is_valid or shape.area <= 0:
            problems.append(f"the outline of {one.name} crosses itself or is empty")
        else:
            shapes[one.name] = shape
    names = list(shapes)
    for i, name in enumerate(names):
        for other in names[i + 1 :]:
            problems += _overlap(shapes[name], shapes[other], name, other)
        for number, wall in enumerate(scene.walls, start=1):
            line = shapely.LineString(wall.points)
            problems += _overlap(shapes[name], line, name, f"wall {number}")
    problems += _double_walls(scene.walls)
    spot = shapely.Point(robot[0], robot[1])
    for name, shape in shapes.items():
        if shape.distance(spot) < radius:
            problems.append(f"the robot begins at ({robot[0]:g}, {robot[1]:g}) inside {name}")
    for number, wall in enumerate(scene.walls, start=1):
        if shapely.LineString(wall.points).distance(spot) < radius:
            problems.append(f"the robot begins at ({robot[0]:g}, {robot[1]:g}) in wall {number}")
    if not all(math.isfinite(value) for value in robot):
        problems.append("the robot's pose must be finite")
    return problems


def _overlap(one: BaseGeometry, other: BaseGeometry, name: str, other_name: str) -> list[str]:
    common = one.buffer(-_TOUCH_M).intersection(
        other.buffer(-_TOUCH_M) if other.geom_type == "Polygon" else other
    )
    if common.is_empty:
        return []
    where = common.centroid
    return [f"{name} overlaps {other_name} at ({where.x:.2f}, {where.y:.2f}); move one of them"]


def _double_walls(walls: list[Wall]) -> list[str]:
    """Walls that lie on one another for more than a touch."""
    pieces = [
        (number, shapely.LineString([begin, end]))
        for number, wall in enumerate(walls, start=1)
        for begin, end in zip(wall.points, wall.points[1:], strict=False)
    ]
    problems = []
    for i, (number, piece) in enumerate(pieces):
        if piece.length == 0:
            problems.append(f"wall {number} has two equal points one after the other")
            continue
        for other_number, other in pieces[i + 1 :]:
            common = piece.intersection(other)
            if common.length > _TOUCH_M:
                where = common.centroid
                problems.append(
                    f"wall {number} and wall {other_number} lie on one another at "
                    f"({where.x:.2f}, {where.y:.2f}); leave one out"
                )
    return problems
