"""Odometry as motion: what it states between any two times, and how it moves particles."""

from __future__ import annotations

import math
from bisect import insort
from dataclasses import replace
from itertools import takewhile
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cairn.planar.compiled import compiled
from cairn.planar.motion_model import MotionModel, OdometryStep, odometry_step
from cairn.planar.odometry import (
    FASTEST_WHEELS,
    ODOMETRY_DISORDER_S,
    OUTDATED_IN_A_ROW,
    OdometryChange,
    OdometryHistory,
    WheelLimits,
)
from cairn.planar.poses import Pose, relative, wrap

Array = NDArray[np.float64]


def move_particles(
    poses: Array, step: OdometryStep, model: MotionModel, random: np.random.Generator
) -> None:
    """Move every pose of the contiguous `poses` (3, ...) in place by `step`, each with noise."""
    if step.moving_s <= 0.0:
        return
    flat = poses.reshape(3, -1)
    noise = random.standard_normal(flat.shape)
    _move(flat, noise, step.ahead, step.aside, step.turned, *model.deviations(step))


@compiled(
    "void(float64[:, ::1], float64[:, ::1], float64, float64, float64, float64, float64, float64)"
)
def _move(
    poses: Array,
    noise: Array,
    ahead: float,
    aside: float,
    turned: float,
    ahead_sd: float,
    aside_sd: float,
    turn_sd: float,
) -> None:
    for i in range(poses.shape[1]):
        far = ahead + ahead_sd * noise[0, i]
        left = aside + aside_sd * noise[1, i]
        turn = turned + turn_sd * noise[2, i]
        chord = poses[2, i] + 0.5 * turn
        cosine, sine = math.cos(chord), math.sin(chord)
        poses[0, i] += far * cosine - left * sine
        poses[1, i] += far * sine + left * cosine
        poses[2, i] += turn


class OdometryTrack(Protocol):
    """The motion as a function of time [s], consumed piece by piece."""

    limits: WheelLimits | None
    integrated_to: float

    @property
    def latest(self) -> float:
        """The time of the newest record [s]; -inf before the first."""
        ...

    def add(self, stamp: float, pose: Pose, forward: float, turn: float) -> OdometryChange:
        """Add a record: pose in the odometry frame, velocities [m/s, rad/s]."""
        ...

    def advance(self, stamp: float) -> OdometryStep:
        """Return the motion from the time last advanced to until `stamp` [s]."""
        ...

    def preview(self, stamp: float) -> OdometryStep:
        """Return the motion that `advance(stamp)` would return, without consuming it."""
        ...


class CommandedTrack:
    """Odometry whose velocities are commands, each held until the next one.

    The base executes a command given at t from t + `lag_s` on, and performs the share
    `forward_gain`, `turn_gain` [1] of it. Over a gap longer than `gap_s` the pose is used instead.
    The default, 15 records at 10 Hz, was chosen by hand; half and double were not compared.
    """

    def __init__(
        self, lag_s: float, forward_gain: float = 1.0, turn_gain: float = 1.0, gap_s: float = 1.5
    ) -> None:
        self.lag_s = lag_s
        self.forward_gain, self.turn_gain = forward_gain, turn_gain
        self.gap_s = gap_s
        self.limits: WheelLimits | None = None
        self._history = OdometryHistory[float](
            ODOMETRY_DISORDER_S, resets_after=OUTDATED_IN_A_ROW, per_second=1.0
        )
        self._pending: list[tuple[float, float, float]] = []
        self._taken = -math.inf  # when the base began to execute the command that it executes
        self._speed = (0.0, 0.0)
        self.integrated_to = -math.inf

    @property
    def latest(self) -> float:
        """The time of the newest command [s]; -inf before the first."""
        newest = self._history.newest
        return -math.inf if newest is None else newest

    def add(self, stamp: float, pose: Pose, forward: float, turn: float) -> OdometryChange:
        """Add the command of `stamp` [s]; a late one counts from where it still has an effect."""
        latest = self.latest
        before = self._history.at(latest)
        change = self._history.add(stamp, pose)
        if change in (OdometryChange.OUTDATED, OdometryChange.RESET):
            return change
        if before is not None and stamp - latest > self.gap_s:
            gap = stamp - latest
            step = relative(before, pose)
            ahead = math.copysign(math.hypot(step[0], step[1]), step[0])
            self._pending.append((latest + self.lag_s, ahead / gap, step[2] / gap))
        if stamp + self.lag_s >= self._taken:
            command = (stamp + self.lag_s, forward, turn)
            insort(self._pending, command, key=lambda entry: entry[0])
        return change

    def advance(self, stamp: float) -> OdometryStep:
        """Return the motion performed from the time last advanced to until `stamp` [s]."""
        increment, self._speed, taken = self._integrate(stamp)
        if taken:
            self._taken = self._pending[taken - 1][0]
            del self._pending[:taken]
        self.integrated_to = max(self.integrated_to, stamp)
        return increment

    def preview(self, stamp: float) -> OdometryStep:
        """Return the motion that `advance(stamp)` would return, without consuming it."""
        return self._integrate(stamp)[0]

    def _integrate(self, stamp: float) -> tuple[OdometryStep, tuple[float, float], int]:
        # Before the first command the base is assumed to stand.
        now = stamp if self.integrated_to == -math.inf else self.integrated_to
        started = list(takewhile(lambda command: command[0] <= stamp, self._pending))
        speeds = [self._speed, *((forward, turn) for _, forward, turn in started)]
        ends = [*(starts for starts, _, _ in started), stamp]
        ahead = turned = moving = 0.0
        for (forward, turn), end in zip(speeds, ends, strict=True):
            if end > now:
                step, now = end - now, end
                ahead += forward * step
                turned += turn * step
                if forward or turn:
                    moving += step
        performed = OdometryStep(
            self.forward_gain * ahead, 0.0, self.turn_gain * turned, moving, measured=False
        )
        return performed, speeds[-1], len(started)


class MeasuredTrack:
    """Odometry whose poses the wheels measured; between two of them it is interpolated.

    A step that wheels cannot make is a jump: the driver was restarted. Jumps are left out. What a
    late record changes before the time advanced to counts in the next motion.
    """

    def __init__(self) -> None:
        self.limits: WheelLimits | None = FASTEST_WHEELS
        self._history = OdometryHistory[float](
            math.inf, self.limits, resets_after=OUTDATED_IN_A_ROW, per_second=1.0
        )
        self._reached: Pose | None = None  # without the jumps
        self.integrated_to = -math.inf

    @property
    def latest(self) -> float:
        """The time of the newest pose [s]; -inf before the first."""
        newest = self._history.newest
        return -math.inf if newest is None else newest

    def add(self, stamp: float, pose: Pose, forward: float, turn: float) -> OdometryChange:  # noqa: ARG002
        """Add the pose measured at `stamp` [s]."""
        change = self._history.add(stamp, pose)
        if change is OdometryChange.RESET:
            self._reached = None
        return change

    def advance(self, stamp: float) -> OdometryStep:
        """Return the motion from the time last advanced to until `stamp` [s]."""
        increment = self.preview(stamp)
        if stamp > self.integrated_to:
            self.integrated_to = stamp
            reached = self._at(stamp)
            self._reached = reached and (reached[0], reached[1], wrap(reached[2]))
        self._history.forget(self.integrated_to - ODOMETRY_DISORDER_S)
        return increment

    def preview(self, stamp: float) -> OdometryStep:
        """Return the motion that `advance(stamp)` would return, without consuming it."""
        start, end = self._reached or self._at(self.integrated_to), self._at(stamp)
        if self.integrated_to == -math.inf or stamp <= self.integrated_to:
            return OdometryStep(0.0, 0.0, 0.0, 0.0)
        if start is None or end is None:
            return OdometryStep(0.0, 0.0, 0.0, 0.0)
        increment = odometry_step(relative(start, end))
        moving = stamp - self.integrated_to if increment.moving_s else 0.0
        return replace(increment, moving_s=moving)

    def _at(self, stamp: float) -> Pose | None:
        return None if self._history.newest is None else self._history.driven_at(stamp)
