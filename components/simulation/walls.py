"""What is wrong with walls: doubled ones, knots, gaps; and what they cut off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from cairn.components.simulation.scene import TOUCH_M, Scene
from cairn.components.simulation.world_file import Wall
from cairn.planar.poses import Pose

# Walls that run beside one another for less than this [m] only meet at a small angle.
_BESIDE_M = 0.25
# Of bridges between loose ends, the shortest so many are looked at.
_BRIDGES = 60
# What cannot be reached is told from this much room for the robot's middle on [m^2].
_ROOM_M2 = 0.1


def wall_problems(walls: Sequence[Wall]) -> list[str]:
    """Walls with a point twice, or that cross themselves or lie on or closely beside others."""
    pieces = [
        (number, index, shapely.LineString(pair))
        for number, wall in enumerate(walls, start=1)
        for index, pair in enumerate(pairwise(wall.points))
    ]
    problems = [
        f"wall {number} has the point ({piece.coords[0][0]:g}, {piece.coords[0][1]:g}) twice in a "
        "row; leave one out"
        for number, _, piece in pieces
        if piece.length == 0
    ]
    tree = shapely.STRtree([piece for _, _, piece in pieces])
    for at, (number, index, piece) in enumerate(pieces):
        for other_at in sorted(int(k) for k in tree.query(piece.buffer(TOUCH_M)) if k > at):
            other_number, other_index, other = pieces[other_at]
            problems += _together(f"wall {number}", piece, f"wall {other_number}", other)
            if number == other_number and other_index > index + 1:
                problems += _crossing(f"wall {number}", piece, other)
    return problems


@dataclass(frozen=True)
class Gap:
    """Where walls do not meet: from one place to another [m]."""

    begin: tuple[float, float]
    end: tuple[float, float]

    def __str__(self) -> str:
        (x, y), (to_x, to_y) = self.begin, self.end
        meters = shapely.Point(self.begin).distance(shapely.Point(self.end))
        return f"of {meters:.2f} m from ({x:.2f}, {y:.2f}) to ({to_x:.2f}, {to_y:.2f})"


def gaps_around(scene: Scene, place: Pose, radius: float) -> list[Gap]:
    """The gaps through which something of that radius [m] gets from a place to beyond the walls.

    None if no bridges between loose ends of walls would keep it in. Of gaps that do alike, that is
    told which leaves the most room within: so it is the gap of the outer wall, not a door.
    """
    width = max(radius, 0.01)
    solid = shapely.union_all(list(scene.shapes.values()))
    around = shapely.box(*solid.buffer(2.0 * width + 1.0).bounds)
    free = around.difference(solid.buffer(width))
    spot, corner = shapely.Point(place[0], place[1]), shapely.Point(around.bounds[:2])

    def room(bridges: Sequence[shapely.LineString]) -> float:
        """How much is around the place if there were bridges [m^2]; 0 if it still is open."""
        parts = shapely.get_parts(free.difference(shapely.union_all(bridges).buffer(width)))
        own = [part for part in parts if part.covers(spot) and not part.covers(corner)]
        return float(sum(part.area for part in own))

    bridges = [bridge for bridge in _bridges(scene) if bridge.distance(spot) >= width]
    best = max(bridges, key=lambda bridge: room([bridge]), default=None)
    if best is not None and room([best]) > 0:
        return [_gap(best)]
    if not bridges or room(bridges) == 0:
        return []
    needed = bridges
    for bridge in reversed(bridges):  # the longest first
        rest = [one for one in needed if one is not bridge]
        if room(rest) > 0:
            needed = rest
    return [_gap(bridge) for bridge in needed]


@dataclass(frozen=True)
class CutOff:
    """A part of the world that the robot cannot get to: its size [m^2], a place in it [m]."""

    area: float
    x: float
    y: float


def cut_off(scene: Scene, place: Pose, radius: float) -> list[CutOff]:
    """Where a robot of that radius [m] could be, but cannot get to from a place."""
    solid = shapely.union_all(list(scene.shapes.values()))
    around = shapely.box(*solid.buffer(2.0 * radius + 1.0).bounds)
    spot, corner = shapely.Point(place[0], place[1]), shapely.Point(around.bounds[:2])
    found = []
    for part in shapely.get_parts(around.difference(solid.buffer(radius))):
        if part.area >= _ROOM_M2 and not part.covers(spot) and not part.covers(corner):
            within = part.representative_point()
            found.append(CutOff(part.buffer(radius).area, within.x, within.y))
    return found


def _together(
    name: str, piece: shapely.LineString, other_name: str, other: shapely.LineString
) -> list[str]:
    common = piece.intersection(other)
    if common.length > TOUCH_M:
        where = common.centroid
        return [
            f"{name} and {other_name} lie on one another at ({where.x:.2f}, {where.y:.2f}); leave "
            "one out"
        ]
    beside = other.intersection(piece.buffer(TOUCH_M, cap_style="flat"))
    if beside.length > _BESIDE_M:
        where = beside.centroid
        return [
            f"{other_name} runs less than {TOUCH_M:g} m beside {name} at ({where.x:.2f}, "
            f"{where.y:.2f}); leave one out, or move them apart"
        ]
    return []


def _crossing(name: str, piece: shapely.LineString, other: shapely.LineString) -> list[str]:
    where = piece.intersection(other)
    ends = shapely.MultiPoint([*piece.coords, *other.coords])
    if where.is_empty or where.distance(ends) <= TOUCH_M:
        return []
    x, y = where.centroid.x, where.centroid.y
    return [f"{name} crosses itself at ({x:.2f}, {y:.2f}); mend the order of its points"]


def _bridges(scene: Scene) -> list[shapely.LineString]:
    """From loose ends of walls to one another and to what is nearest, the shortest first."""
    ends: list[tuple[shapely.Point, BaseGeometry]] = []
    for number, wall in enumerate(scene.walls, start=1):
        others = [shape for name, shape in scene.shapes.items() if name != f"wall {number}"]
        for points in (wall.points, wall.points[::-1]):
            own = [shapely.LineString(pair) for pair in pairwise(points[1:])]
            end, rest = shapely.Point(points[0]), shapely.union_all([*others, *own])
            if rest.is_empty or end.distance(rest) > TOUCH_M:
                ends.append((end, rest))
    bridges = []
    for at, (end, rest) in enumerate(ends):
        bridges += [shapely.LineString([end, other]) for other, _ in ends[at + 1 :]]
        if not rest.is_empty:
            bridges.append(shapely.shortest_line(end, rest))
    order = np.argsort([bridge.length for bridge in bridges], kind="stable")
    return [bridges[k] for k in order[:_BRIDGES]]


def _gap(bridge: shapely.LineString) -> Gap:
    (x, y), (to_x, to_y) = bridge.coords
    return Gap((x, y), (to_x, to_y))
