"""What an emulated RoboClaw does at each command: those of drivers in use, not the driver's alone.

Layouts are those of the manual, as in `commands.py`. Of buffered commands (with a distance) the
newest counts: there is no queue.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from components.roboclaw.commands import LONGEST_VERSION, TIMEOUT_STEP_S, VERSION_END
from components.roboclaw.emulated_controller import EmulatedController

Answer = Callable[[EmulatedController], bytes]
_FULL_DUTY = 32767
_PACKET_SERIAL = 0x0003  # configuration (command 99): packet serial mode, address 0x80


@dataclass(frozen=True)
class Ordered:
    """A command that sets or orders something: its data, and what is done with these."""

    layout: struct.Struct
    obey: Callable[..., None]


def _ordered(layout: str, obey: Callable[..., None]) -> Ordered:
    return Ordered(struct.Struct(">" + layout), obey)


def _version(it: EmulatedController) -> bytes:
    return it.version.encode()[: LONGEST_VERSION - len(VERSION_END)] + VERSION_END


def _numbers(layout: str, numbers: Callable[[EmulatedController], tuple[int, ...]]) -> Answer:
    packed = struct.Struct(">" + layout)
    return lambda it: packed.pack(*numbers(it))


def _count(motor: int) -> Answer:
    def answer(it: EmulatedController) -> tuple[int, ...]:
        one = it.motors[motor]
        return one.count, 0x02 if one.seen_speed < 0 else 0x00

    return _numbers("IB", answer)


def _speed(motor: int) -> Answer:
    def answer(it: EmulatedController) -> tuple[int, ...]:
        speed = round(it.motors[motor].seen_speed)
        return speed, 1 if speed < 0 else 0

    return _numbers("iB", answer)


def _speeds(it: EmulatedController) -> tuple[int, ...]:
    return tuple(round(motor.seen_speed) for motor in it.motors)


def _status(it: EmulatedController) -> bytes:
    return struct.pack(">I", it.status) if not it.old_status else struct.pack(">H", _old(it.status))


def _old(bits: int) -> int:
    """The 16 bits of old firmware for those that the emulator knows."""
    pairs = (
        (0x00010000, 0x0001),
        (0x00020000, 0x0002),
        (0x00000001, 0x0004),
        (0x00000008, 0x0020),
        (0x00080000, 0x0800),
    )
    return sum(old for new, old in pairs if bits & new)


ANSWERS: dict[int, Answer] = {
    15: _numbers("B", lambda it: (round(it.timeout_s / TIMEOUT_STEP_S),)),
    16: _count(0),
    17: _count(1),
    18: _speed(0),
    19: _speed(1),
    21: _version,
    24: _numbers("H", lambda it: (round(10 * it.voltage),)),
    25: _numbers("H", lambda it: (round(10 * it.logic_voltage),)),
    30: _speed(0),
    31: _speed(1),
    47: _numbers("BB", lambda _: (0x80, 0x80)),  # both buffers are empty
    48: _numbers("hh", lambda it: tuple(round(_FULL_DUTY * one.power) for one in it.motors)),
    49: _numbers("hh", lambda it: tuple(round(100 * one.current) for one in it.motors)),
    55: _numbers("IIII", lambda it: it.loops[0]),
    56: _numbers("IIII", lambda it: it.loops[1]),
    59: _numbers("HH", lambda it: tuple(round(10 * one) for one in it.main_limits)),
    60: _numbers("HH", lambda it: tuple(round(10 * one) for one in it.logic_limits)),
    78: _numbers("II", lambda it: tuple(one.count for one in it.motors)),
    79: _numbers("ii", _speeds),
    82: _numbers("H", lambda it: (round(10 * it.temperature),)),
    83: _numbers("H", lambda it: (round(10 * it.temperature),)),
    90: _status,
    91: _numbers("BB", lambda it: tuple(it.encoder_modes)),
    99: _numbers("H", lambda _: (_PACKET_SERIAL,)),
    108: _numbers("ii", _speeds),
}
"""Commands that read something, and the data of their replies."""


def _set_timeout(it: EmulatedController, steps: int) -> None:
    it.timeout_s = steps * TIMEOUT_STEP_S


def _reset_counts(it: EmulatedController) -> None:
    for motor in it.motors:
        motor.set_count(0)


def _set_loop(motor: int) -> Callable[..., None]:
    def obey(it: EmulatedController, d: int, p: int, i: int, full_speed: int) -> None:
        it.loops[motor] = (p, i, d, full_speed)

    return obey


def _set_main(it: EmulatedController, low: int, high: int) -> None:
    it.main_limits = (low / 10, high / 10)


def _set_logic(it: EmulatedController, low: int, high: int) -> None:
    it.logic_limits = (low / 10, high / 10)


def _set_encoder_mode(motor: int) -> Callable[..., None]:
    def obey(it: EmulatedController, mode: int) -> None:
        it.encoder_modes[motor] = mode

    return obey


def _set_count(motor: int) -> Callable[..., None]:
    return lambda it, count: it.motors[motor].set_count(count)


def _power(*motors: int, full: int = _FULL_DUTY) -> Callable[..., None]:
    def obey(it: EmulatedController, *duties: int) -> None:
        for motor, duty in zip(motors, duties, strict=True):
            it.motors[motor].give_power(max(-1.0, duty / full))

    return obey


def _seven_bits(motor: int, sign: int) -> Callable[..., None]:
    return lambda it, value: it.motors[motor].give_power(sign * min(value, 127) / 127)


def _around_64(motor: int) -> Callable[..., None]:
    return lambda it, value: it.motors[motor].give_power((min(value, 127) - 64) / 64)


def _run(it: EmulatedController, motor: int, *arguments: float) -> None:
    it.motors[motor].run(*arguments)


def _run_both(it: EmulatedController, first: int, second: int) -> None:
    _run(it, 0, first)
    _run(it, 1, second)


def _run_accelerated(it: EmulatedController, acceleration: int, first: int, second: int) -> None:
    _run(it, 0, first, acceleration)
    _run(it, 1, second, acceleration)


def _run_distances(it: EmulatedController, *of: int) -> None:
    acceleration, first, way, second, other_way, _ = of
    _run(it, 0, first, acceleration, way)
    _run(it, 1, second, acceleration, other_way)


def _nothing(it: EmulatedController, *_: Any) -> None:
    """A setting that the emulator acknowledges and does not model."""


ORDERS: dict[int, Ordered] = {
    0: _ordered("B", _seven_bits(0, 1)),
    1: _ordered("B", _seven_bits(0, -1)),
    4: _ordered("B", _seven_bits(1, 1)),
    5: _ordered("B", _seven_bits(1, -1)),
    6: _ordered("B", _around_64(0)),
    7: _ordered("B", _around_64(1)),
    14: _ordered("B", _set_timeout),
    20: _ordered("", _reset_counts),
    22: _ordered("I", _set_count(0)),
    23: _ordered("I", _set_count(1)),
    28: _ordered("IIII", _set_loop(0)),
    29: _ordered("IIII", _set_loop(1)),
    32: _ordered("h", _power(0)),
    33: _ordered("h", _power(1)),
    34: _ordered("hh", _power(0, 1)),
    35: _ordered("i", lambda it, speed: _run(it, 0, speed)),
    36: _ordered("i", lambda it, speed: _run(it, 1, speed)),
    37: _ordered("ii", _run_both),
    38: _ordered("Ii", lambda it, acceleration, speed: _run(it, 0, speed, acceleration)),
    39: _ordered("Ii", lambda it, acceleration, speed: _run(it, 1, speed, acceleration)),
    40: _ordered("Iii", _run_accelerated),
    46: _ordered("IiIiIB", _run_distances),
    57: _ordered("HH", _set_main),
    58: _ordered("HH", _set_logic),
    74: _ordered("BBB", _nothing),
    92: _ordered("B", _set_encoder_mode(0)),
    93: _ordered("B", _set_encoder_mode(1)),
    94: _ordered("I", _nothing),
    133: _ordered("II", _nothing),
    134: _ordered("II", _nothing),
}
"""Commands that set or order something."""
