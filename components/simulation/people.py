"""Simulated people: they walk along waypoints, stop for the robot, and walk around it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cairn.components.simulation.ray_casting import clearance
from cairn.components.simulation.world_file import Person

Array = NDArray[np.float64]
Point = tuple[float, float]

# People stop for a robot this near ahead of them [m] and keep at least this gap to it [m]. These
# and the following values are assumptions about people's behavior, not measurements.
_AHEAD_M, _NEAR_M = 0.6, 0.1
# A person that has waited this long [s] for the robot or another obstacle tries another path.
_PATIENCE_S = 4.0
# Around a robot: lateral offset of the point beside it, least gap on the path to it, and gap to a
# robot ahead at which people stop because it has started to drive [m].
_BESIDE_M, _PASSING_M, _STOPPING_M = 0.35, 0.15, 0.25
# If no path leads around, people step aside by this much [m] in these directions off their path
# [rad].
_ASIDE_M = (1.0, 0.5)
_ASIDE_RAD = tuple(math.radians(angle) for angle in (-90, 90, -135, 135, 180))
# A waypoint nearer than this [m] does not count as leaving.
_FAR_M = 0.5
_STEP_M = 0.05
_NO_PEOPLE = np.zeros((0, 3))


@dataclass(frozen=True)
class _WalkContext:
    """What a person of `radius` [m] has to avoid: the robot and the segments of the layout."""

    radius: float
    robot: Point
    robot_radius: float
    segments: Array

    def gap(self, position: Point) -> float:
        """Return the gap [m] between a person at a position and the robot."""
        return math.dist(position, self.robot) - self.radius - self.robot_radius

    def room(self, position: Point) -> float:
        """Return the distance [m] from a position to the nearest wall or furniture."""
        return clearance(*position, self.segments, _NO_PEOPLE)[0]

    def robot_ahead(self, position: Point, goal: Point, near: float) -> bool:
        """Return whether the robot is nearer than that [m] in the direction of the goal."""
        ahead, to_robot = _toward(position, goal), _toward(position, self.robot)
        in_front = ahead[0] * to_robot[0] + ahead[1] * to_robot[1] > 0.5
        return in_front and self.gap(position) < near

    def is_open(self, begin: Point, end: Point) -> bool:
        """Return whether the straight line is free of walls and furniture and passes the robot."""
        gap = min(_PASSING_M, self.gap(begin))
        steps = math.ceil(math.dist(begin, end) / _STEP_M) or 1
        return all(
            self.gap(position) >= gap
            and self.room(position) >= self.radius
            and not self.robot_ahead(position, end, _STOPPING_M)
            for position in (_along(begin, end, step / steps) for step in range(steps + 1))
        )


@dataclass
class Walker:
    """The state of a walking person: position, next waypoint, and waiting times.

    `detour` are points x, y [m] to visit first, and how long to wait there [s].
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
        """Return the person at the first waypoint."""
        x, y = person.waypoints[0]
        return Walker(person, x, y)

    def step(self, seconds: float, robot: Point, robot_radius: float, segments: Array) -> None:
        """Walk for some seconds; `robot` is its position [m], `segments` walls and furniture."""
        if self.paused_s > 0.0:
            self.paused_s -= seconds
            return
        context = _WalkContext(self.person.radius, robot, robot_radius, segments)
        here = (self.x, self.y)
        goal = self.detour[0][:2] if self.detour else self.person.waypoints[self.goal]
        left, far = math.dist(here, goal), self.person.speed * seconds
        arrived = left <= max(far, 1e-9)
        there = goal if arrived else _along(here, goal, far / left)
        near = _STOPPING_M if self.detour else _AHEAD_M
        blocked = not arrived and context.robot_ahead(here, goal, near)
        if blocked or not _is_free(here, there, context):
            self._wait(seconds, context)
            return
        self.blocked_s = 0.0
        self.x, self.y = there
        if arrived and self.detour:
            _, _, self.paused_s = self.detour.pop(0)
        elif arrived:
            self.paused_s = self.person.pause
            self.goal = self._after(self.goal, self.backwards)

    def _wait(self, seconds: float, context: _WalkContext) -> None:
        self.blocked_s += seconds
        if self.blocked_s <= _PATIENCE_S:
            return
        self.blocked_s = 0.0
        if context.gap((self.x, self.y)) > _AHEAD_M:
            self._turn_back()  # the obstacle is not the robot
        elif len(self.person.waypoints) > 1 and not self._plan_detour(context) and not self.detour:
            self._step_aside(context)

    def _turn_back(self) -> None:
        self.detour.clear()
        self.backwards = not self.backwards
        self.goal = self._after(self.goal, self.backwards)

    def _plan_detour(self, context: _WalkContext) -> bool:
        """Plan a detour past the robot, beyond a blocked waypoint, or back; return if possible."""
        here = (self.x, self.y)
        for goal, backwards in self._choices(context):
            target = self.person.waypoints[goal]
            for by in (target, *_beside(context, here, target)):
                if by != here and context.is_open(here, by) and context.is_open(by, target):
                    self.goal, self.backwards, self.detour = goal, backwards, [(*by, 0.0)]
                    return True
        return False

    def _step_aside(self, context: _WalkContext) -> None:
        """Step aside to let the robot pass, if there is room, wait there, and come back."""
        here, goal = (self.x, self.y), self.person.waypoints[self.goal]
        ahead = math.atan2(goal[1] - self.y, goal[0] - self.x)
        for meters in _ASIDE_M:
            for angle in _ASIDE_RAD:
                x = self.x + meters * math.cos(ahead + angle)
                y = self.y + meters * math.sin(ahead + angle)
                if context.is_open(here, (x, y)):
                    self.detour = [(x, y, _PATIENCE_S), (*here, 0.0)]
                    return

    def _choices(self, context: _WalkContext) -> Iterator[tuple[int, bool]]:
        """Yield candidate waypoints and whether they reverse the direction, best first."""
        yield self.goal, self.backwards
        if context.gap(self.person.waypoints[self.goal]) < _PASSING_M:
            yield self._after(self.goal, self.backwards), self.backwards
        back = self._after(self.goal, not self.backwards)
        if math.dist(self.person.waypoints[back], (self.x, self.y)) < _FAR_M:
            back = self._after(back, not self.backwards)  # walking there would not help
        yield back, not self.backwards

    def _after(self, goal: int, backwards: bool) -> int:
        return (goal + (-1 if backwards else 1)) % len(self.person.waypoints)


def circles_of(walkers: list[Walker]) -> Array:
    """Return x, y, radius (k, 3) [m] of all people."""
    rows = [(walker.x, walker.y, walker.person.radius) for walker in walkers]
    return np.array(rows, np.float64).reshape(-1, 3)


def _is_free(here: Point, there: Point, context: _WalkContext) -> bool:
    """Return whether a position is clear of robot and layout, or clearer than the current one."""
    gap = context.gap(there)
    if gap <= _NEAR_M and gap <= context.gap(here):
        return False
    room = context.room(there)
    return room >= context.radius or room > context.room(here)


def _beside(context: _WalkContext, here: Point, goal: Point) -> tuple[Point, Point]:
    """Return the points to the right and left of the robot, for a person that comes from `here`."""
    x, y = _toward(here, goal)
    (robot_x, robot_y), off = context.robot, context.radius + context.robot_radius + _BESIDE_M
    return (robot_x + off * y, robot_y - off * x), (robot_x - off * y, robot_y + off * x)


def _toward(begin: Point, end: Point) -> Point:
    """Return the unit vector from one point to another; zero if they are equal."""
    apart = math.dist(begin, end) or 1.0
    return (end[0] - begin[0]) / apart, (end[1] - begin[1]) / apart


def _along(begin: Point, end: Point, share: float) -> Point:
    """Return the point at this share of the straight line from one point to another."""
    return begin[0] + share * (end[0] - begin[0]), begin[1] + share * (end[1] - begin[1])
