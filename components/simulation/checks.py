"""What cannot be in a world: each thing with its place and what to do about it."""

from __future__ import annotations

from itertools import pairwise

import shapely

from cairn import CairnError
from cairn.components.simulation.recognition import BEHIND_M
from cairn.components.simulation.scene import Scene
from cairn.components.simulation.textures import read_picture
from cairn.components.simulation.walls import gaps_around, wall_problems
from cairn.components.simulation.world_file import Event, Person, VisibleObject, WorldFile
from cairn.planar.poses import Pose, compose


def problems_of(world: WorldFile, radius: float) -> list[str]:
    """What is wrong with a world for a robot of `radius` [m], each as a sentence."""
    scene = Scene.of(world)
    problems = wall_problems(world.walls)
    later = set(scene.furniture)
    for name in scene.furniture:
        try:
            scene.refuse_overlaps(name, but=later)
        except CairnError as error:
            problems.append(str(error))
        later.discard(name)
    if problems:
        return problems  # the rest would only follow from these
    robot = world.robot.pose
    problems += _refused(scene, robot, radius)
    if not problems:  # else all might be outside, too
        problems += _outside(scene)
        problems += [told for thing in world.objects for told in _hidden(scene, thing)]
        problems += [
            told for thing in _all_objects(world) for told in unseen_problems(scene, thing)
        ]
    for person in world.people:
        problems += way_problems(scene, person)
        problems += _on_robot(person, robot, radius)
    return problems + _event_problems(world, scene)


def way_problems(scene: Scene, person: Person) -> list[str]:
    """Where somebody's way leads through what stands."""
    problems = []
    places = [*person.waypoints, person.waypoints[0]]
    legs = {frozenset(leg): leg for leg in reversed(list(pairwise(places)))}  # either way is one
    for begin, end in reversed(legs.values()):
        leg = shapely.LineString([begin, end])
        for name, shape in scene.shapes.items():
            if leg.distance(shape) < person.radius:
                problems.append(
                    f"{person.name} cannot walk from ({begin[0]:g}, {begin[1]:g}) to "
                    f"({end[0]:g}, {end[1]:g}): {name} is in the way of somebody of "
                    f"{person.radius:g} m radius; add a waypoint beside it"
                )
    first = person.waypoints[0]
    if not problems and scene.outside(first[0], first[1], person.radius):
        problems.append(
            f"{person.name} begins at ({first[0]:g}, {first[1]:g}), outside of the walls; choose "
            "waypoints within"
        )
    return problems


def unseen_problems(scene: Scene, thing: VisibleObject) -> list[str]:
    """What a camera could not see as it is told: its height, its picture."""
    problems = []
    ceiling = max(wall.height for wall in scene.walls)
    half = 0.5 * thing.size[1]
    if thing.z - half < 0.0 or thing.z + half > ceiling:
        problems.append(
            f"{thing.called} goes from {thing.z - half:g} m to {thing.z + half:g} m, but the floor "
            f"is at 0 m and the highest wall ends at {ceiling:g} m; change its z or height"
        )
    if thing.texture is not None:
        try:
            read_picture(thing.texture)
        except CairnError as error:
            problems.append(f"{thing.called}: {error}")
    return problems


def _refused(scene: Scene, robot: Pose, radius: float) -> list[str]:
    try:
        scene.refuse_place("robot: it", robot[0], robot[1], radius)
    except CairnError as error:
        outside = scene.outside(robot[0], robot[1], radius)
        gaps = gaps_around(scene, robot, radius) if outside else []
        return [f"the walls leave a gap {gap}; close it" for gap in gaps] or [str(error)]
    return []


def _outside(scene: Scene) -> list[str]:
    problems = []
    for name in scene.furniture:
        try:
            scene.refuse_outside(name)
        except CairnError as error:
            problems.append(str(error))
    return problems


def _hidden(scene: Scene, thing: VisibleObject) -> list[str]:
    """Objects that nobody can see: inside furniture, or facing out of the world."""
    x, y, _ = compose(thing.pose, (BEHIND_M + 0.02, 0.0, 0.0))
    front = shapely.Point(x, y)
    for name in scene.furniture:
        if scene.shapes[name].contains(front):
            return [
                f"{thing.called} at ({thing.x:g}, {thing.y:g}) is hidden inside {name}, or faces "
                "into it; put it on its surface, with theta pointing away"
            ]
    if scene.outside(x, y, 0.01):
        return [
            f"{thing.called} at ({thing.x:g}, {thing.y:g}) is outside of the walls or faces "
            "outwards; theta is where it faces"
        ]
    return []


def _all_objects(world: WorldFile) -> list[VisibleObject]:
    """Those of the beginning and those of events."""
    later = [event.add_object for event in world.events if event.add_object is not None]
    return [*world.objects, *later]


def _on_robot(person: Person, robot: Pose, radius: float) -> list[str]:
    x, y = person.waypoints[0]
    if shapely.Point(x, y).distance(shapely.Point(robot[0], robot[1])) >= radius + person.radius:
        return []
    return [f"{person.name} begins at ({x:g}, {y:g}), on the robot; move one of them"]


def _event_problems(world: WorldFile, scene: Scene) -> list[str]:
    """What cannot happen, in the order of time: things that are not there, or have no room."""
    problems = []
    people = {person.name for person in world.people}
    for event in sorted(world.events, key=lambda one: one.at):
        try:
            scene = _after(event, scene, people)
        except CairnError as error:
            problems.append(f"the event at {event.at:g} s cannot happen: {error}")
    return problems


def _after(event: Event, scene: Scene, people: set[str]) -> Scene:
    """The scene after an event; `people` is kept up as well."""
    if event.move is not None and event.to is not None:
        if event.move not in people:
            return scene.moved({event.move: event.to.pose})
        scene.refuse_place(event.move, event.to.x, event.to.y, 0.0)
    elif event.remove is not None:
        if event.remove not in people:
            return scene.without(event.remove)
        people.discard(event.remove)
    elif event.swap is not None:
        one, other = event.swap
        return scene.moved({one: scene.pose_of(other), other: scene.pose_of(one)})
    elif event.kidnap is not None:
        scene.refuse_place("the robot", event.kidnap.x, event.kidnap.y, 0.0)
    elif event.add_person is not None:
        if event.add_person.name in {*people, *scene.names}:
            raise CairnError(f"there is a {event.add_person.name} already; give another name")
        people.add(event.add_person.name)
        problems = way_problems(scene, event.add_person)
        if problems:
            raise CairnError("; ".join(problems))
    else:
        thing = event.add_furniture or event.add_object
        assert thing is not None  # as the model of events says
        if thing.called in people:
            raise CairnError(f"there is a {thing.called} already; give another name")
        return scene.joined(thing)
    return scene
