"""What an emulated RoboClaw is, apart from its packets: settings, battery, faults, two motors."""

from __future__ import annotations

from typing import Literal

from cairn.components.roboclaw.emulated_motor import EmulatedMotor, MotorFault

Firmware = Literal["old", "usual", "new"]
"""Old: 16 bits of status; new: battery limits with a byte more (`commands.NEW_MAIN_VOLTAGES`)."""

_EMERGENCY_STOP, _BATTERY_HIGH, _BATTERY_LOW = 0x00000001, 0x00000008, 0x00080000
_OVERCURRENT = (0x00010000, 0x00020000)
_FACTORY_LOOP = (65536, 32768, 16384)  # P, I, D [1/65536] (manual, command 28)


class EmulatedController:
    """State that commands read and change; it knows neither lines nor time limits."""

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
        self._settle()

    def _settle(self) -> None:
        self.timeout_s = 0.0
        self.main_limits = (6.0, 34.0)
        self.logic_limits = (4.5, 34.0)
        self.loops = [(*_FACTORY_LOOP, round(motor.full_speed)) for motor in self.motors]
        self.auto_offset = 0
        self.encoder_modes = [0, 0]
        self.mixed: list[float | None] = [None, None]  # forward and turn [1] of commands 8 to 13

    def power_cycle(self) -> None:
        """Lose power for a moment: settings and counters are those of the beginning."""
        self._settle()
        self.switch_off()
        for motor in self.motors:
            motor.set_count(0)

    def switch_off(self) -> None:
        """Take the power from both motors."""
        for motor in self.motors:
            motor.give_power(0.0)

    def set_fault(self, motor: int, fault: MotorFault | None) -> None:
        """Have something wrong with motor 1 or 2 from now on; None: it is mended."""
        self.motors[motor - 1].fault = fault

    @property
    def at_rest(self) -> bool:
        """Whether nothing moves, and nothing is going to."""
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
        """Whether its status keeps it from driving."""
        return bool(self.status & (_EMERGENCY_STOP | _BATTERY_HIGH | _BATTERY_LOW))
