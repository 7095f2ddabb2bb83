"""The layout of a world: walls, furniture and objects, and the free space between them."""

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
from cairn.deployment.problems import suggestion
from cairn.planar.messages import packed_poses
from cairn.planar.poses import Pose, compose
from cairn.schemas import cairn_sim_msgs
from cairn.schemas.cairn_msgs import VisualMap, VisualObject
from cairn.schemas.std_msgs import Header

SURFACES: dict[Surface, int] = {"plain": 0, "dark": 1, "glass": 2}
# Things that overlap by less than this [m] only touch: coordinates in world files are rounded.
TOUCH_M = 0.02
# A thing this near in front of an object's center does not hide it: the object hangs on it [m].
BEHIND_M = 0.1
# A gap between furniture and walls with less area [m^2] than this does not count as inside.
_ROOM_M2 = 0.01


@dataclass(frozen=True)
class SolidSegments:
    """All that stops beams: segments (m, 4) x1, y1, x2, y2 [m], their surfaces and names (m,).

    `heights` (m,) [m] are 0 for objects, of which a camera sees the picture and no sides. `solids`
    (m,) numbers the pieces of furniture from 1 on; it is 0 for all other segments.
    """

    segments: NDArray[np.float64]
    surfaces: NDArray[np.uint8]
    names: tuple[str, ...]
    heights: NDArray[np.float64]
    solids: NDArray[np.uint32]


@dataclass(frozen=True)
class WorldLayout:
    """Walls, furniture and objects by name; `version` increases with each change.

    The layout is immutable: a change returns a new one.
    """

    walls: tuple[Wall, ...]
    furniture: Mapping[str, Furniture]
    objects: Mapping[str, VisibleObject]
    version: int = 0

    @staticmethod
    def of(world: WorldFile) -> WorldLayout:
        """Return the layout at the start of a world."""
        return WorldLayout(
            tuple(world.walls),
            {one.name: one for one in world.furniture},
            {one.display_name: one for one in world.objects},
        )

    @property
    def names(self) -> list[str]:
        """Return the names of all that can be moved."""
        return [*self.furniture, *self.objects]

    def pose_of(self, name: str) -> Pose:
        """Return the pose of a thing; raise `CairnError` if it does not exist."""
        return self._thing(name).pose

    def with_moved(self, poses: Mapping[str, Pose]) -> WorldLayout:
        """Return a layout with furniture and objects moved, all at once.

        Raises `CairnError` if a thing does not exist, would overlap another or would be outside.
        """
        new = self
        for name, (x, y, theta) in poses.items():
            thing = self._thing(name)
            new = new._with(thing.model_copy(update={"x": x, "y": y, "theta": theta}))
        for name in poses:
            new.require_no_overlap(name)
            new.require_inside(name)
        return new

    def without(self, name: str) -> WorldLayout:
        """Return a layout without a thing; raise `CairnError` if it does not exist."""
        self._thing(name)
        return replace(
            self,
            furniture={key: one for key, one in self.furniture.items() if key != name},
            objects={key: one for key, one in self.objects.items() if key != name},
            version=self.version + 1,
        )

    def with_added(self, thing: Furniture | VisibleObject) -> WorldLayout:
        """Return a layout with a new thing.

        Raises `CairnError` if its name or id is taken or its pose is not possible.
        """
        if isinstance(thing, VisibleObject):
            same_id = [name for name, one in self.objects.items() if one.id == thing.id]
            if same_id:
                raise CairnError(f"{same_id[0]} already has the id {thing.id}; choose another id")
            if len(self.objects) >= cairn_sim_msgs.MOST_OBJECTS:
                raise CairnError(
                    f"{thing.display_name} cannot be added: there are {len(self.objects)} objects, "
                    "the most that a world may have; remove one first"
                )
        if thing.display_name in self.names:
            raise CairnError(f"{thing.display_name} exists already; choose another name")
        new = self._with(thing)
        new.require_no_overlap(thing.display_name)
        new.require_inside(thing.display_name)
        return new

    def require_no_overlap(self, name: str, except_for: Collection[str] = ()) -> None:
        """Raise `CairnError` if furniture overlaps a wall or other furniture.

        Furniture in `except_for` does not count. Also if its outline is not a simple polygon.
        """
        shape = self.shapes.get(name)
        if name not in self.furniture or shape is None:
            return
        if not shape.is_valid or shape.area <= 0:
            raise CairnError(
                f"the outline of {name} crosses itself or is empty; correct the order of its "
                "corners"
            )
        core = shape.buffer(-_shrink(shape))
        for other, its_shape in self.shapes.items():
            if other == name or other in except_for or other in self.objects:
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

    def require_inside(self, name: str) -> None:
        """Raise `CairnError` if a piece of furniture is completely outside the walls."""
        piece, shape = self.furniture.get(name), self.shapes.get(name)
        if piece is None or shape is None:
            return
        around = self._around(0.0)
        others = [its_shape for other, its_shape in self.shapes.items() if other != name]
        without = _beyond(others, around, 0.0)
        if not without.covers(shape.representative_point()):
            return
        # Furniture that closes a gap in the walls, like a door, is neither outside nor inside.
        behind = without.difference(_beyond(list(self.shapes.values()), around, 0.0))
        if behind.difference(shape.buffer(2 * TOUCH_M)).area < _ROOM_M2:
            raise CairnError(
                f"{name} cannot be at ({piece.x:.2f}, {piece.y:.2f}): the position is outside the "
                "walls, or they leave a gap; choose a position inside, or close the gap"
            )

    @cached_property
    def solid_segments(self) -> SolidSegments:
        """Return all that stops beams."""
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
                line(_ends_of(thing), "plain", thing.display_name)
        segments = np.array(rows, np.float64).reshape(-1, 4)
        return SolidSegments(
            segments,
            np.array(surfaces, np.uint8),
            tuple(names),
            np.array(heights),
            np.array(solids, np.uint32),
        )

    @cached_property
    def shapes(self) -> dict[str, BaseGeometry]:
        """Return the occupied shapes by name: walls and panels as lines, furniture as polygons."""
        shapes: dict[str, BaseGeometry] = {}
        for number, wall in enumerate(self.walls, start=1):
            shapes[f"wall {number}"] = shapely.LineString(wall.points)
        for name, piece in self.furniture.items():
            shapes[name] = shapely.Polygon(corners_of(piece))
        for name, thing in self.objects.items():
            if thing.solid:
                shapes[name] = shapely.LineString(_ends_of(thing))
        return shapes

    def require_room(self, what: str, x: float, y: float, radius: float) -> None:
        """Raise `CairnError` if a position is outside or something is within `radius` [m]."""
        spot = shapely.Point(x, y)
        name, room = min(
            ((name, shape.distance(spot)) for name, shape in self.shapes.items()),
            key=lambda found: found[1],
        )
        if room < radius:
            raise CairnError(
                f"{what} cannot be at ({x:.2f}, {y:.2f}): {name} is {room:.2f} m from there, and "
                f"it needs {radius:g} m; choose another position"
            )
        if self.outside(x, y, radius):
            raise CairnError(
                f"{what} cannot be at ({x:.2f}, {y:.2f}): the position is outside the walls, or "
                "they leave a gap; choose a position inside, or close the gap"
            )

    def outside(self, x: float, y: float, radius: float) -> bool:
        """Return whether a disc of that radius [m] could move from there to beyond the walls."""
        return self.outside_of(radius)(x, y)

    def outside_of(self, radius: float) -> Callable[[float, float], bool]:
        """Return the same test for many positions; the area beyond the walls is computed once."""
        around = self._around(radius)
        beyond = _beyond(list(self.shapes.values()), around, radius)
        shapely.prepare(beyond)

        def outside(x: float, y: float) -> bool:
            spot = shapely.Point(x, y)
            return bool(beyond.covers(spot) or not around.covers(spot))

        return outside

    def _around(self, radius: float) -> shapely.Polygon:
        """Return a rectangle around everything, with space for a disc of that radius [m]."""
        return shapely.box(
            *shapely.union_all(list(self.shapes.values())).buffer(2 * radius + 1).bounds
        )

    def _with(self, thing: Furniture | VisibleObject) -> WorldLayout:
        version = self.version + 1
        if isinstance(thing, Furniture):
            furniture = {**self.furniture, thing.display_name: thing}
            return replace(self, furniture=furniture, version=version)
        return replace(self, objects={**self.objects, thing.display_name: thing}, version=version)

    def _thing(self, name: str) -> Furniture | VisibleObject:
        thing = self.furniture.get(name) or self.objects.get(name)
        if thing is None:
            raise unknown_name(name, self.names)
        return thing


def _beyond(shapes: list[BaseGeometry], around: shapely.Polygon, radius: float) -> BaseGeometry:
    """Return the area that a disc of that radius [m] can reach from beyond all shapes."""
    # A line separates the plane only if it has some width.
    solid = shapely.union_all(shapes).buffer(max(radius, 0.01))
    corner = shapely.Point(around.bounds[:2])
    parts: list[BaseGeometry] = list(shapely.get_parts(around.difference(solid)))
    return next(part for part in parts if part.covers(corner))


def _shrink(shape: BaseGeometry) -> float:
    """Return by how much [m] to shrink furniture so that touching does not count as overlapping.

    It is half the tolerance, and less for thin furniture.
    """
    return float(min(TOUCH_M / 2, 0.4 * shapely.minimum_clearance(shape)))


def unknown_name(name: str, known: list[str]) -> CairnError:
    """Return the error for a name that does not exist."""
    return CairnError(f"{name} does not exist; {suggestion(name, sorted(known))}")


def corners_of(one: Furniture) -> list[tuple[float, float]]:
    """Return the corners [m] of a piece of furniture in the world frame."""
    return [compose(one.pose, (x, y, 0.0))[:2] for x, y in one.corners]


def _ends_of(panel: VisibleObject) -> list[tuple[float, float]]:
    half = panel.width / 2
    return [compose(panel.pose, (0.0, side, 0.0))[:2] for side in (half, -half)]


def geometry_message(header: Header, layout: WorldLayout) -> cairn_sim_msgs.WorldGeometry:
    """Return the layout as the message for the sensor drivers."""
    things = list(layout.objects.values())
    poses = np.array([thing.pose for thing in things], np.float64).reshape(-1, 3)
    sizes = np.array([thing.size for thing in things], np.float64).reshape(-1, 2)
    solid = layout.solid_segments
    return cairn_sim_msgs.WorldGeometry(
        header=header,
        segments=solid.segments.ravel(),
        surfaces=solid.surfaces,
        heights=solid.heights,
        solids=solid.solids,
        object_ids=np.array([thing.id for thing in things], np.uint32),
        object_names=tuple(thing.display_name for thing in things),
        object_poses=packed_poses(poses),
        object_sizes=sizes.ravel(),
        object_zs=np.array([thing.z for thing in things], np.float64),
        object_textures=tuple(str(thing.texture or "") for thing in things),
    )


def true_map(header: Header, layout: WorldLayout) -> VisualMap:
    """Return the layout as the true visual map."""
    return VisualMap(
        header=header,
        version=layout.version,
        objects=tuple(
            VisualObject(object_id=thing.id, name=thing.display_name, x=thing.x, y=thing.y)
            for thing in layout.objects.values()
        ),
    )
