"""What an emulated RoboClaw answers: to drivers in use, not to Cairn's alone.

Layouts are those of the manual and of Basicmicro's libraries, as in `commands.py`.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from cairn.components.roboclaw.commands import LONGEST_VERSION, TIMEOUT_STEP_S, VERSION_END
from cairn.components.roboclaw.emulated_controller import EmulatedController

Answer = Callable[[EmulatedController], bytes]
_FULL_DUTY = 32767
_LARGEST_CURRENT = 1500  # [0.01 A]
_PACKET_SERIAL = 0x0003  # configuration (command 99): packet serial mode, address 0x80


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
    """How fast, and in the byte of status whether backwards."""

    def answer(it: EmulatedController) -> tuple[int, ...]:
        speed = round(it.motors[motor].seen_speed)
        return abs(speed), 1 if speed < 0 else 0

    return _numbers("IB", answer)


def _speeds(it: EmulatedController) -> tuple[int, ...]:
    return tuple(round(motor.seen_speed) for motor in it.motors)


def _status(it: EmulatedController) -> bytes:
    return (
        struct.pack(">I", it.status) if it.firmware != "old" else struct.pack(">H", _old(it.status))
    )


def _main_limits(it: EmulatedController) -> bytes:
    limits = struct.pack(">HH", *(round(10 * one) for one in it.main_limits))
    return limits + bytes([it.auto_offset]) if it.firmware == "new" else limits


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
    59: _main_limits,
    60: _numbers("HH", lambda it: tuple(round(10 * one) for one in it.logic_limits)),
    78: _numbers("II", lambda it: tuple(one.count for one in it.motors)),
    79: _numbers("ii", _speeds),
    81: _numbers("II", lambda _: (0, 0)),
    82: _numbers("H", lambda it: (round(10 * it.temperature),)),
    83: _numbers("H", lambda it: (round(10 * it.temperature),)),
    90: _status,
    72: _numbers("HH", lambda _: (0, 0)),
    75: _numbers("BBBBB", lambda _: (0, 0, 0, 0, 0)),
    77: _numbers("BB", lambda _: (0, 0)),
    91: _numbers("BB", lambda it: tuple(it.encoder_modes)),
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
"""Commands that read something, and the data of their replies."""
