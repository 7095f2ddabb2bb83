"""The emulated controller behind its protocol: settings, battery, faults, two motors."""

from __future__ import annotations

import math
from typing import Literal

MotorFault = Literal["stalled", "encoder_off", "encoder_reversed", "overcurrent"]
"""The shaft is held; the encoder's cable is unplugged; its two lines are exchanged; the motor has
little force, as it would need more current than it may draw."""

Firmware = Literal["old", "usual", "new"]
"""Old: 16 status bits; new: battery limits with one more byte (`protocol.NEW_MAIN_VOLTAGES`)."""

_INTEGRAL_GAIN = 0.4  # of the speed loop [1/s]
_OVERCURRENT_SHARE = 0.2  # of the speed that a motor short of current reaches [1]
_HELD_SHARE = 0.005  # of full speed: below this, the loop holds a wheel that is to stand [1]
_IDLE_A, _RUNNING_A, _STALLED_A = 0.0, 1.2, 12.0  # currents [A]
_EMERGENCY_STOP, _BATTERY_HIGH, _BATTERY_LOW = 0x00000001, 0x00000008, 0x00080000
_OVERCURRENT = (0x00010000, 0x00020000)
_FACTORY_LOOP = (65536, 32768, 16384)  # P, I, D [1/65536] (manual, command 28)


class EmulatedMotor:
    """A motor with encoder and speed loop, which follows commands with a lag.

    Speeds are in counts/s of a healthy encoder, whatever the encoder really shows.
    """

    def __init__(self, full_speed: float, lag_s: float, first_count: int) -> None:
        """`full_speed`: at full power [counts/s]; `lag_s`: the speed's time constant [s]."""
        self.full_speed = full_speed
        self.fault: MotorFault | None = None
        self.speed = 0.0
        self.turned = 0.0
        """How far the shaft has turned since the start [counts]."""
        self._lag_s = lag_s
        self._counted = float(first_count)
        self._target: float | None = None  # of the speed loop; None: the duty is set instead
        self._acceleration = math.inf
        self._distance = math.inf
        self._setpoint = 0.0
        self._integral = 0.0
        self._duty = 0.0

    @property
    def count(self) -> int:
        """The encoder's counter, of 32 bits."""
        return math.floor(self._counted) % (1 << 32)

    @property
    def encoder_speed(self) -> float:
        """The speed that the encoder shows [counts/s]."""
        match self.fault:
            case "encoder_off":
                return 0.0
            case "encoder_reversed":
                return -self.speed
            case _:
                return self.speed

    @property
    def duty(self) -> float:
        """The share of full power applied, with its direction [1]."""
        return self._drive() / self.full_speed

    @property
    def current(self) -> float:
        """The current that it draws [A]."""
        if self._drive() == 0.0:
            return _IDLE_A
        held = self.fault in ("stalled", "overcurrent")
        return math.copysign(_STALLED_A if held else _RUNNING_A, self._drive())

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves or is going to move."""
        return self.speed == 0.0 and self._drive() == 0.0 and not self._target

    def set_count(self, count: int) -> None:
        """Set the encoder's counter."""
        self._counted = float(count)

    def run(self, speed: float, acceleration: float = math.inf, distance: float = math.inf) -> None:
        """Run at a speed by the speed loop, and stop after a distance [counts]."""
        if self._target is None:
            self._setpoint, self._integral = self.encoder_speed, 0.0
        self._target, self._acceleration, self._distance = speed, acceleration, distance

    def set_duty(self, duty: float) -> None:
        """Set the share of full power, -1 to 1, without the speed loop."""
        self._target, self._duty = None, duty

    def step(self, seconds: float) -> None:
        """Let a time pass [s] that is short compared with the lag."""
        if self._target is not None:
            most = self._acceleration * seconds
            self._setpoint += min(most, max(-most, self._target - self._setpoint))
            self._integral += _INTEGRAL_GAIN * (self._setpoint - self.encoder_speed) * seconds
        drive = self._drive() * (_OVERCURRENT_SHARE if self.fault == "overcurrent" else 1.0)
        before = self.speed
        self.speed += (drive - self.speed) * (1.0 - math.exp(-seconds / self._lag_s))
        if self.fault == "stalled" or (drive == 0.0 and abs(self.speed) < 0.5):
            self.speed = 0.0
        turned = 0.5 * (before + self.speed) * seconds if self.fault != "stalled" else 0.0
        self._turn(turned)

    def _turn(self, counts: float) -> None:
        self.turned += counts
        if self.fault != "encoder_off":
            self._counted += -counts if self.fault == "encoder_reversed" else counts
        self._distance -= abs(counts)
        if self._distance <= 0.0:
            self._target, self._distance = 0.0, math.inf

    def _drive(self) -> float:
        """Return the speed that it would reach with the power applied [counts/s]."""
        if self._target is None:
            return self._duty * self.full_speed
        held = abs(self.encoder_speed) < _HELD_SHARE * self.full_speed
        if self._target == self._setpoint == 0.0 and held:
            self._integral = 0.0
        drive = self._setpoint + self._integral
        return min(self.full_speed, max(-self.full_speed, drive))


class EmulatedController:
    """State that commands read and change, without lines and time limits."""

    def __init__(
        self,
        version: str,
        full_speed: float,
        lag_s: float,
        first_counts: tuple[int, int],
        firmware: Firmware,
    ) -> None:
        self.version = version
        self.firmware = firmware
        self.motors = tuple(EmulatedMotor(full_speed, lag_s, count) for count in first_counts)
        self.voltage, self.logic_voltage, self.temperature = 12.4, 5.0, 31.5
        self.emergency_stop = False
        self._reset_settings()

    def _reset_settings(self) -> None:
        self.timeout_s = 0.0
        self.main_limits = (6.0, 34.0)
        self.logic_limits = (4.5, 34.0)
        self.loops = [(*_FACTORY_LOOP, round(motor.full_speed)) for motor in self.motors]
        self.auto_offset = 0
        self.encoder_modes = [0, 0]
        self.mixed: list[float | None] = [None, None]  # forward and turn [1] of commands 8 to 13

    def power_cycle(self) -> None:
        """Lose power for a moment: settings and counters are reset."""
        self._reset_settings()
        self.switch_off()
        for motor in self.motors:
            motor.set_count(0)

    def switch_off(self) -> None:
        """Switch off the power of both motors."""
        for motor in self.motors:
            motor.set_duty(0.0)

    def set_fault(self, motor: int, fault: MotorFault | None) -> None:
        """Set the fault of motor 1 or 2; None repairs it."""
        self.motors[motor - 1].fault = fault

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves or is going to move."""
        return all(motor.at_rest for motor in self.motors)

    @property
    def status(self) -> int:
        """The status bits of command 90."""
        low, high = self.main_limits
        bits = _EMERGENCY_STOP if self.emergency_stop else 0
        bits |= _BATTERY_HIGH if self.voltage > high else 0
        bits |= _BATTERY_LOW if self.voltage < low else 0
        for motor, bit in zip(self.motors, _OVERCURRENT, strict=True):
            bits |= bit if motor.fault == "overcurrent" and motor.current else 0
        return bits

    @property
    def switched_off(self) -> bool:
        """Whether its status prevents driving."""
        return bool(self.status & (_EMERGENCY_STOP | _BATTERY_HIGH | _BATTERY_LOW))
