"""What an emulated RoboClaw does when it is told to: by drivers in use, not by Cairn's alone.

Layouts are those of the manual and of Basicmicro's libraries, as in `commands.py`. Of buffered
commands (with a distance) the newest counts: there is no queue. Positions are not driven to.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from cairn.components.roboclaw.commands import TIMEOUT_STEP_S
from cairn.components.roboclaw.emulated_controller import EmulatedController, Firmware

_FULL_DUTY = 32767
_BYTE = 127  # of the commands with seven bits: full power


@dataclass(frozen=True)
class Ordered:
    """A command that sets or orders something: its data, and what is done with these."""

    layout: struct.Struct
    obey: Callable[..., None]


def orders_of(firmware: Firmware) -> Mapping[int, Ordered]:
    """The commands that firmware of a generation obeys."""
    return _ORDERS | {57: _ordered("HHB", _set_main)} if firmware == "new" else _ORDERS


def _ordered(layout: str, obey: Callable[..., None]) -> Ordered:
    return Ordered(struct.Struct(">" + layout), obey)


def _set_timeout(it: EmulatedController, steps: int) -> None:
    it.timeout_s = steps * TIMEOUT_STEP_S


def _reset_counts(it: EmulatedController) -> None:
    for motor in it.motors:
        motor.set_count(0)


def _set_loop(motor: int) -> Callable[..., None]:
    def obey(it: EmulatedController, d: int, p: int, i: int, full_speed: int) -> None:
        it.loops[motor] = (p, i, d, full_speed)

    return obey


def _set_main(it: EmulatedController, low: int, high: int, auto_offset: int = 0) -> None:
    it.main_limits, it.auto_offset = (low / 10, high / 10), auto_offset


def _set_logic(it: EmulatedController, low: int, high: int) -> None:
    it.logic_limits = (low / 10, high / 10)


def _set_encoder_mode(motor: int) -> Callable[..., None]:
    def obey(it: EmulatedController, mode: int) -> None:
        it.encoder_modes[motor] = mode

    return obey


def _set_count(motor: int) -> Callable[..., None]:
    return lambda it, count: it.motors[motor].set_count(count)


def _power(*motors: int) -> Callable[..., None]:
    def obey(it: EmulatedController, *duties: int) -> None:
        for motor, duty in zip(motors, duties, strict=True):
            it.motors[motor].give_power(duty / _FULL_DUTY)

    return obey


def _ramped_power(*motors: int) -> Callable[..., None]:
    """Duty and its acceleration by turns; the ramp is not modeled."""
    return lambda it, *numbers: _power(*motors)(it, *numbers[::2])


def _seven_bits(motor: int, sign: int) -> Callable[..., None]:
    return lambda it, value: it.motors[motor].give_power(sign * min(value, _BYTE) / _BYTE)


def _around_64(motor: int) -> Callable[..., None]:
    return lambda it, value: it.motors[motor].give_power(_of_64(value))


def _of_64(value: int) -> float:
    return max(-1.0, (min(value, _BYTE) - 64) / (_BYTE - 64))


def _mixed(which: int, share: Callable[[int], float]) -> Callable[..., None]:
    """Forward (0) or turn to the right (1): nothing moves before both were given (manual)."""

    def obey(it: EmulatedController, value: int) -> None:
        it.mixed[which] = share(value)
        forward, right = it.mixed
        if forward is not None and right is not None:
            for motor, power in zip(it.motors, (forward + right, forward - right), strict=True):
                motor.give_power(min(1.0, max(-1.0, power)))

    return obey


def _run(
    motors: tuple[int, ...],
    *,
    accelerations: int = 0,
    distances: bool = False,
) -> Callable[..., None]:
    """Speeds of motors, with so many accelerations (one for all, or one each), and distances.

    They stand in the manual's order: [acceleration,] then for each motor [acceleration,] speed
    [, distance], in the end whether the buffer is emptied.
    """

    def obey(it: EmulatedController, *numbers: int) -> None:
        left = list(numbers)
        acceleration = float(left.pop(0)) if accelerations == 1 else math.inf
        for motor in motors:
            own = float(left.pop(0)) if accelerations > 1 else acceleration
            speed = float(left.pop(0))
            distance = float(left.pop(0)) if distances else math.inf
            it.motors[motor].run(speed, own, distance)

    return obey


def _nothing(it: EmulatedController, *_: Any) -> None:
    """A setting that the emulator acknowledges and does not model."""


_BOTH = (0, 1)
_ORDERS: dict[int, Ordered] = {
    0: _ordered("B", _seven_bits(0, 1)),
    1: _ordered("B", _seven_bits(0, -1)),
    2: _ordered("B", _nothing),
    3: _ordered("B", _nothing),
    4: _ordered("B", _seven_bits(1, 1)),
    5: _ordered("B", _seven_bits(1, -1)),
    6: _ordered("B", _around_64(0)),
    7: _ordered("B", _around_64(1)),
    8: _ordered("B", _mixed(0, lambda value: value / _BYTE)),
    9: _ordered("B", _mixed(0, lambda value: -value / _BYTE)),
    10: _ordered("B", _mixed(1, lambda value: value / _BYTE)),
    11: _ordered("B", _mixed(1, lambda value: -value / _BYTE)),
    12: _ordered("B", _mixed(0, _of_64)),
    13: _ordered("B", _mixed(1, _of_64)),
    14: _ordered("B", _set_timeout),
    20: _ordered("", _reset_counts),
    22: _ordered("I", _set_count(0)),
    23: _ordered("I", _set_count(1)),
    26: _ordered("B", _nothing),
    27: _ordered("B", _nothing),
    28: _ordered("IIII", _set_loop(0)),
    29: _ordered("IIII", _set_loop(1)),
    32: _ordered("h", _power(0)),
    33: _ordered("h", _power(1)),
    34: _ordered("hh", _power(0, 1)),
    35: _ordered("i", _run((0,))),
    36: _ordered("i", _run((1,))),
    37: _ordered("ii", _run(_BOTH)),
    38: _ordered("Ii", _run((0,), accelerations=1)),
    39: _ordered("Ii", _run((1,), accelerations=1)),
    40: _ordered("Iii", _run(_BOTH, accelerations=1)),
    41: _ordered("iIB", _run((0,), distances=True)),
    42: _ordered("iIB", _run((1,), distances=True)),
    43: _ordered("iIiIB", _run(_BOTH, distances=True)),
    44: _ordered("IiIB", _run((0,), accelerations=1, distances=True)),
    45: _ordered("IiIB", _run((1,), accelerations=1, distances=True)),
    46: _ordered("IiIiIB", _run(_BOTH, accelerations=1, distances=True)),
    50: _ordered("IiIi", _run(_BOTH, accelerations=2)),
    51: _ordered("IiIIiIB", _run(_BOTH, accelerations=2, distances=True)),
    52: _ordered("hI", _ramped_power(0)),
    53: _ordered("hI", _ramped_power(1)),
    54: _ordered("hIhI", _ramped_power(0, 1)),
    57: _ordered("HH", _set_main),
    58: _ordered("HH", _set_logic),
    61: _ordered("IIIIIii", _nothing),
    62: _ordered("IIIIIii", _nothing),
    68: _ordered("I", _nothing),
    69: _ordered("I", _nothing),
    74: _ordered("BBB", _nothing),
    76: _ordered("BB", _nothing),
    92: _ordered("B", _set_encoder_mode(0)),
    93: _ordered("B", _set_encoder_mode(1)),
    94: _ordered("I", _nothing),
    98: _ordered("H", _nothing),
    133: _ordered("II", _nothing),
    134: _ordered("II", _nothing),
    148: _ordered("B", _nothing),
}
