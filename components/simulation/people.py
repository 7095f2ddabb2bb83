"""People who walk from place to place, and let a robot pass."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from components.simulation.world_file import Person

# They stop for a robot this near ahead of them [m], and never come nearer to it than that [m].
_AHEAD_M, _NEAR_M = 0.6, 0.1
# Who has waited so long for a robot turns round [s].
_PATIENCE_S = 4.0


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

    def step(self, seconds: float, robot: tuple[float, float], robot_radius: float) -> None:
        """Walk on for some seconds; `robot` is where the robot is [m]."""
        person = self.person
        places = person.waypoints
        if self.paused_s > 0.0:
            self.paused_s -= seconds
            return
        x, y = places[self.goal]
        left = math.hypot(x - self.x, y - self.y)
        far = person.speed * seconds
        if left <= max(far, 1e-9):
            if not self._free(x, y, robot, robot_radius):
                return
            self.x, self.y = x, y
            self._turn_to_next()
            self.paused_s = person.pause
            return
        ahead = ((x - self.x) / left, (y - self.y) / left)
        to_robot = (robot[0] - self.x, robot[1] - self.y)
        apart = math.hypot(*to_robot)
        in_front = ahead[0] * to_robot[0] + ahead[1] * to_robot[1] > 0.5 * apart
        if in_front and apart < person.radius + robot_radius + _AHEAD_M:
            self.blocked_s += seconds
            if self.blocked_s > _PATIENCE_S:
                self.blocked_s = 0.0
                self.backwards = not self.backwards
                self._turn_to_next()
            return
        self.blocked_s = 0.0
        new_x, new_y = self.x + ahead[0] * far, self.y + ahead[1] * far
        if self._free(new_x, new_y, robot, robot_radius):
            self.x, self.y = new_x, new_y

    def _free(self, x: float, y: float, robot: tuple[float, float], robot_radius: float) -> bool:
        """Whether a place is clear of the robot, or at least no nearer to it than this one."""
        apart = math.hypot(x - robot[0], y - robot[1])
        now = math.hypot(self.x - robot[0], self.y - robot[1])
        return apart > self.person.radius + robot_radius + _NEAR_M or apart > now

    def _turn_to_next(self) -> None:
        step = -1 if self.backwards else 1
        self.goal = (self.goal + step) % len(self.person.waypoints)


def circles_of(walkers: list[Walker]) -> NDArray[np.float64]:
    """x, y, radius (k, 3) [m] of all."""
    rows = [(walker.x, walker.y, walker.person.radius) for walker in walkers]
    return np.array(rows, np.float64).reshape(-1, 3)
