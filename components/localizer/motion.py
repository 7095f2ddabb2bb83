"""How commanded velocities move a cloud of poses: a lagging, falling-short, noisy base."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Poses = NDArray[np.float64]


@dataclass(frozen=True)
class MotionModel:
    """What the base makes of a command.

    `lag_s` [s]: the base follows a command this much later. `forward_gain`, `turn_gain` [1]:
    share of the commanded motion that the base performs. `forward_noise` [m/sqrt(s)] and
    `turn_noise` [rad/sqrt(s)]: random walk while the base is commanded to move.
    `forward_slip` [m/sqrt(m)] and `turn_slip` [rad/sqrt(rad)]: random walk per motion performed.
    """

    lag_s: float = 0.17
    forward_gain: float = 0.95
    turn_gain: float = 0.93
    forward_noise: float = 0.025
    turn_noise: float = 0.04
    forward_slip: float = 0.016
    turn_slip: float = 0.03


@dataclass(frozen=True)
class Increment:
    """Commanded motion over a stretch of time: metres ahead, radians left, seconds in motion."""

    ahead: float
    turned: float
    moving_s: float


class OdometryTrack:
    """The commanded velocities as a function of time, each held until the next one.

    Holds what has not been integrated yet. Times are seconds on the recording's clock; a
    command given at t acts from t + lag on.
    """

    def __init__(self, lag_s: float) -> None:
        self.lag_s = lag_s
        self._pending: deque[tuple[float, float, float]] = deque()
        self._speed = (0.0, 0.0)
        self.integrated_to = -math.inf
        self.latest = -math.inf

    def append(self, stamp: float, forward: float, turn: float) -> bool:
        """Take the command of time `stamp` [s]; False if it is older than the newest one."""
        if stamp < self.latest:
            return False
        self.latest = stamp
        self._pending.append((stamp + self.lag_s, forward, turn))
        return True

    def bridge(self, stamp: float, step: tuple[float, float, float]) -> None:
        """Let the base move by `step` (x ahead, y left [m], turn [rad]) from the newest to `stamp`.

        For odometry that was missed: as one arc at constant speed instead of the held command.
        """
        gap = stamp - self.latest
        ahead = math.copysign(math.hypot(step[0], step[1]), step[0])
        self._pending.append((self.latest + self.lag_s, ahead / gap, step[2] / gap))

    def advance(self, stamp: float) -> Increment:
        """Integrate the commands from where integration stands to `stamp` [s]."""
        increment, self._speed, taken = self._integrate(stamp)
        for _ in range(taken):
            self._pending.popleft()
        self.integrated_to = max(self.integrated_to, stamp)
        return increment

    def preview(self, stamp: float) -> Increment:
        """The motion `advance(stamp)` would return, without taking it."""
        return self._integrate(stamp)[0]

    def _integrate(self, stamp: float) -> tuple[Increment, tuple[float, float], int]:
        # Before the first command nothing is known to move.
        now = stamp if self.integrated_to == -math.inf else self.integrated_to
        forward, turn = self._speed
        ahead = turned = moving = 0.0
        taken = 0
        for begins, next_forward, next_turn in self._pending:
            if begins > stamp:
                break
            if begins > now:
                step = begins - now
                ahead += forward * step
                turned += turn * step
                if forward or turn:
                    moving += step
                now = begins
            forward, turn = next_forward, next_turn
            taken += 1
        if stamp > now:
            step = stamp - now
            ahead += forward * step
            turned += turn * step
            if forward or turn:
                moving += step
        return Increment(ahead, turned, moving), (forward, turn), taken


def move_pose(
    pose: tuple[float, float, float], step: Increment, model: MotionModel
) -> tuple[float, float, float]:
    """The expected pose (x [m], y [m], theta [rad]) after `step`, along one arc."""
    x, y, theta = pose
    ahead = model.forward_gain * step.ahead
    turned = model.turn_gain * step.turned
    chord = theta + 0.5 * turned
    return x + ahead * math.cos(chord), y + ahead * math.sin(chord), theta + turned


def move_cloud(
    poses: Poses, step: Increment, model: MotionModel, random: np.random.Generator
) -> None:
    """Move every pose of `poses` (3, ...) in place by `step` with noise of its own."""
    if step.moving_s <= 0.0:
        return
    noise = random.standard_normal((2, *poses.shape[1:]))
    forward_sd = math.sqrt(
        model.forward_noise**2 * step.moving_s + model.forward_slip**2 * abs(step.ahead)
    )
    turn_sd = math.sqrt(model.turn_noise**2 * step.moving_s + model.turn_slip**2 * abs(step.turned))
    ahead = model.forward_gain * step.ahead + forward_sd * noise[0]
    turned = model.turn_gain * step.turned + turn_sd * noise[1]
    chord = poses[2] + 0.5 * turned
    poses[0] += ahead * np.cos(chord)
    poses[1] += ahead * np.sin(chord)
    poses[2] += turned
