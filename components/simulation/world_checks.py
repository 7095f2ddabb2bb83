"""Checks of a world file: overlaps, gaps in walls, hidden objects, impossible events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from cairn import CairnError
from cairn.components.simulation.layout import BEHIND_M, TOUCH_M, WorldLayout
from cairn.components.simulation.textures import read_picture
from cairn.components.simulation.world_file import Event, Person, VisibleObject, Wall, WorldFile
from cairn.planar.poses import Pose, compose


def world_problems(world: WorldFile, radius: float) -> list[str]:
    """Return the problems of a world for a robot of `radius` [m], one sentence each."""
    layout = WorldLayout.of(world)
    problems = wall_problems(world.walls)
    later = set(layout.furniture)
    for name in layout.furniture:
        try:
            layout.require_no_overlap(name, except_for=later)
        except CairnError as error:
            problems.append(str(error))
        later.discard(name)
    if problems:
        return problems  # later problems would only be consequences
    robot = world.robot.pose
    problems += _refused(layout, robot, radius)
    if not problems:  # otherwise everything might be outside
        problems += _outside(layout)
        problems += [problem for thing in world.objects for problem in _hidden(layout, thing)]
        problems += [
            problem
            for thing in _all_objects(world)
            for problem in visibility_problems(layout, thing)
        ]
    for person in world.people:
        problems += route_problems(layout, person)
        problems += _on_robot(person, robot, radius)
    return problems + _event_problems(world, layout)


def route_problems(layout: WorldLayout, person: Person) -> list[str]:
    """Return the places where a person's route leads through walls or furniture."""
    problems = []
    corners = [*person.waypoints, person.waypoints[0]]
    segments = {
        frozenset(one): one for one in reversed(list(pairwise(corners)))
    }  # both directions count once
    for begin, end in reversed(segments.values()):
        segment = shapely.LineString([begin, end])
        for name, shape in layout.shapes.items():
            if segment.distance(shape) < person.radius:
                problems.append(
                    f"{person.name} cannot walk from ({begin[0]:g}, {begin[1]:g}) to "
                    f"({end[0]:g}, {end[1]:g}): {name} is in the way of a person of "
                    f"{person.radius:g} m radius; add a waypoint beside it"
                )
    first = person.waypoints[0]
    if not problems and layout.outside(first[0], first[1], person.radius):
        problems.append(
            f"{person.name} begins at ({first[0]:g}, {first[1]:g}), outside the walls; choose "
            "waypoints inside"
        )
    return problems


def visibility_problems(layout: WorldLayout, thing: VisibleObject) -> list[str]:
    """Return why a camera could not show an object: its height, or an unreadable picture."""
    problems = []
    ceiling = max(wall.height for wall in layout.walls)
    half = 0.5 * thing.size[1]
    if thing.z - half < 0.0 or thing.z + half > ceiling:
        problems.append(
            f"{thing.display_name} goes from {thing.z - half:g} m to {thing.z + half:g} m, but "
            f"the floor is at 0 m and the highest wall ends at {ceiling:g} m; change its z "
            "or height"
        )
    if thing.texture is not None:
        try:
            read_picture(thing.texture)
        except CairnError as error:
            problems.append(f"{thing.display_name}: {error}")
    return problems


def _refused(layout: WorldLayout, robot: Pose, radius: float) -> list[str]:
    try:
        layout.require_room("robot: it", robot[0], robot[1], radius)
    except CairnError as error:
        outside = layout.outside(robot[0], robot[1], radius)
        gaps = wall_gaps(layout, robot, radius) if outside else []
        return [f"the walls leave a gap {gap}; close it" for gap in gaps] or [str(error)]
    return []


def _outside(layout: WorldLayout) -> list[str]:
    problems = []
    for name in layout.furniture:
        try:
            layout.require_inside(name)
        except CairnError as error:
            problems.append(str(error))
    return problems


def _hidden(layout: WorldLayout, thing: VisibleObject) -> list[str]:
    """Return whether no camera can see an object: inside furniture, or facing out of the world."""
    x, y, _ = compose(thing.pose, (BEHIND_M + 0.02, 0.0, 0.0))
    front = shapely.Point(x, y)
    for name in layout.furniture:
        if layout.shapes[name].contains(front):
            return [
                f"{thing.display_name} at ({thing.x:g}, {thing.y:g}) is hidden inside {name}, "
                "or faces into it; put it on its surface, with theta pointing away"
            ]
    if layout.outside(x, y, 0.01):
        return [
            f"{thing.display_name} at ({thing.x:g}, {thing.y:g}) is outside the walls or faces "
            "outward; theta is the direction that it faces"
        ]
    return []


def _all_objects(world: WorldFile) -> list[VisibleObject]:
    """Return the objects at the start and those that events add."""
    later = [event.add_object for event in world.events if event.add_object is not None]
    return [*world.objects, *later]


def _on_robot(person: Person, robot: Pose, radius: float) -> list[str]:
    x, y = person.waypoints[0]
    if shapely.Point(x, y).distance(shapely.Point(robot[0], robot[1])) >= radius + person.radius:
        return []
    return [f"{person.name} begins at ({x:g}, {y:g}), on the robot; move one of them"]


def _event_problems(world: WorldFile, layout: WorldLayout) -> list[str]:
    """Return the events that cannot happen, in the order of time: unknown names, or no room."""
    problems = []
    people = {person.name for person in world.people}
    for event in sorted(world.events, key=lambda one: one.at):
        try:
            layout = _after(event, layout, people)
        except CairnError as error:
            problems.append(f"the event at {event.at:g} s cannot happen: {error}")
    return problems


def _after(event: Event, layout: WorldLayout, people: set[str]) -> WorldLayout:
    """Return the layout after an event; `people` is updated."""
    if event.move is not None and event.to is not None:
        if event.move not in people:
            return layout.with_moved({event.move: event.to.pose})
        layout.require_room(event.move, event.to.x, event.to.y, 0.0)
    elif event.remove is not None:
        if event.remove not in people:
            return layout.without(event.remove)
        people.discard(event.remove)
    elif event.swap is not None:
        one, other = event.swap
        return layout.with_moved({one: layout.pose_of(other), other: layout.pose_of(one)})
    elif event.kidnap is not None:
        layout.require_room("the robot", event.kidnap.x, event.kidnap.y, 0.0)
    elif event.add_person is not None:
        if event.add_person.name in {*people, *layout.names}:
            raise CairnError(f"{event.add_person.name} exists already; choose another name")
        people.add(event.add_person.name)
        problems = route_problems(layout, event.add_person)
        if problems:
            raise CairnError("; ".join(problems))
    else:
        thing = event.add_furniture or event.add_object
        assert thing is not None  # as the validator of Event ensures
        if thing.display_name in people:
            raise CairnError(f"{thing.display_name} exists already; choose another name")
        return layout.with_added(thing)
    return layout


# Walls that are side by side for less than this [m] only meet at a small angle.
_BESIDE_M = 0.25
# Only so many bridges between loose wall ends are tried, the shortest first, to limit the time.
_BRIDGES = 60
# Unreachable areas smaller than this [m^2] for the robot's center are not reported.
_ROOM_M2 = 0.1


def wall_problems(walls: Sequence[Wall]) -> list[str]:
    """Return problems of walls: repeated points, self-crossings, walls on or close to others."""
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
            problems += _overlapping(f"wall {number}", piece, f"wall {other_number}", other)
            if number == other_number and other_index > index + 1:
                problems += _crossing(f"wall {number}", piece, other)
    return problems


@dataclass(frozen=True)
class Gap:
    """A gap in the walls, from one point to another [m]."""

    begin: tuple[float, float]
    end: tuple[float, float]

    def __str__(self) -> str:
        (x, y), (to_x, to_y) = self.begin, self.end
        meters = shapely.Point(self.begin).distance(shapely.Point(self.end))
        return f"of {meters:.2f} m from ({x:.2f}, {y:.2f}) to ({to_x:.2f}, {to_y:.2f})"


def wall_gaps(layout: WorldLayout, place: Pose, radius: float) -> list[Gap]:
    """Return the gaps through which a disc of that radius [m] gets from a pose beyond the walls.

    Empty if no bridges between loose ends of walls would close it in. Of equivalent gaps the one
    that leaves the most room inside is returned: so it is a gap in the outer wall and not a door.
    """
    width = max(radius, 0.01)
    solid = shapely.union_all(list(layout.shapes.values()))
    around = shapely.box(*solid.buffer(2.0 * width + 1.0).bounds)
    free = around.difference(solid.buffer(width))
    spot, corner = shapely.Point(place[0], place[1]), shapely.Point(around.bounds[:2])

    def room(bridges: Sequence[shapely.LineString]) -> float:
        """Return the area [m^2] around the pose if these bridges existed; 0 if still open."""
        parts = shapely.get_parts(free.difference(shapely.union_all(bridges).buffer(width)))
        own = [part for part in parts if part.covers(spot) and not part.covers(corner)]
        return float(sum(part.area for part in own))

    bridges = [bridge for bridge in _bridges(layout) if bridge.distance(spot) >= width]
    best = max(bridges, key=lambda bridge: room([bridge]), default=None)
    if best is not None and room([best]) > 0:
        return [_gap(best)]
    if not bridges or room(bridges) == 0:
        return []
    needed = bridges
    for bridge in reversed(bridges):  # longest first
        rest = [one for one in needed if one is not bridge]
        if room(rest) > 0:
            needed = rest
    return [_gap(bridge) for bridge in needed]


@dataclass(frozen=True)
class UnreachableArea:
    """An area that the robot cannot reach: its size [m^2] and a point in it [m]."""

    area: float
    x: float
    y: float


def unreachable_areas(layout: WorldLayout, place: Pose, radius: float) -> list[UnreachableArea]:
    """Return where a robot of that radius [m] has room but cannot get to from its start."""
    solid = shapely.union_all(list(layout.shapes.values()))
    around = shapely.box(*solid.buffer(2.0 * radius + 1.0).bounds)
    spot, corner = shapely.Point(place[0], place[1]), shapely.Point(around.bounds[:2])
    found = []
    for part in shapely.get_parts(around.difference(solid.buffer(radius))):
        if part.area >= _ROOM_M2 and not part.covers(spot) and not part.covers(corner):
            with_textures_in = part.representative_point()
            found.append(
                UnreachableArea(part.buffer(radius).area, with_textures_in.x, with_textures_in.y)
            )
    return found


def _overlapping(
    name: str, piece: shapely.LineString, other_name: str, other: shapely.LineString
) -> list[str]:
    common = piece.intersection(other)
    if common.length > TOUCH_M:
        where = common.centroid
        return [f"{name} and {other_name} overlap at ({where.x:.2f}, {where.y:.2f}); leave one out"]
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
    return [f"{name} crosses itself at ({x:.2f}, {y:.2f}); correct the order of its points"]


def _bridges(layout: WorldLayout) -> list[shapely.LineString]:
    """Return lines from loose wall ends to one another and to the nearest wall, shortest first."""
    ends: list[tuple[shapely.Point, BaseGeometry]] = []
    for number, wall in enumerate(layout.walls, start=1):
        others = [shape for name, shape in layout.shapes.items() if name != f"wall {number}"]
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
