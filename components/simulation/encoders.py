"""What the wheels measure of their own motion: dead reckoning, and how far it is to be trusted."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.planar.poses import Pose, compose

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EncoderErrors:
    """Standard deviations of what the wheels measure.

    `way_scale`, `turn_scale` [1] of the scales, which are drawn once; random walks `way`
    [m/sqrt(m)], `turn` [rad/sqrt(rad)] and `turn_per_meter` [rad/sqrt(m)].
    """

    way_scale: float
    turn_scale: float
    way: float
    turn: float
    turn_per_meter: float


class Encoders:
    """The pose that the wheels measure, added up step by step, and its covariance."""

    def __init__(self, errors: EncoderErrors, random: np.random.Generator) -> None:
        self._errors = errors
        self._random = random
        drawn = random.standard_normal(2)
        self._scales = (
            1.0 + errors.way_scale * float(drawn[0]),
            1.0 + errors.turn_scale * float(drawn[1]),
        )
        self.pose: Pose = (0.0, 0.0, 0.0)
        # Over x, y, heading and the two errors of scale, which stay what they are.
        self._full = np.diag([0.0, 0.0, 0.0, errors.way_scale**2, errors.turn_scale**2])

    @property
    def covariance(self) -> Array:
        """Of the pose: (3, 3) over x, y [m], heading [rad]."""
        return self._full[:3, :3]

    def speeds(self, forward: float, turn: float) -> tuple[float, float]:
        """The speeds measured [m/s, rad/s] while the wheels really turn at these."""
        return self._scales[0] * forward, self._scales[1] * turn

    def measure(self, way: float, turned: float) -> None:
        """Add up a step of the wheels: `way` [m] along an arc that turns by `turned` [rad]."""
        if not (way or turned):
            return
        errors = self._errors
        noise = self._random.standard_normal(2)
        way_variance = errors.way**2 * abs(way)
        turn_variance = errors.turn**2 * abs(turned) + errors.turn_per_meter**2 * abs(way)
        seen_way = self._scales[0] * way + math.sqrt(way_variance) * float(noise[0])
        seen_turn = self._scales[1] * turned + math.sqrt(turn_variance) * float(noise[1])
        self._spread(seen_way, seen_turn, way_variance, turn_variance)
        half = (0.0, 0.0, 0.5 * seen_turn)
        self.pose = compose(compose(compose(self.pose, half), (seen_way, 0.0, 0.0)), half)

    def _spread(self, way: float, turned: float, way_variance: float, turn_variance: float) -> None:
        """Propagate the covariance to first order."""
        middle = self.pose[2] + 0.5 * turned
        cosine, sine = math.cos(middle), math.sin(middle)
        # How way and turn of this step act on the pose.
        acts = np.array([[cosine, -0.5 * way * sine], [sine, 0.5 * way * cosine], [0.0, 1.0]])
        step = np.eye(5)
        step[0, 2], step[1, 2] = -way * sine, way * cosine
        step[:3, 3:] = acts * (way, turned)
        self._full = step @ self._full @ step.T
        self._full[:3, :3] += (acts * (way_variance, turn_variance)) @ acts.T
