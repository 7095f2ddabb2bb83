"""People who walk from place to place, let a robot pass, and step around one that stays."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cairn.components.simulation.rays import clearance
from cairn.components.simulation.world_file import Person

Array = NDArray[np.float64]
Point = tuple[float, float]

# They stop for a robot this near ahead of them [m], and never come nearer to it than that [m].
_AHEAD_M, _NEAR_M = 0.6, 0.1
# Who has waited so long for a robot, or before something in the way, looks for another way [s].
_PATIENCE_S = 4.0
# Around a robot: the place beside it that they go by, the least gap on the way there, and the gap
# to a robot ahead at which they stop all the same, as it has begun to drive [m].
_BESIDE_M, _PASSING_M, _STOPPING_M = 0.35, 0.15, 0.25
# Aside, where there is no way around: how far [m], and in which directions off their way [rad].
_ASIDE_M = (1.0, 0.5)
_ASIDE_RAD = tuple(math.radians(angle) for angle in (-90, 90, -135, 135, 180))
# To go to a place nearer than that is not to go away [m].
_FAR_M = 0.5
_STEP_M = 0.05
_NOBODY = np.zeros((0, 3))


@dataclass(frozen=True)
class _Surroundings:
    """What somebody of `radius` [m] walks among: the robot, and what stands."""

    radius: float
    robot: Point
    robot_radius: float
    segments: Array

    def gap(self, place: Point) -> float:
        """Between somebody at a place and the robot [m]."""
        return math.dist(place, self.robot) - self.radius - self.robot_radius

    def room(self, place: Point) -> float:
        """Between a place and what stands [m]."""
        return clearance(*place, self.segments, _NOBODY)[0]

    def meets(self, place: Point, goal: Point, near: float) -> bool:
        """Whether the robot is nearer than that [m], in the direction of the goal."""
        ahead, to_robot = _toward(place, goal), _toward(place, self.robot)
        in_front = ahead[0] * to_robot[0] + ahead[1] * to_robot[1] > 0.5
        return in_front and self.gap(place) < near

    def open(self, begin: Point, end: Point) -> bool:
        """Whether the straight way is clear of what stands and leads past the robot."""
        gap = min(_PASSING_M, self.gap(begin))
        steps = math.ceil(math.dist(begin, end) / _STEP_M) or 1
        return all(
            self.gap(place) >= gap
            and self.room(place) >= self.radius
            and not self.meets(place, end, _STOPPING_M)
            for place in (_along(begin, end, step / steps) for step in range(steps + 1))
        )


@dataclass
class Walker:
    """A person under way: where they are, where they go, what they wait for.

    `detour` are places off their way that they go to first, and how long they stand there [s].
    """

    person: Person
    x: float
    y: float
    goal: int = 0
    paused_s: float = 0.0
    blocked_s: float = 0.0
    backwards: bool = False
    detour: list[tuple[float, float, float]] = field(default_factory=list)

    @staticmethod
    def of(person: Person) -> Walker:
        """The person at their first place."""
        x, y = person.waypoints[0]
        return Walker(person, x, y)

    def step(self, seconds: float, robot: Point, robot_radius: float, segments: Array) -> None:
        """Walk on for some seconds; `robot` is where the robot is [m], `segments` what stands."""
        if self.paused_s > 0.0:
            self.paused_s -= seconds
            return
        around = _Surroundings(self.person.radius, robot, robot_radius, segments)
        here = (self.x, self.y)
        goal = self.detour[0][:2] if self.detour else self.person.waypoints[self.goal]
        left, far = math.dist(here, goal), self.person.speed * seconds
        arrives = left <= max(far, 1e-9)
        there = goal if arrives else _along(here, goal, far / left)
        near = _STOPPING_M if self.detour else _AHEAD_M
        met = not arrives and around.meets(here, goal, near)
        if met or not _free(here, there, around):
            self._wait(seconds, around)
            return
        self.blocked_s = 0.0
        self.x, self.y = there
        if arrives and self.detour:
            _, _, self.paused_s = self.detour.pop(0)
        elif arrives:
            self.paused_s = self.person.pause
            self.goal = self._after(self.goal, self.backwards)

    def _wait(self, seconds: float, around: _Surroundings) -> None:
        self.blocked_s += seconds
        if self.blocked_s <= _PATIENCE_S:
            return
        self.blocked_s = 0.0
        if around.gap((self.x, self.y)) > _AHEAD_M:
            self._turn_round()  # it is not the robot that is in the way
        elif len(self.person.waypoints) > 1 and not self._goes_on(around) and not self.detour:
            self._steps_aside(around)

    def _turn_round(self) -> None:
        self.detour.clear()
        self.backwards = not self.backwards
        self.goal = self._after(self.goal, self.backwards)

    def _goes_on(self, around: _Surroundings) -> bool:
        """Past the robot, to the place after the one that it stands on, or back, if that can be."""
        here = (self.x, self.y)
        for goal, backwards in self._choices(around):
            target = self.person.waypoints[goal]
            for by in (target, *_beside(around, here, target)):
                if by != here and around.open(here, by) and around.open(by, target):
                    self.goal, self.backwards, self.detour = goal, backwards, [(*by, 0.0)]
                    return True
        return False

    def _steps_aside(self, around: _Surroundings) -> None:
        """To where the robot can get past, if there is room, stay for a while, and come back."""
        here, goal = (self.x, self.y), self.person.waypoints[self.goal]
        ahead = math.atan2(goal[1] - self.y, goal[0] - self.x)
        for meters in _ASIDE_M:
            for angle in _ASIDE_RAD:
                x = self.x + meters * math.cos(ahead + angle)
                y = self.y + meters * math.sin(ahead + angle)
                if around.open(here, (x, y)):
                    self.detour = [(x, y, _PATIENCE_S), (*here, 0.0)]
                    return

    def _choices(self, around: _Surroundings) -> Iterator[tuple[int, bool]]:
        """Places to go to and whether that is backwards, best first."""
        yield self.goal, self.backwards
        if around.gap(self.person.waypoints[self.goal]) < _PASSING_M:
            yield self._after(self.goal, self.backwards), self.backwards
        back = self._after(self.goal, not self.backwards)
        if math.dist(self.person.waypoints[back], (self.x, self.y)) < _FAR_M:
            back = self._after(back, not self.backwards)  # to go there would change nothing
        yield back, not self.backwards

    def _after(self, goal: int, backwards: bool) -> int:
        return (goal + (-1 if backwards else 1)) % len(self.person.waypoints)


def circles_of(walkers: list[Walker]) -> Array:
    """x, y, radius (k, 3) [m] of all."""
    rows = [(walker.x, walker.y, walker.person.radius) for walker in walkers]
    return np.array(rows, np.float64).reshape(-1, 3)


def _free(here: Point, there: Point, around: _Surroundings) -> bool:
    """Whether a place is clear of the robot and of what stands, or clearer than this one."""
    gap = around.gap(there)
    if gap <= _NEAR_M and gap <= around.gap(here):
        return False
    room = around.room(there)
    return room >= around.radius or room > around.room(here)


def _beside(around: _Surroundings, here: Point, goal: Point) -> tuple[Point, Point]:
    """The places right and left of the robot, for who comes from here."""
    x, y = _toward(here, goal)
    (robot_x, robot_y), off = around.robot, around.radius + around.robot_radius + _BESIDE_M
    return (robot_x + off * y, robot_y - off * x), (robot_x - off * y, robot_y + off * x)


def _toward(begin: Point, end: Point) -> Point:
    """The direction from one place to another; none between a place and itself."""
    apart = math.dist(begin, end) or 1.0
    return (end[0] - begin[0]) / apart, (end[1] - begin[1]) / apart


def _along(begin: Point, end: Point, share: float) -> Point:
    """The place so far along the straight way from one to another."""
    return begin[0] + share * (end[0] - begin[0]), begin[1] + share * (end[1] - begin[1])
