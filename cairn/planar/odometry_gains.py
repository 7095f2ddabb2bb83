"""Estimates while the robot drives how far it moves when odometry states a motion."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cairn.planar.motion_model import MotionModel, OdometryStep, move_pose, odometry_step
from cairn.planar.poses import Pose, wrap

Array = NDArray[np.float64]

AS_CONFIGURED, AS_MAPPED = 0.1, 0.05
"""How far gains usually are from 1: as a base is configured, and when a map was made with it."""

SHOWN_M = 0.05
"""A scan shows a position that it leaves uncertain by less than this in any direction [m]."""

# Directions [1] in which it is asked, and headings [rad] that the pose may have there instead.
_DIRECTIONS, _TURNED = 8, (-0.05, -0.025, 0.0, 0.025, 0.05)
# How far a veer usually is from 0 [rad/m].
_USUAL_VEER = 0.01
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

    @property
    def is_turned(self) -> bool:
        """Whether it is long enough to measure turns."""
        return abs(self.stated) >= _TURN_RAD or self.way_m >= _LONGEST_M

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
    lags behind. Between its ends, scans need not show the position, if the map is not made of them.

    Attributes:
        forward: distance driven per distance of odometry [1].
        turn: angle turned per angle of odometry [1], and per distance [rad/m]: a base whose wheels
            differ veers.
        uncertain: how many times as far as the model says the motion was off lately [1], at
            least 1.

    """

    def __init__(self, model: MotionModel, usual: float) -> None:
        """Start with odometry that is right.

        Args:
            model: its uncertainty besides the gains.
            usual: how far gains usually are from 1.

        """
        self.forward, self.turn = np.array([1.0]), np.array([1.0, 0.0])
        self._forward_known = np.diag([usual**2])
        self._turn_known = np.diag([usual**2, _USUAL_VEER**2])
        self.uncertain = 1.0
        self._off = 1.0  # mean of the squares, in variances
        self._model = model
        self._stated: Pose = (0.0, 0.0, 0.0)  # the motion by odometry since the newest pose
        self._has_scans, self._hidden_m = False, 0.0  # the way since one showed the position
        self._straight: _Stretch | None = None
        self._turning: _Stretch | None = None

    @property
    def deviations(self) -> tuple[float, float, float]:
        """The standard deviations of the gain of distances, that of turns, and of the veer."""
        variances = (*np.diag(self._forward_known).tolist(), *np.diag(self._turn_known).tolist())
        forward, turn, veer = (math.sqrt(value) for value in variances)
        return forward, turn, veer

    def corrected(self, step: OdometryStep) -> OdometryStep:
        """Return a step of odometry as the robot moved, by the gains.

        The error of a gain has the same sign on all of the way on which no scan shows the position:
        its variance grows with the square of that way. Without scans it is not counted, as objects
        show the position.
        """
        forward, way = float(self.forward[0]), self._hidden_m
        squares = (way + math.hypot(step.ahead, step.aside)) ** 2 - way**2 if self._has_scans else 0
        gain, veer = self.turn.tolist()
        return replace(
            step,
            ahead=forward * step.ahead,
            aside=forward * step.aside,
            turned=gain * step.turned + veer * step.ahead,
            uncertain=self.uncertain,
            gain_m=math.sqrt(squares * float(self._forward_known[0, 0])),
        )

    def move(self, step: OdometryStep) -> OdometryStep:
        """Add a step of odometry; return it as the robot moved."""
        moved = self.corrected(step)
        self._stated = move_pose(self._stated, step)
        if self._has_scans:
            self._hidden_m += math.hypot(step.ahead, step.aside)
        return moved

    def interrupt(self) -> None:
        """End the stretch without a measurement: something else than motion changed the pose.

        How uncertain it is then does not follow from the way before.
        """
        self._straight = self._turning = None
        self._hidden_m = 0.0

    def add(self, pose: Pose, *, shown: bool) -> bool:
        """Add the pose at a scan, after the steps so far; `shown`: it shows all of the position.

        Return whether the gains may have changed.
        """
        self._has_scans = True
        step, self._stated = odometry_step(self._stated), (0.0, 0.0, 0.0)
        if shown:
            self._hidden_m = 0.0
        straight, turning = self._straight, self._turning
        if straight is None or turning is None:
            if shown:
                self._straight, self._turning = _Stretch(pose, pose), _Stretch(pose, pose)
            return False
        straight.extend(step, pose)
        turning.extend(step, pose)
        is_long, is_turned = straight.way_m >= _LONGEST_M, turning.is_turned
        if shown and is_long:
            self._measure_forward(straight)
            self._straight = _Stretch(pose, pose)
        if shown and is_turned:
            self._measure_turn(turning)
            self._turning = _Stretch(pose, pose)
        return shown and (is_long or is_turned)

    def conclude(self) -> bool:
        """End the stretch where scans showed the position last; return whether gains may have
        changed.
        """
        straight, turning = self._straight, self._turning
        self.interrupt()
        if straight is None or turning is None:
            return False
        self._measure_forward(straight)
        self._measure_turn(turning)
        return True

    def _measure_forward(self, stretch: _Stretch) -> None:
        stated = math.hypot(stretch.x, stretch.y)
        if stated >= _LEAST_M:
            x, y = stretch.last[0] - stretch.begin[0], stretch.last[1] - stretch.begin[1]
            sd = math.hypot(_END_M, self._model.deviations(stretch.sums)[0])
            along = (stretch.x * x + stretch.y * y) / stated
            self._measure(self.forward, self._forward_known, np.array([stated]), along, sd)

    def _measure_turn(self, stretch: _Stretch) -> None:
        if abs(stretch.stated) >= _LEAST_RAD or stretch.way_m >= _LEAST_M:
            sd = math.hypot(_END_RAD, self._model.deviations(stretch.sums)[2])
            by = np.array([stretch.stated, stretch.ahead])
            self._measure(self.turn, self._turn_known, by, stretch.turned, sd)

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


def shows_position(log_likelihood: Callable[[Array], Array], pose: Pose) -> bool:
    """Return whether a scan shows the position, near which `pose` is, whatever the heading is.

    The best position within `SHOWN_M` is then more likely than all those three times as far away,
    as if they were two standard deviations from it. `log_likelihood` returns that of the scan (n,)
    at poses (3, n).
    """
    directions = np.linspace(-math.pi, math.pi, _DIRECTIONS, endpoint=False)
    around, turned, far = np.meshgrid(directions, _TURNED, (0.0, SHOWN_M, 3.0 * SHOWN_M))
    x, y = pose[0] + far * np.cos(around), pose[1] + far * np.sin(around)
    found = log_likelihood(np.stack((x.ravel(), y.ravel(), pose[2] + turned.ravel())))
    is_far = far.ravel() > SHOWN_M
    return bool(found[~is_far].max() - found[is_far].max() > 0.5 * 2.0**2)
