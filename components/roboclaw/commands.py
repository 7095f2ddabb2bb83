"""The commands of a RoboClaw that the driver uses: numbers, layouts, units.

Source: RoboClaw Series User Manual, sections "Advanced Packet Serial Commands", "Encoder Commands"
and "Advanced Motor Control"; layouts compared with Basicmicro's Arduino library. All numbers are
big-endian.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

SET_TIMEOUT = 14
READ_VERSION = 21
DRIVE_DUTY = 34
DRIVE_SPEED = 40
SET_MAIN_VOLTAGES = 57
READ_STATUS = 90

TIMEOUT_STEP_S = 0.1
"""The serial timeout is counted in these steps [s]; 0 means none (manual, command 14)."""

LONGEST_TIMEOUT_S = 25.5

HIGHEST_ACCELERATION = 2**32 - 1
"""What command 40 can be given [counts/s^2]."""

LONGEST_VERSION = 48
"""The version's text has up to so many bytes, the last two are LF and NUL (command 21)."""

VERSION_END = b"\n\0"


@dataclass(frozen=True)
class Order:
    """A packet that sets or orders something: command and data."""

    command: int
    data: bytes


@dataclass(frozen=True)
class Question:
    """A packet that reads numbers: command, and how its reply's data are laid out (`struct`)."""

    command: int
    layout: str
    about: str

    @property
    def size(self) -> int:
        """Bytes of data in the reply."""
        return struct.calcsize(self.layout)

    def decode(self, data: bytes) -> tuple[int, ...]:
        """The numbers in the data of a reply."""
        return struct.unpack(self.layout, data)


TIMEOUT = Question(15, ">B", "serial timeout")
"""Serial timeout [0.1 s]."""

MAIN_VOLTAGE = Question(24, ">H", "main battery voltage")
"""Main battery [0.1 V]."""

LOGIC_VOLTAGE = Question(25, ">H", "logic battery voltage")
"""Logic battery [0.1 V]."""

CURRENTS = Question(49, ">hh", "motor currents")
"""Currents of both motors [0.01 A]."""

SPEED_LOOPS = (
    Question(55, ">IIII", "speed loop of M1"),
    Question(56, ">IIII", "speed loop of M2"),
)
"""P, I, D [1/65536] and QPPS, the counts per second at full power: of each motor.

Commands 28 and 29 set them, in the order D, P, I, QPPS.
"""

MAIN_VOLTAGES = Question(59, ">HH", "main battery limits")
"""Main battery, lowest and highest [0.1 V], beyond which the motors are switched off."""

NEW_MAIN_VOLTAGES = Question(59, ">HHB", "main battery limits")
"""The same of newer firmware: with whether its offset is found by itself, as command 57 takes it.

It is in Basicmicro's Python library, and not in the manual.
"""

ENCODERS = Question(78, ">II", "encoder counts")
"""Counters of both encoders, which wrap at 2^32: read in one packet, so of one moment."""

TEMPERATURE = Question(82, ">H", "temperature")
"""Temperature of the board [0.1 deg C]."""

STATUS = Question(READ_STATUS, ">I", "status")
"""Status bits, 4 bytes; see `status.py`."""

OLD_STATUS = Question(READ_STATUS, ">H", "status")
"""The 2 bytes of status, with other bits, of old firmware."""


def set_timeout(seconds: float) -> Order:
    """Have the motors stop when nothing comes for so long [s]; kept until power is off."""
    return Order(SET_TIMEOUT, struct.pack(">B", timeout_steps(seconds)))


def timeout_steps(seconds: float) -> int:
    """A serial timeout [s] in the RoboClaw's steps: at least one, as 0 means none."""
    return max(1, round(min(seconds, LONGEST_TIMEOUT_S) / TIMEOUT_STEP_S))


def drive_speed(acceleration: int, first: int, second: int) -> Order:
    """Have the speed loops bring M1 and M2 to speeds [counts/s], at most so fast [counts/s^2]."""
    return Order(DRIVE_SPEED, struct.pack(">Iii", acceleration, first, second))


def give_power(first: float, second: float) -> Order:
    """Give M1 and M2 shares of full power, -1 to 1; no encoder and no speed loop has a say."""
    duties = (round(32767 * max(-1.0, min(1.0, one))) for one in (first, second))
    return Order(DRIVE_DUTY, struct.pack(">hh", *duties))


def switch_off() -> Order:
    """Take the power from M1 and M2."""
    return give_power(0.0, 0.0)


def set_main_voltages(lowest: float, highest: float, *rest: int) -> Order:
    """Switch the motors off when the main battery is beyond these limits [V].

    `rest`: what follows the limits in the reply to `NEW_MAIN_VOLTAGES`, nothing for others.
    """
    limits = struct.pack(">HH", round(lowest * 10), round(highest * 10))
    return Order(SET_MAIN_VOLTAGES, limits + bytes(rest))
