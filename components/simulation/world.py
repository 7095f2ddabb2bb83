"""The world in time: the robot's true pose, who walks, what happens, and what is hit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.errors import CairnError
from components.simulation.people import Walker, circles_of
from components.simulation.rays import clearance
from components.simulation.scene import Scene, unknown
from components.simulation.world_file import Event, Person, WorldFile
from planar.poses import Pose, compose

# A robot that was in touch with something is clear of it from here on [m].
_CLEAR_M = 0.02


@dataclass(frozen=True)
class Contact:
    """The robot has touched something: what, where [m], how fast [m/s]."""

    what: str
    x: float
    y: float
    speed: float


@dataclass(frozen=True)
class Slip:
    """How the wheels slip: random walks of the way [m/sqrt(m)] and the heading [rad/sqrt(rad)],
    [rad/sqrt(m)].
    """

    way: float
    turn: float
    turn_per_metre: float


class World:
    """A scene, people, a round robot of `radius` [m], and events to come."""

    def __init__(
        self, file: WorldFile, radius: float, slip: Slip, random: np.random.Generator
    ) -> None:
        self.scene = Scene.of(file)
        self.walkers = [Walker.of(person) for person in file.people]
        self.robot: Pose = file.robot.pose
        self.radius = radius
        self.slip = slip
        self.random = random
        self._events = sorted(file.events, key=lambda event: event.at)
        self._touching = ""
        self._renew()

    @property
    def people(self) -> NDArray[np.float64]:
        """x, y, radius (k, 3) [m] of everybody."""
        return circles_of(self.walkers)

    @property
    def surroundings(self) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Segments (m, 4) [m] and surfaces (m,) of what stands."""
        return self._segments, self._surfaces

    def walk(self, seconds: float) -> None:
        """Let people walk on."""
        for walker in self.walkers:
            walker.step(seconds, (self.robot[0], self.robot[1]), self.radius)

    def drive(self, seconds: float, forward: float, turn: float) -> Contact | None:
        """Let the wheels turn for some seconds at these speeds [m/s, rad/s].

        The robot is held back where it touches something; that is told once, until it is clear.
        """
        far, turned = forward * seconds, turn * seconds
        if far or turned:
            noise = self.random.standard_normal(2)
            far += self.slip.way * math.sqrt(abs(far)) * noise[0]
            spread = self.slip.turn**2 * abs(turned) + self.slip.turn_per_metre**2 * abs(far)
            turned += math.sqrt(spread) * noise[1]
        half = (0.0, 0.0, 0.5 * turned)
        there = compose(compose(compose(self.robot, half), (far, 0.0, 0.0)), half)
        circles = self.people
        now, _ = clearance(self.robot[0], self.robot[1], self._segments, circles)
        then, what = clearance(there[0], there[1], self._segments, circles)
        if then >= self.radius or then > now + 1e-9:
            self.robot = there
            if then >= self.radius + _CLEAR_M:
                self._touching = ""
            return None
        # Held back; the wheels may still turn it on the spot.
        self.robot = (self.robot[0], self.robot[1], there[2])
        name = self._name(what)
        if name == self._touching or not far:
            return None
        self._touching = name
        return Contact(name, self.robot[0], self.robot[1], abs(forward))

    def happen(self, now_s: float) -> list[str]:
        """Let everything happen that is due at `now_s` [s]; gives sentences."""
        told = []
        while self._events and self._events[0].at <= now_s:
            event = self._events.pop(0)
            try:
                told.append(self._change(event))
            except CairnError as error:
                told.append(f"the event of {event.at:g} s cannot happen: {error}")
        return told

    def skip_events(self, now_s: float) -> None:
        """Drop what happened before `now_s` [s]."""
        self._events = [event for event in self._events if event.at > now_s]

    def move(self, name: str, pose: Pose) -> None:
        """Move furniture, an object or a person; `CairnError` if there is no such thing."""
        for walker in self.walkers:
            if walker.person.name == name:
                walker.x, walker.y = pose[0], pose[1]
                return
        self._known(name)
        self.scene.move(name, pose)
        self._renew()

    def remove(self, name: str) -> None:
        """Take furniture, an object or a person away; `CairnError` if there is no such thing."""
        left = [walker for walker in self.walkers if walker.person.name != name]
        if len(left) < len(self.walkers):
            self.walkers = left
            return
        self._known(name)
        self.scene.remove(name)
        self._renew()

    def add_person(self, person: Person) -> None:
        """Let somebody come; `CairnError` if the name is taken."""
        if person.name in self._names():
            raise CairnError(f"there is a {person.name} already; give another name")
        self.walkers.append(Walker.of(person))

    def renewed(self) -> None:
        """Take up what was changed in the scene."""
        self._renew()

    def carry(self, pose: Pose) -> None:
        """Carry the robot somewhere else; `CairnError` if something stands there."""
        room, what = clearance(pose[0], pose[1], self._segments, self.people)
        if room < self.radius:
            raise CairnError(
                f"the robot cannot be put at ({pose[0]:.2f}, {pose[1]:.2f}): {self._name(what)} is "
                f"{room:.2f} m from there, and the robot's radius is {self.radius:g} m"
            )
        self.robot = pose

    def _change(self, event: Event) -> str:
        if event.move is not None and event.to is not None:
            self.move(event.move, event.to.pose)
            return f"{event.move} is moved to ({event.to.x:g}, {event.to.y:g})"
        if event.remove is not None:
            self.remove(event.remove)
            return f"{event.remove} is taken away"
        if event.swap is not None:
            one, other = event.swap
            here, there = self.scene.pose_of(one), self.scene.pose_of(other)
            self.move(one, there)
            self.move(other, here)
            return f"{one} and {other} change places"
        if event.add_person is not None:
            self.add_person(event.add_person)
            return f"{event.add_person.name} comes"
        if event.kidnap is not None:
            self.carry(event.kidnap.pose)
            return f"the robot is carried to ({event.kidnap.x:g}, {event.kidnap.y:g})"
        thing = event.add_furniture or event.add_object
        assert thing is not None  # as the model of events says
        self.scene.add(thing)
        self._renew()
        return f"something new stands at ({thing.x:g}, {thing.y:g})"

    def _names(self) -> list[str]:
        people = [walker.person.name for walker in self.walkers]
        return [*self.scene.furniture, *self.scene.objects, *people]

    def _known(self, name: str) -> None:
        if name not in self._names():
            raise unknown(name, self._names())

    def _name(self, what: int) -> str:
        standing = len(self._segments)
        if what < standing:
            return self.scene.name_of_segment(what)
        return self.walkers[what - standing].person.name

    def _renew(self) -> None:
        self._segments, self._surfaces = self.scene.segments()
