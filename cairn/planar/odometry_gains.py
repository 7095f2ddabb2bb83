"""Estimates while the robot drives how far it moves when odometry states a motion."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cairn.planar.motion_model import MotionModel, OdometryStep
from cairn.planar.poses import Pose, wrap

Array = NDArray[np.float64]

SHOWN_M = 0.05
"""A scan shows a position that it leaves uncertain by less than this in any direction [m]."""

# How far gains usually are from 1, and a veer from 0 [rad/m].
_USUAL, _USUAL_VEER = 0.1, 0.01
# Gains are measured over stretches of the way whose ends are known up to this [m], [rad]: each ends
# after so much motion [m], that for turns also after so large a turn [rad]. Shorter ones than these
# [m], [rad] say little. What is off by more than so many deviations shows wheels that slipped.
_END_M, _END_RAD, _LONGEST_M, _TURN_RAD, _LEAST_M, _LEAST_RAD = 0.03, 0.01, 10.0, 1.0, 0.5, 0.5
_SLIPPED = 3.0
# Weight of the newest stretch in the mean of how far predictions were off, and the largest square
# of a deviation that counts in it.
_NEWEST, _MOST_OFF = 0.1, 25.0


@dataclass
class _Stretch:
    """A stretch of the way on which scans show the position.

    Attributes:
        begin: pose at its begin.
        last: pose at its end so far.
        x, y: the motion by odometry, with the headings that scans show [m].
        ahead: the distance by odometry, forward [m].
        stated: the turn by odometry [rad].
        turned: the turn that scans show [rad].
        sums: of forward and sideways motion [m], turns [rad] and time in motion [s].

    """

    begin: Pose
    last: Pose
    x: float = 0.0
    y: float = 0.0
    ahead: float = 0.0
    stated: float = 0.0
    turned: float = 0.0
    sums: OdometryStep = field(default_factory=lambda: OdometryStep(0.0, 0.0, 0.0, 0.0))

    @property
    def way_m(self) -> float:
        return self.sums.ahead + self.sums.aside

    def extend(self, step: OdometryStep, pose: Pose) -> None:
        turn = wrap(pose[2] - self.last[2])
        heading = self.last[2] + 0.5 * turn
        cosine, sine = math.cos(heading), math.sin(heading)
        self.x += cosine * step.ahead - sine * step.aside
        self.y += sine * step.ahead + cosine * step.aside
        self.ahead += step.ahead
        self.stated += step.turned
        self.turned += turn
        self.last = pose
        self.sums = OdometryStep(
            self.sums.ahead + abs(step.ahead),
            self.sums.aside + abs(step.aside),
            self.sums.turned + abs(step.turned),
            self.sums.moving_s + step.moving_s,
            step.measured,
            self.sums.uncertain,
        )


class GainEstimator:
    """Compares odometry with the motion that scans show, over stretches of the way.

    What shifts both ends of a stretch alike has no effect: a map that is inexact, or a pose that
    lags behind.

    Attributes:
        forward: distance driven per distance of odometry [1].
        turn: angle turned per angle of odometry [1], and per distance [rad/m]: a base whose wheels
            differ veers.
        uncertain: how many times as far as the model says the motion was off lately [1], at
            least 1.

    """

    def __init__(self, model: MotionModel) -> None:
        """Start with odometry that is right; `model` is its uncertainty besides the gains."""
        self.forward, self.turn = np.array([1.0]), np.array([1.0, 0.0])
        self._forward_known = np.diag([_USUAL**2])
        self._turn_known = np.diag([_USUAL**2, _USUAL_VEER**2])
        self.uncertain = 1.0
        self._off = 1.0  # mean of the squares, in variances
        self._model = model
        self._straight: _Stretch | None = None
        self._turning: _Stretch | None = None

    @property
    def deviations(self) -> tuple[float, float, float]:
        """The standard deviations of the gain of distances, that of turns, and of the veer."""
        variances = (*np.diag(self._forward_known).tolist(), *np.diag(self._turn_known).tolist())
        forward, turn, veer = (math.sqrt(value) for value in variances)
        return forward, turn, veer

    def corrected(self, step: OdometryStep) -> OdometryStep:
        """Return a step of odometry as the robot moved, by the gains."""
        forward = float(self.forward[0])
        gain, veer = self.turn.tolist()
        return replace(
            step,
            ahead=forward * step.ahead,
            aside=forward * step.aside,
            turned=gain * step.turned + veer * step.ahead,
            uncertain=self.uncertain,
        )

    def interrupt(self) -> None:
        """End the stretch without a measurement: something else than motion changed the pose."""
        self._straight = self._turning = None

    def add(self, step: OdometryStep, pose: Pose, shown: bool) -> bool:
        """Add a step of odometry, and the pose after it; `shown`: a scan shows all of its position.

        Return whether the gains may have changed.
        """
        new = _Stretch(pose, pose) if shown else None
        straight, turning = self._straight, self._turning
        if straight is None or turning is None:
            self._straight, self._turning = new, new and replace(new)
            return False
        if shown:
            straight.extend(step, pose)
            turning.extend(step, pose)
        is_long = straight.way_m >= _LONGEST_M
        is_turned = abs(turning.stated) >= _TURN_RAD or turning.way_m >= _LONGEST_M
        if not shown or is_long:
            self._straight = new
            stated = math.hypot(straight.x, straight.y)
            if stated >= _LEAST_M:
                x, y = straight.last[0] - straight.begin[0], straight.last[1] - straight.begin[1]
                sd = math.hypot(_END_M, self._model.deviations(straight.sums)[0])
                along = (straight.x * x + straight.y * y) / stated
                self._measure(self.forward, self._forward_known, np.array([stated]), along, sd)
        if not shown or is_turned:
            self._turning = new and replace(new)
            if abs(turning.stated) >= _LEAST_RAD or turning.way_m >= _LEAST_M:
                sd = math.hypot(_END_RAD, self._model.deviations(turning.sums)[2])
                by = np.array([turning.stated, turning.ahead])
                self._measure(self.turn, self._turn_known, by, turning.turned, sd)
        return not shown or is_long or is_turned

    def _measure(
        self, values: Array, known: Array, by: Array, measured: float, deviation: float
    ) -> None:
        """Correct values (n,) of the covariance `known` (n, n), in place, by their sum times
        `by`.
        """
        across = known @ by
        error = measured - float(by @ values)
        off = error**2 / (float(by @ across) + deviation**2)
        self._off += _NEWEST * (min(off, _MOST_OFF) - self._off)
        self.uncertain = math.sqrt(max(1.0, self._off))
        variance = float(by @ across) + (self.uncertain * deviation) ** 2
        if error**2 < _SLIPPED**2 * variance:
            values += across * (error / variance)
            known -= np.outer(across, across) / variance
