"""A motor with its encoder and speed loop, as an emulated RoboClaw drives it."""

from __future__ import annotations

import math
from typing import Literal

MotorFault = Literal["stalled", "encoder_off", "encoder_reversed", "overcurrent"]
"""The shaft is held; the encoder's cable is off; its two lines are exchanged; the motor has little
force, as more current than it may have is asked for."""

_INTEGRAL = 0.4  # gain of the speed loop's integral [1/s]
_LIMITED = 0.2  # of the speed that a motor short of current reaches [1]
_HELD = 0.005  # of full speed: below this, a wheel that is to stand is held by the loop [1]
_IDLE_A, _RUNNING_A, _STALLED_A = 0.0, 1.2, 12.0  # currents [A]


class EmulatedMotor:
    """Follows orders with a lag, and counts with its encoder.

    Speeds are in counts/s of a healthy encoder, whatever the encoder really shows.
    """

    def __init__(self, full_speed: float, lag_s: float, first_count: int) -> None:
        """`full_speed`: at full power [counts/s]; `lag_s`: the speed's time constant [s]."""
        self.full_speed = full_speed
        self.fault: MotorFault | None = None
        self.speed = 0.0
        self.turned = 0.0
        """How far the shaft has turned since the beginning [counts]."""
        self._lag_s = lag_s
        self._counted = float(first_count)
        self._wanted: float | None = None  # by the speed loop; None: the power is set instead
        self._acceleration = math.inf
        self._distance = math.inf
        self._setpoint = 0.0
        self._integral = 0.0
        self._power = 0.0

    @property
    def count(self) -> int:
        """The encoder's counter, of 32 bits."""
        return math.floor(self._counted) % (1 << 32)

    @property
    def seen_speed(self) -> float:
        """What the encoder shows [counts/s]."""
        match self.fault:
            case "encoder_off":
                return 0.0
            case "encoder_reversed":
                return -self.speed
            case _:
                return self.speed

    @property
    def power(self) -> float:
        """The share of full power that it is given, with its direction [1]."""
        return self._aim() / self.full_speed

    @property
    def current(self) -> float:
        """What it draws [A]."""
        if self._aim() == 0.0:
            return _IDLE_A
        held = self.fault in ("stalled", "overcurrent")
        return math.copysign(_STALLED_A if held else _RUNNING_A, self._aim())

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves, and nothing is going to."""
        return self.speed == 0.0 and self._aim() == 0.0 and not self._wanted

    def set_count(self, count: int) -> None:
        """Set the encoder's counter."""
        self._counted = float(count)

    def run(self, speed: float, acceleration: float = math.inf, distance: float = math.inf) -> None:
        """Go at a speed by the speed loop, and stop after a distance [counts]."""
        if self._wanted is None:
            self._setpoint, self._integral = self.seen_speed, 0.0
        self._wanted, self._acceleration, self._distance = speed, acceleration, distance

    def give_power(self, power: float) -> None:
        """Set the power, -1 to 1, without the speed loop."""
        self._wanted, self._power = None, power

    def step(self, seconds: float) -> None:
        """Let so much time pass [s]; short against the lag."""
        if self._wanted is not None:
            most = self._acceleration * seconds
            self._setpoint += min(most, max(-most, self._wanted - self._setpoint))
            self._integral += _INTEGRAL * (self._setpoint - self.seen_speed) * seconds
        aim = self._aim() * (_LIMITED if self.fault == "overcurrent" else 1.0)
        before = self.speed
        self.speed += (aim - self.speed) * (1.0 - math.exp(-seconds / self._lag_s))
        if self.fault == "stalled" or (aim == 0.0 and abs(self.speed) < 0.5):
            self.speed = 0.0
        way = 0.5 * (before + self.speed) * seconds if self.fault != "stalled" else 0.0
        self._turn(way)

    def _turn(self, way: float) -> None:
        self.turned += way
        if self.fault != "encoder_off":
            self._counted += -way if self.fault == "encoder_reversed" else way
        self._distance -= abs(way)
        if self._distance <= 0.0:
            self._wanted, self._distance = 0.0, math.inf

    def _aim(self) -> float:
        """The speed that it would reach with the power it is given [counts/s]."""
        if self._wanted is None:
            return self._power * self.full_speed
        if self._wanted == self._setpoint == 0.0 and abs(self.seen_speed) < _HELD * self.full_speed:
            self._integral = 0.0
        aim = self._setpoint + self._integral
        return min(self.full_speed, max(-self.full_speed, aim))
