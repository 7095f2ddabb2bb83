"""Wheel odometry: poses from the distances that encoders count, their covariance, and speeds."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import Pose, compose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WheelStep:
    """The motion of the base between two readings of the encoders."""

    at: float
    """Time of the second reading [s of the monotonic clock]."""
    stamp: int
    """The same by the system's clock, which all devices share [ns]."""
    seconds: float
    distance: float
    """[m]"""
    turn: float
    """[rad]"""


@dataclass(frozen=True)
class OdometryNoise:
    """Standard deviations of the random walks by which the covariance grows with the motion."""

    distance: float
    """[m/sqrt(m)]"""
    turn: float
    """[rad/sqrt(rad)]"""
    turn_per_meter: float
    """[rad/sqrt(m)]"""


class SpeedAverage:
    """The mean speed over the last few steps.

    The time of an encoder reading is uncertain by milliseconds; over several readings this matters
    less.
    """

    def __init__(self, span_s: float = 0.06) -> None:
        """`span_s`: shortest time to average over, if so much has passed [s]."""
        self._span_s = span_s
        self._steps: deque[tuple[float, float, float]] = deque()

    def add(self, seconds: float, distance: float, turn: float) -> tuple[float, float]:
        """Add a step, and return the mean speeds [m/s, rad/s]."""
        steps = self._steps
        steps.append((seconds, distance, turn))
        while sum(step[0] for step in steps) - steps[0][0] >= self._span_s:
            steps.popleft()
        time = sum(step[0] for step in steps) or 1.0
        return sum(step[1] for step in steps) / time, sum(step[2] for step in steps) / time


class WheelOdometry:
    """Integrates steps of the base to its pose in frame `odom`, with a covariance."""

    def __init__(self, noise: OdometryNoise) -> None:
        self._noise = noise
        self.pose: Pose = (0.0, 0.0, 0.0)
        self.covariance: Array = np.zeros((3, 3))
        """Of x, y [m], heading [rad]."""

    def add(self, distance: float, turn: float) -> None:
        """Add a step: `distance` [m] along an arc that turns by `turn` [rad].

        The chord of the arc has length `distance` sin(h)/h, where h is half the turn, and starts at
        the angle h.
        """
        if not (distance or turn):
            return
        half = 0.5 * turn
        chord = distance * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
        self._propagate(chord, half, distance, turn)
        step = (chord * math.cos(half), chord * math.sin(half), turn)
        self.pose = compose(self.pose, step)

    def _propagate(self, chord: float, half: float, distance: float, turn: float) -> None:
        """Propagate the covariance to first order."""
        noise = self._noise
        middle = self.pose[2] + half
        cosine, sine = math.cos(middle), math.sin(middle)
        by_pose = np.eye(3)
        by_pose[0, 2], by_pose[1, 2] = -chord * sine, chord * cosine
        by_step = np.array([[cosine, -0.5 * chord * sine], [sine, 0.5 * chord * cosine], [0, 1]])
        distance_variance = noise.distance**2 * abs(distance)
        turn_variance = noise.turn**2 * abs(turn) + noise.turn_per_meter**2 * abs(distance)
        added = (by_step * (distance_variance, turn_variance)) @ by_step.T
        self.covariance = by_pose @ self.covariance @ by_pose.T + added
