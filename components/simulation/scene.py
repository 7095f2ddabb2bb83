"""What stands in the world: walls, furniture and objects, and where there is room."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from cairn import CairnError
from cairn.components.simulation.world_file import (
    Furniture,
    Surface,
    VisibleObject,
    Wall,
    WorldFile,
)
from cairn.planar.poses import Pose, compose

SURFACES: dict[Surface, int] = {"plain": 0, "dark": 1, "glass": 2}
# Things that overlap by less than this [m] touch each other.
TOUCH_M = 0.02
# Less room than this [m^2] between furniture and walls is no place within the walls.
_ROOM_M2 = 0.01


@dataclass(frozen=True)
class Standing:
    """What stops beams: segments (m, 4) x1, y1, x2, y2 [m], their surfaces and names (m,).

    `heights` (m,) [m] are 0 where a camera sees no side but an object's picture. Those of one piece
    of furniture have its number from 1 on in `solids` (m,), all others 0.
    """

    segments: NDArray[np.float64]
    surfaces: NDArray[np.uint8]
    names: tuple[str, ...]
    heights: NDArray[np.float64]
    solids: NDArray[np.uint32]


@dataclass(frozen=True)
class Scene:
    """What stands, by name. `version` goes up with every change; a change gives a new scene."""

    walls: tuple[Wall, ...]
    furniture: Mapping[str, Furniture]
    objects: Mapping[str, VisibleObject]
    version: int = 0

    @staticmethod
    def of(world: WorldFile) -> Scene:
        """The scene at the beginning."""
        return Scene(
            tuple(world.walls),
            {one.name: one for one in world.furniture},
            {one.called: one for one in world.objects},
        )

    @property
    def names(self) -> list[str]:
        """Of all that can be moved."""
        return [*self.furniture, *self.objects]

    def pose_of(self, name: str) -> Pose:
        """Where a thing stands; `CairnError` if there is no such thing."""
        return self._thing(name).pose

    def moved(self, poses: Mapping[str, Pose]) -> Scene:
        """With furniture and objects put elsewhere, all at once.

        `CairnError` if there is no such thing, or it would overlap another or be outside.
        """
        new = self
        for name, (x, y, theta) in poses.items():
            thing = self._thing(name)
            new = new._with(thing.model_copy(update={"x": x, "y": y, "theta": theta}))
        for name in poses:
            new.refuse_overlaps(name)
            new.refuse_outside(name)
        return new

    def without(self, name: str) -> Scene:
        """With a piece of furniture or an object taken away; `CairnError` if it is not there."""
        self._thing(name)
        return replace(
            self,
            furniture={key: one for key, one in self.furniture.items() if key != name},
            objects={key: one for key, one in self.objects.items() if key != name},
            version=self.version + 1,
        )

    def joined(self, thing: Furniture | VisibleObject) -> Scene:
        """With something new; `CairnError` if its name or id is taken, or it cannot be there."""
        if isinstance(thing, VisibleObject):
            twins = [name for name, one in self.objects.items() if one.id == thing.id]
            if twins:
                raise CairnError(f"{twins[0]} has the id {thing.id} already; give another id")
        if thing.called in self.names:
            raise CairnError(f"there is a {thing.called} already; give another name")
        new = self._with(thing)
        new.refuse_overlaps(thing.called)
        new.refuse_outside(thing.called)
        return new

    def refuse_overlaps(self, name: str, but: Collection[str] = ()) -> None:
        """`CairnError` if a piece of furniture overlaps a wall or another one that is not in `but`.

        Also if its outline is none.
        """
        shape = self.shapes.get(name)
        if name not in self.furniture or shape is None:
            return
        if not shape.is_valid or shape.area <= 0:
            raise CairnError(f"the outline of {name} crosses itself or is empty; mend it")
        core = shape.buffer(-_shrink(shape))
        for other, its_shape in self.shapes.items():
            if other == name or other in but or other in self.objects:
                continue
            rest = its_shape
            if other in self.furniture:
                rest = its_shape.buffer(-_shrink(its_shape))
            common = core.intersection(rest)
            if not common.is_empty:
                where = common.centroid
                raise CairnError(
                    f"{name} overlaps {other} at ({where.x:.2f}, {where.y:.2f}); move one of them"
                )

    def refuse_outside(self, name: str) -> None:
        """`CairnError` if a piece of furniture stands wholly outside of the walls."""
        piece, shape = self.furniture.get(name), self.shapes.get(name)
        if piece is None or shape is None:
            return
        around = self._around(0.0)
        others = [its_shape for other, its_shape in self.shapes.items() if other != name]
        without = _beyond(others, around, 0.0)
        if not without.covers(shape.representative_point()):
            return
        # What closes a gap in the walls, as a door does, stands neither outside nor inside.
        behind = without.difference(_beyond(list(self.shapes.values()), around, 0.0))
        if behind.difference(shape.buffer(2 * TOUCH_M)).area < _ROOM_M2:
            raise CairnError(
                f"{name} cannot be at ({piece.x:.2f}, {piece.y:.2f}): that is outside of the "
                "walls, or they leave a gap; choose a place within, or close them"
            )

    @cached_property
    def standing(self) -> Standing:
        """All that stops beams."""
        rows: list[tuple[float, float, float, float]] = []
        surfaces: list[int] = []
        names: list[str] = []
        heights: list[float] = []
        solids: list[int] = []

        def line(
            points: list[tuple[float, float]],
            surface: Surface,
            name: str,
            height: float = 0.0,
            solid: int = 0,
        ) -> None:
            for begin, end in pairwise(points):
                rows.append((*begin, *end))
                surfaces.append(SURFACES[surface])
                names.append(name)
                heights.append(height)
                solids.append(solid)

        for number, wall in enumerate(self.walls, start=1):
            line(wall.points, wall.surface, f"wall {number}", wall.height)
        for number, one in enumerate(self.furniture.values(), start=1):
            corners = corners_of(one)
            line([*corners, corners[0]], one.surface, one.name, one.height, number)
        for thing in self.objects.values():
            if thing.solid:
                line(_ends_of(thing), "plain", thing.called)
        segments = np.array(rows, np.float64).reshape(-1, 4)
        return Standing(
            segments,
            np.array(surfaces, np.uint8),
            tuple(names),
            np.array(heights),
            np.array(solids, np.uint32),
        )

    @cached_property
    def shapes(self) -> dict[str, BaseGeometry]:
        """What takes room, by name: walls and panels as lines, furniture as polygons."""
        shapes: dict[str, BaseGeometry] = {}
        for number, wall in enumerate(self.walls, start=1):
            shapes[f"wall {number}"] = shapely.LineString(wall.points)
        for name, piece in self.furniture.items():
            shapes[name] = shapely.Polygon(corners_of(piece))
        for name, thing in self.objects.items():
            if thing.solid:
                shapes[name] = shapely.LineString(_ends_of(thing))
        return shapes

    def refuse_place(self, what: str, x: float, y: float, radius: float) -> None:
        """`CairnError` if something stands within `radius` [m] of a place, or it is outside."""
        spot = shapely.Point(x, y)
        name, room = min(
            ((name, shape.distance(spot)) for name, shape in self.shapes.items()),
            key=lambda found: found[1],
        )
        if room < radius:
            raise CairnError(
                f"{what} cannot be at ({x:.2f}, {y:.2f}): {name} is {room:.2f} m from there, and "
                f"it takes {radius:g} m; choose another place"
            )
        if self.outside(x, y, radius):
            raise CairnError(
                f"{what} cannot be at ({x:.2f}, {y:.2f}): that is outside of the walls, or they "
                "leave a gap; choose a place within, or close them"
            )

    def outside(self, x: float, y: float, radius: float) -> bool:
        """Whether something of that radius [m] could go from there to beyond the walls."""
        return self.outside_of(radius)(x, y)

    def outside_of(self, radius: float) -> Callable[[float, float], bool]:
        """The same for many places, because to find out what is beyond takes long."""
        around = self._around(radius)
        beyond = _beyond(list(self.shapes.values()), around, radius)
        shapely.prepare(beyond)

        def outside(x: float, y: float) -> bool:
            spot = shapely.Point(x, y)
            return bool(beyond.covers(spot) or not around.covers(spot))

        return outside

    def _around(self, radius: float) -> shapely.Polygon:
        """A rectangle around all, with room outside for something of that radius [m]."""
        return shapely.box(
            *shapely.union_all(list(self.shapes.values())).buffer(2 * radius + 1).bounds
        )

    def _with(self, thing: Furniture | VisibleObject) -> Scene:
        version = self.version + 1
        if isinstance(thing, Furniture):
            furniture = {**self.furniture, thing.called: thing}
            return replace(self, furniture=furniture, version=version)
        return replace(self, objects={**self.objects, thing.called: thing}, version=version)

    def _thing(self, name: str) -> Furniture | VisibleObject:
        thing = self.furniture.get(name) or self.objects.get(name)
        if thing is None:
            raise unknown(name, self.names)
        return thing


def _beyond(shapes: list[BaseGeometry], around: shapely.Polygon, radius: float) -> BaseGeometry:
    """Where something of that radius [m] could be, coming from beyond all shapes."""
    # Lines part the plane only with some width.
    solid = shapely.union_all(shapes).buffer(max(radius, 0.01))
    corner = shapely.Point(around.bounds[:2])
    parts: list[BaseGeometry] = list(shapely.get_parts(around.difference(solid)))
    return next(part for part in parts if part.covers(corner))


def _shrink(shape: BaseGeometry) -> float:
    """By how much [m] to shrink a piece of furniture, so that what only touches it does not overlap
    it: half of what counts as a touch, and less of what is thin.
    """
    return float(min(TOUCH_M / 2, 0.4 * shapely.minimum_clearance(shape)))


def unknown(name: str, known: list[str]) -> CairnError:
    """The error for a thing that is not there."""
    return CairnError(f"there is no {name}; there are {', '.join(sorted(known)) or 'none'}")


def corners_of(one: Furniture) -> list[tuple[float, float]]:
    """The corners [m] of a piece of furniture in the world."""
    return [compose(one.pose, (x, y, 0.0))[:2] for x, y in one.corners]


def _ends_of(panel: VisibleObject) -> list[tuple[float, float]]:
    half = panel.width / 2
    return [compose(panel.pose, (0.0, side, 0.0))[:2] for side in (half, -half)]
