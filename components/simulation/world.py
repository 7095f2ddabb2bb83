"""The state of the world over time: the robots' true poses, people, events and contacts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import Field

from cairn import CairnError, Config
from cairn.components.simulation.layout import WorldLayout, unknown_name
from cairn.components.simulation.people import Walker, circles_of
from cairn.components.simulation.ray_casting import clearance
from cairn.components.simulation.world_checks import route_problems
from cairn.components.simulation.world_file import (
    Event,
    Furniture,
    Person,
    VisibleObject,
    WorldFile,
)
from cairn.planar.poses import Pose, compose

# After a contact the robot counts as clear of everything from this distance on [m].
_CLEAR_M = 0.02


@dataclass(frozen=True)
class Contact:
    """A contact of a robot: the thing hit, the robot's position [m], and its speed [m/s]."""

    robot: str
    what: str
    x: float
    y: float
    speed: float


@dataclass(frozen=True)
class EventResult:
    """A description of an event and whether it could take place."""

    description: str
    succeeded: bool = True


class SlipConfig(Config):
    """Slip of the wheels on the floor."""

    distance: float = Field(
        0.005, ge=0, le=1, description="Random walk of the distance [m/sqrt(m)]."
    )
    turn: float = Field(
        0.01, ge=0, le=1, description="Random walk of the heading per turn [rad/sqrt(rad)]."
    )
    turn_per_meter: float = Field(
        0.005, ge=0, le=1, description="Random walk of the heading per distance [rad/sqrt(m)]."
    )


@dataclass
class RobotBody:
    """A round robot in the world: its pose, `radius` [m], and what it touches."""

    name: str
    pose: Pose
    radius: float
    touching: set[str] = field(default_factory=set)


class World:
    """A layout, people, round robots, and events to come.

    The robot of the world file has the name `robot` and the radius `radius` [m]; `others` are
    further ones. No robot ever overlaps anything: contacts hold it back, and changes that would put
    something onto it are rejected.
    """

    def __init__(
        self,
        file: WorldFile,
        radius: float,
        slip: SlipConfig,
        random: np.random.Generator,
        robot: str = "robot",
        others: Sequence[RobotBody] = (),
    ) -> None:
        self.layout = WorldLayout.of(file)
        self.walkers = [Walker.of(person) for person in file.people]
        self._main = RobotBody(robot, file.robot.pose, radius)
        self.robots = {robot: self._main}
        self._slip = slip
        self._random = random
        self._events = sorted(file.events, key=lambda event: event.at)
        for other in others:
            if other.name in self.robots:
                raise CairnError(f"there are two robots {other.name}; give each its own name")
            self._require_room_for_robot(other, *other.pose[:2])
            self.robots[other.name] = other

    @property
    def robot(self) -> Pose:
        """Return the pose of the robot of the world file."""
        return self._main.pose

    @robot.setter
    def robot(self, pose: Pose) -> None:
        self._main.pose = pose

    @property
    def people(self) -> NDArray[np.float64]:
        """Return x, y, radius (k, 3) [m] of all people."""
        return circles_of(self.walkers)

    def move_people(self, seconds: float) -> None:
        """Let people walk for some seconds."""
        segments = self.layout.solid_segments.segments
        for walker in self.walkers:
            near = min(
                self.robots.values(),
                key=lambda body: math.dist(body.pose[:2], (walker.x, walker.y)) - body.radius,
            )
            walker.step(seconds, near.pose[:2], near.radius, segments)

    def drive(
        self,
        seconds: float,
        forward: float,
        turn: float,
        robot: str | None = None,
        aside: float = 0.0,
    ) -> tuple[bool, list[Contact]]:
        """Turn the wheels of a robot for some seconds at these mean speeds [m/s, rad/s].

        `aside` [m/s] is how fast they slip to the left. None is the robot of the world file.
        Returns whether the robot could follow, and its new contacts: a contact with the same thing
        is reported again only after the robot was clear of everything.
        """
        body = self._main if robot is None else self.robots[robot]
        distance, sideways, angle = forward * seconds, aside * seconds, turn * seconds
        if not (distance or sideways or angle):
            return True, []
        noise = self._random.standard_normal(2)
        spread = self._slip.turn**2 * abs(angle) + self._slip.turn_per_meter**2 * abs(distance)
        distance += self._slip.distance * math.sqrt(abs(distance)) * float(noise[0])
        angle += math.sqrt(spread) * float(noise[1])
        # In steps so short that the robot cannot pass through anything.
        pieces = math.ceil(2.0 * math.hypot(distance, sideways) / body.radius) or 1
        for _ in range(pieces):
            touched = self._step(body, distance / pieces, sideways / pieces, angle / pieces)
            if touched is not None:
                new = touched not in body.touching
                body.touching.add(touched)
                x, y, _ = body.pose
                return False, [Contact(body.name, touched, x, y, abs(forward))] if new else []
        return True, []

    def run_due_events(self, now_s: float) -> list[EventResult]:
        """Carry out all events that are due at `now_s` [s]."""
        results = []
        while self._events and self._events[0].at <= now_s:
            event = self._events.pop(0)
            try:
                results.append(EventResult(self._run(event)))
            except CairnError as error:
                results.append(
                    EventResult(
                        f"the event at {event.at:g} s cannot happen: {error}", succeeded=False
                    )
                )
        return results

    def skip_events(self, now_s: float) -> None:
        """Drop the events up to `now_s` [s]."""
        self._events = [event for event in self._events if event.at > now_s]

    def move(self, name: str, pose: Pose) -> None:
        """Move furniture, an object or a person; raise `CairnError` if that is not possible."""
        for walker in self.walkers:
            if walker.person.name == name:
                self._require_room_for(walker.person, pose[0], pose[1])
                walker.x, walker.y = pose[0], pose[1]
                return
        self._require_known(name)
        self._change_layout(self.layout.with_moved({name: pose}), name)

    def remove(self, name: str) -> None:
        """Remove furniture, an object or a person; raise `CairnError` if it does not exist."""
        left = [walker for walker in self.walkers if walker.person.name != name]
        if len(left) == len(self.walkers):
            self._require_known(name)
            self.layout = self.layout.without(name)
        self.walkers = left

    def add(self, thing: Furniture | VisibleObject) -> None:
        """Add furniture or an object; raise `CairnError` if that is not possible."""
        self._require_new_name(thing.display_name)
        self._change_layout(self.layout.with_added(thing), thing.display_name)

    def add_person(self, person: Person) -> None:
        """Add a person; raise `CairnError` if that is not possible."""
        self._require_new_name(person.name)
        problems = route_problems(self.layout, person)
        if problems:
            raise CairnError("; ".join(problems))
        self._require_room_for(person, *person.waypoints[0])
        self.walkers.append(Walker.of(person))

    def kidnap(self, pose: Pose) -> None:
        """Move the robot of the world file without turning its wheels.

        Raises `CairnError` if something is there.
        """
        self._require_room_for_robot(self._main, *pose[:2])
        self.robot = pose
        self._main.touching.clear()

    def _require_room_for_robot(self, body: RobotBody, x: float, y: float) -> None:
        called = self._called(body)
        self.layout.require_room(called, x, y, body.radius)
        circles = [(one.person.name, one.x, one.y, one.person.radius) for one in self.walkers]
        circles += [(one.name, *one.pose[:2], one.radius) for one in self._others_of(body)]
        for name, there_x, there_y, radius in circles:
            apart = math.hypot(there_x - x, there_y - y) - radius
            if apart < body.radius:
                raise CairnError(
                    f"{called} cannot be at ({x:.2f}, {y:.2f}): {name} stands "
                    f"{max(0.0, apart):.2f} m from there; choose another position, or wait"
                )

    def _others_of(self, body: RobotBody) -> list[RobotBody]:
        return [one for one in self.robots.values() if one is not body]

    def _step(self, body: RobotBody, distance: float, sideways: float, angle: float) -> str | None:
        """Move a robot a short step.

        Returns None, or the name of what holds the robot back; it then only turns.
        """
        half = (0.0, 0.0, 0.5 * angle)
        target = compose(compose(compose(body.pose, half), (distance, sideways, 0.0)), half)
        solid, others = self.layout.solid_segments, self._others_of(body)
        rows = [(one.pose[0], one.pose[1], one.radius) for one in others]
        circles = np.concatenate((self.people, np.array(rows, np.float64).reshape(-1, 3)))
        gap_after, what = clearance(target[0], target[1], solid.segments, circles)
        if gap_after >= body.radius:
            body.pose = target
            if gap_after >= body.radius + _CLEAR_M:
                body.touching.clear()
            return None
        gap_before, _ = clearance(body.pose[0], body.pose[1], solid.segments, circles)
        if gap_after > gap_before:
            body.pose = target
            return None
        body.pose = (body.pose[0], body.pose[1], target[2])
        if not (distance or sideways):
            return None
        names = [*solid.names, *(one.person.name for one in self.walkers)]
        return [*names, *(one.name for one in others)][what]

    def _run(self, event: Event) -> str:
        if event.move is not None and event.to is not None:
            self.move(event.move, event.to.pose)
            return f"{event.move} was moved to ({event.to.x:g}, {event.to.y:g})"
        if event.remove is not None:
            self.remove(event.remove)
            return f"{event.remove} was removed"
        if event.swap is not None:
            one, other = event.swap
            places = {one: self.layout.pose_of(other), other: self.layout.pose_of(one)}
            self._change_layout(self.layout.with_moved(places), one, other)
            return f"{one} and {other} were swapped"
        if event.add_person is not None:
            self.add_person(event.add_person)
            return f"{event.add_person.name} was added"
        if event.kidnap is not None:
            self.kidnap(event.kidnap.pose)
            return f"the robot was moved to ({event.kidnap.x:g}, {event.kidnap.y:g})"
        thing = event.add_furniture or event.add_object
        assert thing is not None  # as the validator of Event ensures
        self.add(thing)
        return f"{thing.display_name} was added at ({thing.x:g}, {thing.y:g})"

    def _change_layout(self, layout: WorldLayout, *changed: str) -> None:
        """Change the layout, unless something changed would be on the robot or on a person."""
        for name in changed:
            shape = layout.shapes.get(name)
            if shape is None:
                continue
            for body in self.robots.values():
                if shape.distance(shapely.Point(*body.pose[:2])) < body.radius:
                    raise CairnError(
                        f"{name} would stand on {self._called(body)}; choose another position"
                    )
            for walker in self.walkers:
                if shape.distance(shapely.Point(walker.x, walker.y)) < walker.person.radius:
                    raise CairnError(
                        f"{name} would stand on {walker.person.name}; choose another position, "
                        "or wait"
                    )
        self.layout = layout

    def _require_room_for(self, person: Person, x: float, y: float) -> None:
        self.layout.require_room(person.name, x, y, person.radius)
        for body in self.robots.values():
            if math.dist((x, y), body.pose[:2]) < body.radius + person.radius:
                raise CairnError(
                    f"{person.name} would stand on {self._called(body)}; choose another position"
                )

    def _called(self, body: RobotBody) -> str:
        return "the robot" if body is self._main else body.name

    def _names(self) -> list[str]:
        return [*self.layout.names, *(walker.person.name for walker in self.walkers)]

    def _require_known(self, name: str) -> None:
        if name not in self._names():
            raise unknown_name(name, self._names())

    def _require_new_name(self, name: str) -> None:
        if name in self._names():
            raise CairnError(f"{name} exists already; choose another name")
