"""The emulated controller behind its protocol: two motors, settings, battery, faults, commands.

The commands are those of all drivers in use, not of Cairn's alone. Layouts are those of the manual
and of Basicmicro's libraries, as in `protocol.py`. Of buffered commands (with a distance) the
newest one counts: there is no queue. Position commands are not emulated.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from cairn.components.roboclaw_base.protocol import LONGEST_VERSION, TIMEOUT_STEP_S, VERSION_END

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
_FULL_DUTY = 32767
_FULL_BYTE = 127  # full power in commands with seven bits
_LARGEST_CURRENT = 1500  # [0.01 A]
_PACKET_SERIAL = 0x0003  # configuration (command 99): packet serial mode, address 0x80


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


ReplyData = Callable[[EmulatedController], bytes]


def _version(controller: EmulatedController) -> bytes:
    return controller.version.encode()[: LONGEST_VERSION - len(VERSION_END)] + VERSION_END


def _numbers(layout: str, numbers: Callable[[EmulatedController], tuple[int, ...]]) -> ReplyData:
    packed = struct.Struct(">" + layout)
    return lambda controller: packed.pack(*numbers(controller))


def _count(motor: int) -> ReplyData:
    def answer(controller: EmulatedController) -> tuple[int, ...]:
        encoder = controller.motors[motor]
        return encoder.count, 0x02 if encoder.encoder_speed < 0 else 0x00

    return _numbers("IB", answer)


def _speed(motor: int) -> ReplyData:
    """Return the reply with the speed, and a status byte for its direction."""

    def answer(controller: EmulatedController) -> tuple[int, ...]:
        speed = round(controller.motors[motor].encoder_speed)
        return abs(speed), 1 if speed < 0 else 0

    return _numbers("IB", answer)


def _speeds(controller: EmulatedController) -> tuple[int, ...]:
    return tuple(round(motor.encoder_speed) for motor in controller.motors)


def _status(controller: EmulatedController) -> bytes:
    return (
        struct.pack(">I", controller.status)
        if controller.firmware != "old"
        else struct.pack(">H", _old(controller.status))
    )


def _main_limits(controller: EmulatedController) -> bytes:
    limits = struct.pack(">HH", *(round(10 * limit) for limit in controller.main_limits))
    return limits + bytes([controller.auto_offset]) if controller.firmware == "new" else limits


def _old(bits: int) -> int:
    """Return the 16 status bits of old firmware for the bits that are emulated."""
    pairs = (
        (0x00010000, 0x0001),
        (0x00020000, 0x0002),
        (0x00000001, 0x0004),
        (0x00000008, 0x0020),
        (0x00080000, 0x0800),
    )
    return sum(old for new, old in pairs if bits & new)


READ_COMMANDS: dict[int, ReplyData] = {
    15: _numbers("B", lambda controller: (round(controller.timeout_s / TIMEOUT_STEP_S),)),
    16: _count(0),
    17: _count(1),
    18: _speed(0),
    19: _speed(1),
    21: _version,
    24: _numbers("H", lambda controller: (round(10 * controller.voltage),)),
    25: _numbers("H", lambda controller: (round(10 * controller.logic_voltage),)),
    30: _speed(0),
    31: _speed(1),
    47: _numbers("BB", lambda _: (0x80, 0x80)),  # both buffers are empty
    48: _numbers(
        "hh",
        lambda controller: tuple(round(_FULL_DUTY * motor.duty) for motor in controller.motors),
    ),
    49: _numbers(
        "hh", lambda controller: tuple(round(100 * motor.current) for motor in controller.motors)
    ),
    55: _numbers("IIII", lambda controller: controller.loops[0]),
    56: _numbers("IIII", lambda controller: controller.loops[1]),
    59: _main_limits,
    60: _numbers(
        "HH", lambda controller: tuple(round(10 * limit) for limit in controller.logic_limits)
    ),
    78: _numbers("II", lambda controller: tuple(motor.count for motor in controller.motors)),
    79: _numbers("ii", _speeds),
    81: _numbers("II", lambda _: (0, 0)),
    82: _numbers("H", lambda controller: (round(10 * controller.temperature),)),
    83: _numbers("H", lambda controller: (round(10 * controller.temperature),)),
    90: _status,
    72: _numbers("HH", lambda _: (0, 0)),
    75: _numbers("BBBBB", lambda _: (0, 0, 0, 0, 0)),
    77: _numbers("BB", lambda _: (0, 0)),
    91: _numbers("BB", lambda controller: tuple(controller.encoder_modes)),
    99: _numbers("H", lambda _: (_PACKET_SERIAL,)),
    63: _numbers("IIIIIii", lambda _: (0, 0, 0, 0, 0, 0, 0)),
    64: _numbers("IIIIIii", lambda _: (0, 0, 0, 0, 0, 0, 0)),
    108: _numbers("ii", _speeds),
    110: _numbers("HH", lambda _: (0, 0)),
    111: _numbers("ii", lambda _: (0, 0)),
    114: _numbers("ii", lambda _: (0, 0)),
    135: _numbers("II", lambda _: (_LARGEST_CURRENT, 0)),
    136: _numbers("II", lambda _: (_LARGEST_CURRENT, 0)),
    149: _numbers("B", lambda _: (1,)),
}
"""Commands that read something, and the functions that return the data of their replies."""


@dataclass(frozen=True)
class EmulatedWrite:
    """A command that sets or moves something: the layout of its data, and its effect."""

    layout: struct.Struct
    execute: Callable[..., None]


def write_commands(firmware: Firmware) -> Mapping[int, EmulatedWrite]:
    """Return the commands that a generation of firmware executes."""
    return (
        _WRITE_COMMANDS | {57: _write("HHB", _set_main)} if firmware == "new" else _WRITE_COMMANDS
    )


def _write(layout: str, execute: Callable[..., None]) -> EmulatedWrite:
    return EmulatedWrite(struct.Struct(">" + layout), execute)


def _set_timeout(controller: EmulatedController, steps: int) -> None:
    controller.timeout_s = steps * TIMEOUT_STEP_S


def _reset_counts(controller: EmulatedController) -> None:
    for motor in controller.motors:
        motor.set_count(0)


def _set_loop(motor: int) -> Callable[..., None]:
    def execute(controller: EmulatedController, d: int, p: int, i: int, full_speed: int) -> None:
        controller.loops[motor] = (p, i, d, full_speed)

    return execute


def _set_main(controller: EmulatedController, low: int, high: int, auto_offset: int = 0) -> None:
    controller.main_limits, controller.auto_offset = (low / 10, high / 10), auto_offset


def _set_logic(controller: EmulatedController, low: int, high: int) -> None:
    controller.logic_limits = (low / 10, high / 10)


def _set_encoder_mode(motor: int) -> Callable[..., None]:
    def execute(controller: EmulatedController, mode: int) -> None:
        controller.encoder_modes[motor] = mode

    return execute


def _set_count(motor: int) -> Callable[..., None]:
    return lambda controller, count: controller.motors[motor].set_count(count)


def _duty(*motors: int) -> Callable[..., None]:
    def execute(controller: EmulatedController, *duties: int) -> None:
        for motor, duty in zip(motors, duties, strict=True):
            controller.motors[motor].set_duty(duty / _FULL_DUTY)

    return execute


def _ramped_duty(*motors: int) -> Callable[..., None]:
    """Set duties; their accelerations, which alternate with them, are not modeled."""
    return lambda controller, *numbers: _duty(*motors)(controller, *numbers[::2])


def _seven_bits(motor: int, sign: int) -> Callable[..., None]:
    return lambda controller, value: controller.motors[motor].set_duty(
        sign * min(value, _FULL_BYTE) / _FULL_BYTE
    )


def _around_64(motor: int) -> Callable[..., None]:
    return lambda controller, value: controller.motors[motor].set_duty(_share_of_64(value))


def _share_of_64(value: int) -> float:
    return max(-1.0, (min(value, _FULL_BYTE) - 64) / (_FULL_BYTE - 64))


def _mixed(which: int, share: Callable[[int], float]) -> Callable[..., None]:
    """Set forward (0) or right turn (1): nothing moves before both were set (manual)."""

    def execute(controller: EmulatedController, value: int) -> None:
        controller.mixed[which] = share(value)
        forward, right = controller.mixed
        if forward is not None and right is not None:
            for motor, duty in zip(
                controller.motors, (forward + right, forward - right), strict=True
            ):
                motor.set_duty(min(1.0, max(-1.0, duty)))

    return execute


def _run(
    motors: tuple[int, ...],
    *,
    accelerations: int = 0,
    distances: bool = False,
) -> Callable[..., None]:
    """Run motors at speeds, with one acceleration for all or one each, and with distances.

    The numbers come in the manual's order: [acceleration,] then for each motor [acceleration,]
    speed [, distance], and last whether the buffer is emptied.
    """

    def execute(controller: EmulatedController, *numbers: int) -> None:
        left = list(numbers)
        acceleration = float(left.pop(0)) if accelerations == 1 else math.inf
        for motor in motors:
            own = float(left.pop(0)) if accelerations > 1 else acceleration
            speed = float(left.pop(0))
            distance = float(left.pop(0)) if distances else math.inf
            controller.motors[motor].run(speed, own, distance)

    return execute


def _ignore(controller: EmulatedController, *_: Any) -> None:
    """Acknowledge a setting that is not modeled."""


_BOTH = (0, 1)
_WRITE_COMMANDS: dict[int, EmulatedWrite] = {
    0: _write("B", _seven_bits(0, 1)),
    1: _write("B", _seven_bits(0, -1)),
    2: _write("B", _ignore),
    3: _write("B", _ignore),
    4: _write("B", _seven_bits(1, 1)),
    5: _write("B", _seven_bits(1, -1)),
    6: _write("B", _around_64(0)),
    7: _write("B", _around_64(1)),
    8: _write("B", _mixed(0, lambda value: value / _FULL_BYTE)),
    9: _write("B", _mixed(0, lambda value: -value / _FULL_BYTE)),
    10: _write("B", _mixed(1, lambda value: value / _FULL_BYTE)),
    11: _write("B", _mixed(1, lambda value: -value / _FULL_BYTE)),
    12: _write("B", _mixed(0, _share_of_64)),
    13: _write("B", _mixed(1, _share_of_64)),
    14: _write("B", _set_timeout),
    20: _write("", _reset_counts),
    22: _write("I", _set_count(0)),
    23: _write("I", _set_count(1)),
    26: _write("B", _ignore),
    27: _write("B", _ignore),
    28: _write("IIII", _set_loop(0)),
    29: _write("IIII", _set_loop(1)),
    32: _write("h", _duty(0)),
    33: _write("h", _duty(1)),
    34: _write("hh", _duty(0, 1)),
    35: _write("i", _run((0,))),
    36: _write("i", _run((1,))),
    37: _write("ii", _run(_BOTH)),
    38: _write("Ii", _run((0,), accelerations=1)),
    39: _write("Ii", _run((1,), accelerations=1)),
    40: _write("Iii", _run(_BOTH, accelerations=1)),
    41: _write("iIB", _run((0,), distances=True)),
    42: _write("iIB", _run((1,), distances=True)),
    43: _write("iIiIB", _run(_BOTH, distances=True)),
    44: _write("IiIB", _run((0,), accelerations=1, distances=True)),
    45: _write("IiIB", _run((1,), accelerations=1, distances=True)),
    46: _write("IiIiIB", _run(_BOTH, accelerations=1, distances=True)),
    50: _write("IiIi", _run(_BOTH, accelerations=2)),
    51: _write("IiIIiIB", _run(_BOTH, accelerations=2, distances=True)),
    52: _write("hI", _ramped_duty(0)),
    53: _write("hI", _ramped_duty(1)),
    54: _write("hIhI", _ramped_duty(0, 1)),
    57: _write("HH", _set_main),
    58: _write("HH", _set_logic),
    61: _write("IIIIIii", _ignore),
    62: _write("IIIIIii", _ignore),
    68: _write("I", _ignore),
    69: _write("I", _ignore),
    74: _write("BBB", _ignore),
    76: _write("BB", _ignore),
    92: _write("B", _set_encoder_mode(0)),
    93: _write("B", _set_encoder_mode(1)),
    94: _write("I", _ignore),
    98: _write("H", _ignore),
    133: _write("II", _ignore),
    134: _write("II", _ignore),
    148: _write("B", _ignore),
}
