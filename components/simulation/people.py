"""People who walk from place to place, and let a robot pass."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from components.simulation.rays import clearance
from components.simulation.world_file import Person

Array = NDArray[np.float64]

# They stop for a robot this near ahead of them [m], and never come nearer to it than that [m].
_AHEAD_M, _NEAR_M = 0.6, 0.1
# Who has waited so long for a robot, or before something in the way, turns round [s].
_PATIENCE_S = 4.0
_NOBODY = np.zeros((0, 3))


@dataclass
class Walker:
    """A person under way: where they are, where they go, what they wait for."""

    person: Person
    x: float
    y: float
    goal: int = 0
    paused_s: float = 0.0
    blocked_s: float = 0.0
    backwards: bool = False

    @staticmethod
    def of(person: Person) -> Walker:
        """The person at their first place."""
        x, y = person.waypoints[0]
        return Walker(person, x, y)

    def step(
        self, seconds: float, robot: tuple[float, float], robot_radius: float, segments: Array
    ) -> None:
        """Walk on for some seconds; `robot` is where the robot is [m], `segments` what stands."""
        if self.paused_s > 0.0:
            self.paused_s -= seconds
            return
        x, y = self.person.waypoints[self.goal]
        left, far = math.hypot(x - self.x, y - self.y), self.person.speed * seconds
        arrives = left <= max(far, 1e-9)
        if not arrives:
            ahead = ((x - self.x) / left, (y - self.y) / left)
            x, y = self.x + ahead[0] * far, self.y + ahead[1] * far
            if self._meets(ahead, robot, robot_radius):
                self._wait(seconds)
                return
        if not self._free(x, y, robot, robot_radius, segments):
            self._wait(seconds)
            return
        self.blocked_s = 0.0
        self.x, self.y = x, y
        if arrives:
            self.paused_s = self.person.pause
            self._turn_to_next()

    def _meets(
        self, ahead: tuple[float, float], robot: tuple[float, float], robot_radius: float
    ) -> bool:
        """Whether the robot is close by, in the direction in which they walk."""
        to_robot = (robot[0] - self.x, robot[1] - self.y)
        apart = math.hypot(*to_robot)
        in_front = ahead[0] * to_robot[0] + ahead[1] * to_robot[1] > 0.5 * apart
        return in_front and apart < self.person.radius + robot_radius + _AHEAD_M

    def _free(
        self,
        x: float,
        y: float,
        robot: tuple[float, float],
        robot_radius: float,
        segments: Array,
    ) -> bool:
        """Whether a place is clear of the robot and of what stands, or clearer than this one."""
        apart = math.hypot(x - robot[0], y - robot[1])
        if apart <= self.person.radius + robot_radius + _NEAR_M and apart <= math.hypot(
            self.x - robot[0], self.y - robot[1]
        ):
            return False
        room, _ = clearance(x, y, segments, _NOBODY)
        return room >= self.person.radius or room > clearance(self.x, self.y, segments, _NOBODY)[0]

    def _wait(self, seconds: float) -> None:
        self.blocked_s += seconds
        if self.blocked_s > _PATIENCE_S:
            self.blocked_s = 0.0
            self.backwards = not self.backwards
            self._turn_to_next()

    def _turn_to_next(self) -> None:
        step = -1 if self.backwards else 1
        self.goal = (self.goal + step) % len(self.person.waypoints)


def circles_of(walkers: list[Walker]) -> Array:
    """x, y, radius (k, 3) [m] of all."""
    rows = [(walker.x, walker.y, walker.person.radius) for walker in walkers]
    return np.array(rows, np.float64).reshape(-1, 3)
