"""The world in time: the robot's true pose, who walks, what happens, and what is hit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from cairn import CairnError
from cairn.components.simulation.checks import way_problems
from cairn.components.simulation.people import Walker, circles_of
from cairn.components.simulation.rays import clearance
from cairn.components.simulation.scene import Scene, unknown
from cairn.components.simulation.world_file import (
    Event,
    Furniture,
    Person,
    VisibleObject,
    WorldFile,
)
from cairn.planar.poses import Pose, compose

# A robot that was in touch with something is clear of it from here on [m].
_CLEAR_M = 0.02


@dataclass(frozen=True)
class Contact:
    """The robot has touched something: what, where the robot was [m], how fast it was [m/s]."""

    what: str
    x: float
    y: float
    speed: float


@dataclass(frozen=True)
class Happening:
    """An event in a sentence, and whether it took place."""

    told: str
    done: bool = True


@dataclass(frozen=True)
class Slip:
    """How the wheels slip: random walks of the way [m/sqrt(m)] and the heading [rad/sqrt(rad)],
    [rad/sqrt(m)].
    """

    way: float
    turn: float
    turn_per_meter: float


class World:
    """A scene, people, a round robot of `radius` [m], and events to come.

    The robot never overlaps anything: it is held back, and what would be put onto it is refused.
    """

    def __init__(
        self, file: WorldFile, radius: float, slip: Slip, random: np.random.Generator
    ) -> None:
        self.scene = Scene.of(file)
        self.walkers = [Walker.of(person) for person in file.people]
        self.robot: Pose = file.robot.pose
        self.radius = radius
        self._slip = slip
        self._random = random
        self._events = sorted(file.events, key=lambda event: event.at)
        self._touching: set[str] = set()

    @property
    def people(self) -> NDArray[np.float64]:
        """x, y, radius (k, 3) [m] of everybody."""
        return circles_of(self.walkers)

    def walk(self, seconds: float) -> None:
        """Let people walk on."""
        segments = self.scene.standing.segments
        for walker in self.walkers:
            walker.step(seconds, self.robot[:2], self.radius, segments)

    def drive(self, seconds: float, forward: float, turn: float) -> tuple[bool, list[Contact]]:
        """Let the wheels turn for some seconds at these speeds [m/s, rad/s].

        Gives whether the robot could follow, and what it came into contact with: a thing is told
        once, until the robot is clear of everything.
        """
        way, turned = forward * seconds, turn * seconds
        if not (way or turned):
            return True, []
        noise = self._random.standard_normal(2)
        spread = self._slip.turn**2 * abs(turned) + self._slip.turn_per_meter**2 * abs(way)
        way += self._slip.way * math.sqrt(abs(way)) * float(noise[0])
        turned += math.sqrt(spread) * float(noise[1])
        # In pieces so short that it cannot get through anything.
        pieces = math.ceil(2.0 * abs(way) / self.radius) or 1
        for _ in range(pieces):
            touched = self._go(way / pieces, turned / pieces)
            if touched is not None:
                new = touched not in self._touching
                self._touching.add(touched)
                x, y, _ = self.robot
                return False, [Contact(touched, x, y, abs(forward))] if new else []
        return True, []

    def happen(self, now_s: float) -> list[Happening]:
        """Let everything happen that is due at `now_s` [s]."""
        told = []
        while self._events and self._events[0].at <= now_s:
            event = self._events.pop(0)
            try:
                told.append(Happening(self._change(event)))
            except CairnError as error:
                told.append(
                    Happening(f"the event at {event.at:g} s cannot happen: {error}", done=False)
                )
        return told

    def skip_events(self, now_s: float) -> None:
        """Drop what happened before `now_s` [s]."""
        self._events = [event for event in self._events if event.at > now_s]

    def move(self, name: str, pose: Pose) -> None:
        """Move furniture, an object or a person; `CairnError` if that cannot be."""
        for walker in self.walkers:
            if walker.person.name == name:
                self._refuse_person(walker.person, pose[0], pose[1])
                walker.x, walker.y = pose[0], pose[1]
                return
        self._refuse_unknown(name)
        self._take(self.scene.moved({name: pose}), name)

    def remove(self, name: str) -> None:
        """Take furniture, an object or a person away; `CairnError` if there is no such thing."""
        left = [walker for walker in self.walkers if walker.person.name != name]
        if len(left) == len(self.walkers):
            self._refuse_unknown(name)
            self.scene = self.scene.without(name)
        self.walkers = left

    def add(self, thing: Furniture | VisibleObject) -> None:
        """Put something new there; `CairnError` if that cannot be."""
        self._refuse_twin(thing.called)
        self._take(self.scene.joined(thing), thing.called)

    def add_person(self, person: Person) -> None:
        """Let somebody come; `CairnError` if that cannot be."""
        self._refuse_twin(person.name)
        problems = way_problems(self.scene, person)
        if problems:
            raise CairnError("; ".join(problems))
        self._refuse_person(person, *person.waypoints[0])
        self.walkers.append(Walker.of(person))

    def carry(self, pose: Pose) -> None:
        """Carry the robot somewhere else; `CairnError` if something is there."""
        x, y, _ = pose
        self.scene.refuse_place("the robot", x, y, self.radius)
        for walker in self.walkers:
            apart = math.hypot(walker.x - x, walker.y - y) - walker.person.radius
            if apart < self.radius:
                raise CairnError(
                    f"the robot cannot be at ({x:.2f}, {y:.2f}): {walker.person.name} stands "
                    f"{max(0.0, apart):.2f} m from there; choose another place, or wait"
                )
        self.robot = pose
        self._touching.clear()

    def _go(self, way: float, turned: float) -> str | None:
        """Go a short step; None, or what holds the robot back, which then only turns."""
        half = (0.0, 0.0, 0.5 * turned)
        there = compose(compose(compose(self.robot, half), (way, 0.0, 0.0)), half)
        standing, people = self.scene.standing, self.people
        then, what = clearance(there[0], there[1], standing.segments, people)
        if then >= self.radius:
            self.robot = there
            if then >= self.radius + _CLEAR_M:
                self._touching.clear()
            return None
        now, _ = clearance(self.robot[0], self.robot[1], standing.segments, people)
        if then > now:
            self.robot = there
            return None
        self.robot = (self.robot[0], self.robot[1], there[2])
        if not way:
            return None
        known = len(standing.names)
        return standing.names[what] if what < known else self.walkers[what - known].person.name

    def _change(self, event: Event) -> str:
        if event.move is not None and event.to is not None:
            self.move(event.move, event.to.pose)
            return f"{event.move} is moved to ({event.to.x:g}, {event.to.y:g})"
        if event.remove is not None:
            self.remove(event.remove)
            return f"{event.remove} is taken away"
        if event.swap is not None:
            one, other = event.swap
            places = {one: self.scene.pose_of(other), other: self.scene.pose_of(one)}
            self._take(self.scene.moved(places), one, other)
            return f"{one} and {other} change places"
        if event.add_person is not None:
            self.add_person(event.add_person)
            return f"{event.add_person.name} comes"
        if event.kidnap is not None:
            self.carry(event.kidnap.pose)
            return f"the robot is carried to ({event.kidnap.x:g}, {event.kidnap.y:g})"
        thing = event.add_furniture or event.add_object
        assert thing is not None  # as the model of events says
        self.add(thing)
        return f"{thing.called} is put to ({thing.x:g}, {thing.y:g})"

    def _take(self, scene: Scene, *changed: str) -> None:
        """Let the scene be another one, unless what changed would be on the robot or on people."""
        for name in changed:
            shape = scene.shapes.get(name)
            if shape is None:
                continue
            if shape.distance(shapely.Point(self.robot[0], self.robot[1])) < self.radius:
                raise CairnError(f"{name} would stand on the robot; choose another place")
            for walker in self.walkers:
                if shape.distance(shapely.Point(walker.x, walker.y)) < walker.person.radius:
                    raise CairnError(
                        f"{name} would stand on {walker.person.name}; choose another place, or wait"
                    )
        self.scene = scene

    def _refuse_person(self, person: Person, x: float, y: float) -> None:
        self.scene.refuse_place(person.name, x, y, person.radius)
        if math.hypot(x - self.robot[0], y - self.robot[1]) < self.radius + person.radius:
            raise CairnError(f"{person.name} would stand on the robot; choose another place")

    def _names(self) -> list[str]:
        return [*self.scene.names, *(walker.person.name for walker in self.walkers)]

    def _refuse_unknown(self, name: str) -> None:
        if name not in self._names():
            raise unknown(name, self._names())

    def _refuse_twin(self, name: str) -> None:
        if name in self._names():
            raise CairnError(f"there is a {name} already; give another name")
