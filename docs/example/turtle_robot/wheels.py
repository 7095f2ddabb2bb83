"""Simulation of the turtle's wheels and pen: plain arithmetic without bus, clock or files."""

import math

import numpy as np
from cairn import CairnError


class WheelJamError(CairnError):
    """A wheel is stuck until its controller is restarted."""


class Wheels:
    """A base with two wheels that starts in the middle of a square pen [m, rad]."""

    def __init__(self, pen_m: float, jams_per_m: float, random: np.random.Generator) -> None:
        self.x = self.y = self.theta = 0.0
        self.charge = 1.0
        self.blocked = False
        self._reach_m = pen_m / 2
        self._jams_per_m = jams_per_m
        self._random = random

    def advance(self, seconds: float, forward: float, turn: float, used_per_m: float) -> None:
        """Move at `forward` [m/s] and `turn` [rad/s]; raise `WheelJamError` at random."""
        step_m = forward * seconds * self._random.normal(1.0, 0.02)
        if self._random.random() < self._jams_per_m * abs(step_m):
            raise WheelJamError("the left wheel has jammed")
        self.theta = math.remainder(self.theta + turn * seconds, math.tau)
        x = self.x + step_m * math.cos(self.theta)
        y = self.y + step_m * math.sin(self.theta)
        self.blocked = max(abs(x), abs(y)) > self._reach_m
        if not self.blocked:
            self.x, self.y = x, y
            self.charge = max(0.0, self.charge - used_per_m * abs(step_m))
        if forward == 0.0 == turn:
            self.charge = min(1.0, self.charge + 0.1 * seconds)  # the sun charges it
