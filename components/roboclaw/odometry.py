"""Where the wheels have led: exact arcs added up, and how far that is to be trusted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planar.poses import Pose, compose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OdometryErrors:
    """Standard deviations of random walks along the way, which the covariance grows by."""

    way: float
    """[m/sqrt(m)]"""
    turn: float
    """[rad/sqrt(rad)]"""
    turn_per_metre: float
    """[rad/sqrt(m)]"""


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
        turn_variance = errors.turn**2 * abs(turned) + errors.turn_per_metre**2 * abs(way)
        noise = (of_step * (way_variance, turn_variance)) @ of_step.T
        self.covariance = of_pose @ self.covariance @ of_pose.T + noise
