"""A differential base: how its wheels follow commands."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass


@dataclass(frozen=True)
class BaseLimits:
    """Limits [m/s, rad/s, m/s^2, rad/s^2], delay of a command [s], and how long it holds [s]."""

    speed: float = 0.6
    turn: float = 1.5
    acceleration: float = 0.8
    turn_acceleration: float = 3.0
    lag_s: float = 0.05
    command_timeout_s: float = 0.3


class Wheels:
    """The speeds that the wheels have, `forward` [m/s] and `turn` [rad/s]."""

    def __init__(self, limits: BaseLimits) -> None:
        self.limits = limits
        self.forward = self.turn = 0.0
        self._orders: deque[tuple[float, float, float]] = deque()
        self._wanted = (0.0, 0.0)
        self._heard_s = -math.inf

    def command(self, now_s: float, forward: float, turn: float) -> None:
        """Take a command [m/s, rad/s]; it acts after the lag, as far as the limits allow."""
        self._heard_s = now_s
        limits = self.limits
        forward = min(limits.speed, max(-limits.speed, forward))
        turn = min(limits.turn, max(-limits.turn, turn))
        self._orders.append((now_s + limits.lag_s, forward, turn))

    def step(self, now_s: float, seconds: float) -> tuple[float, float]:
        """Let `seconds` pass until `now_s`; gives the mean speeds [m/s, rad/s] meanwhile."""
        limits = self.limits
        while self._orders and self._orders[0][0] <= now_s:
            _, forward, turn = self._orders.popleft()
            self._wanted = (forward, turn)
        if now_s - self._heard_s > limits.command_timeout_s:
            self._orders.clear()
            self._wanted = (0.0, 0.0)
        before = self.forward, self.turn
        self.forward = _approached(before[0], self._wanted[0], limits.acceleration * seconds)
        self.turn = _approached(before[1], self._wanted[1], limits.turn_acceleration * seconds)
        return 0.5 * (before[0] + self.forward), 0.5 * (before[1] + self.turn)


def _approached(value: float, wanted: float, most: float) -> float:
    return value + min(most, max(-most, wanted - value))
