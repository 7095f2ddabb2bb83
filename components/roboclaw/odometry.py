"""Where the wheels have led: exact arcs added up, and how far that is to be trusted."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import Pose, compose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OdometryErrors:
    """Standard deviations of random walks along the way, which the covariance grows by."""

    way: float
    """[m/sqrt(m)]"""
    turn: float
    """[rad/sqrt(rad)]"""
    turn_per_meter: float
    """[rad/sqrt(m)]"""


class RecentSpeed:
    """The mean speed over the last moments.

    Nobody knows to the millisecond when encoders were read; over a few readings that is less of it.
    """

    def __init__(self, span_s: float = 0.06) -> None:
        """`span_s`: at least so long a time is averaged over, if there was one [s]."""
        self._span_s = span_s
        self._steps: deque[tuple[float, float, float]] = deque()

    def add(self, seconds: float, way: float, turned: float) -> tuple[float, float]:
        """Take a step in; the speeds [m/s, rad/s]."""
        steps = self._steps
        steps.append((seconds, way, turned))
        while sum(step[0] for step in steps) - steps[0][0] >= self._span_s:
            steps.popleft()
        time = sum(step[0] for step in steps) or 1.0
        return sum(step[1] for step in steps) / time, sum(step[2] for step in steps) / time


class WheelOdometry:
    """Dead reckoning from the ways of both wheels."""

    def __init__(self, errors: OdometryErrors) -> None:
        self._errors = errors
        self.pose: Pose = (0.0, 0.0, 0.0)
        self.covariance: Array = np.zeros((3, 3))
        """Over x, y [m], heading [rad]."""

    def add(self, way: float, turned: float) -> None:
        """Add a step: `way` [m] along an arc that turns by `turned` [rad].

        The chord of the arc is `way` sin(h)/h long, with h half the turn, and leaves at angle h.
        """
        if not (way or turned):
            return
        half = 0.5 * turned
        chord = way * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
        self._spread(chord, half, way, turned)
        along = (chord * math.cos(half), chord * math.sin(half), turned)
        self.pose = compose(self.pose, along)

    def _spread(self, chord: float, half: float, way: float, turned: float) -> None:
        """Propagate the covariance to first order."""
        errors = self._errors
        middle = self.pose[2] + half
        cosine, sine = math.cos(middle), math.sin(middle)
        of_pose = np.eye(3)
        of_pose[0, 2], of_pose[1, 2] = -chord * sine, chord * cosine
        of_step = np.array([[cosine, -0.5 * chord * sine], [sine, 0.5 * chord * cosine], [0, 1]])
        way_variance = errors.way**2 * abs(way)
        turn_variance = errors.turn**2 * abs(turned) + errors.turn_per_meter**2 * abs(way)
        noise = (of_step * (way_variance, turn_variance)) @ of_step.T
        self.covariance = of_pose @ self.covariance @ of_pose.T + noise
