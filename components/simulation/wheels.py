"""A differential base: how its wheels follow commands, and what they measure."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from planar.poses import Pose, compose


@dataclass(frozen=True)
class BaseLimits:
    """Limits [m/s, rad/s, m/s^2, rad/s^2], delay of a command [s], and how long it holds [s]."""

    speed: float = 0.6
    turn: float = 1.5
    acceleration: float = 0.8
    turn_acceleration: float = 3.0
    lag_s: float = 0.05
    command_timeout_s: float = 0.3


@dataclass(frozen=True)
class EncoderErrors:
    """Errors of scale [1], and random walks [m/sqrt(m)], [rad/sqrt(rad)], [rad/sqrt(m)]."""

    way_scale: float
    turn_scale: float
    way: float
    turn: float
    turn_per_metre: float


class Wheels:
    """Velocities that the wheels have; the pose and its uncertainty as they measure it."""

    def __init__(
        self, limits: BaseLimits, errors: EncoderErrors, random: np.random.Generator
    ) -> None:
        self.limits = limits
        self.errors = errors
        self.random = random
        self.forward = self.turn = 0.0
        self.pose: Pose = (0.0, 0.0, 0.0)
        self.way_variance = self.turn_variance = 0.0
        self._orders: deque[tuple[float, float, float]] = deque()
        self._wanted = (0.0, 0.0)
        self._heard_s = -math.inf

    def command(self, now_s: float, forward: float, turn: float) -> None:
        """Take a command; it acts after the lag."""
        self._heard_s = now_s
        limits = self.limits
        forward = min(limits.speed, max(-limits.speed, forward))
        turn = min(limits.turn, max(-limits.turn, turn))
        self._orders.append((now_s + limits.lag_s, forward, turn))

    def step(self, now_s: float, seconds: float) -> tuple[float, float]:
        """Let `seconds` pass until `now_s`; gives the mean speeds [m/s, rad/s] of the step."""
        limits = self.limits
        while self._orders and self._orders[0][0] <= now_s:
            _, *wanted = self._orders.popleft()
            self._wanted = (wanted[0], wanted[1])
        if now_s - self._heard_s > limits.command_timeout_s:
            self._orders.clear()
            self._wanted = (0.0, 0.0)
        before = self.forward, self.turn
        self.forward = _approached(before[0], self._wanted[0], limits.acceleration * seconds)
        self.turn = _approached(before[1], self._wanted[1], limits.turn_acceleration * seconds)
        mean = 0.5 * (before[0] + self.forward), 0.5 * (before[1] + self.turn)
        self._measure(seconds * mean[0], seconds * mean[1])
        return mean

    def _measure(self, far: float, turned: float) -> None:
        if not (far or turned):
            return
        errors = self.errors
        noise = self.random.standard_normal(2)
        way = errors.way * math.sqrt(abs(far))
        turn = math.sqrt(errors.turn**2 * abs(turned) + errors.turn_per_metre**2 * abs(far))
        seen_far = far * (1.0 + errors.way_scale) + way * noise[0]
        seen_turn = turned * (1.0 + errors.turn_scale) + turn * noise[1]
        half = (0.0, 0.0, 0.5 * seen_turn)
        self.pose = compose(compose(compose(self.pose, half), (seen_far, 0.0, 0.0)), half)
        self.turn_variance += turn**2 + (errors.turn_scale * turned) ** 2
        self.way_variance += way**2 + (errors.way_scale * far) ** 2 + self.turn_variance * far**2


def _approached(value: float, wanted: float, most: float) -> float:
    return value + min(most, max(-most, wanted - value))
