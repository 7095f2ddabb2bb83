"""The RoboClaw's packet serial protocol as pure functions: packets, CRC, commands, status bits.

Bytes in, values out; no line and no clock. `reply_data` checks the CRC of a reply.

Source: RoboClaw Series User Manual (Basicmicro), sections "Packet Serial" ("Address", "Packet
Timeout", "Packet Acknowledgement", "CRC16 Checksum Calculation"), "Advanced Packet Serial
Commands", "Encoder Commands" and "Advanced Motor Control"; layouts compared with Basicmicro's
Arduino library. All numbers are big-endian.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from dataclasses import dataclass

ADDRESSES = range(0x80, 0x88)
"""Addresses that a RoboClaw may have; over USB it answers to each of them."""

ACKNOWLEDGED = b"\xff"
"""The whole reply to a `WriteCommand`. It has no CRC."""

CRC_SIZE = 2

PACKET_TIMEOUT_S = 0.010
"""The RoboClaw discards a packet that pauses for longer than this between two bytes [s]."""

SET_TIMEOUT = 14
READ_VERSION = 21
DRIVE_DUTY = 34
DRIVE_SPEED = 40
SET_MAIN_VOLTAGES = 57
READ_STATUS = 90

TIMEOUT_STEP_S = 0.1
"""Unit of the serial timeout [s]; 0 disables it (manual, command 14)."""

LONGEST_TIMEOUT_S = 25.5

HIGHEST_ACCELERATION = 2**32 - 1
"""The highest acceleration that command 40 takes [counts/s^2]."""

LONGEST_VERSION = 48
"""Most bytes of the version text; the last two are LF and NUL (command 21)."""

VERSION_END = b"\n\0"


@dataclass(frozen=True)
class WriteCommand:
    """A command that sets or moves something, and its data; it is acknowledged."""

    command: int
    data: bytes


@dataclass(frozen=True)
class ReadCommand:
    """A command that reads numbers, and the layout (`struct`) of its reply's data."""

    command: int
    layout: str

    @property
    def size(self) -> int:
        """Bytes of data in the reply."""
        return struct.calcsize(self.layout)

    def decode(self, data: bytes) -> tuple[int, ...]:
        """Return the numbers in the data of a reply."""
        return struct.unpack(self.layout, data)


TIMEOUT = ReadCommand(15, ">B")
"""Serial timeout [0.1 s]."""

MAIN_VOLTAGE = ReadCommand(24, ">H")
"""Voltage of the main battery [0.1 V]."""

LOGIC_VOLTAGE = ReadCommand(25, ">H")
"""Voltage of the logic battery [0.1 V]."""

CURRENTS = ReadCommand(49, ">hh")
"""Currents of both motors [0.01 A]."""

SPEED_LOOPS = (ReadCommand(55, ">IIII"), ReadCommand(56, ">IIII"))
"""P, I, D [1/65536] and QPPS, the counts per second at full power, of M1 and of M2.

Commands 28 and 29 set them, in the order D, P, I, QPPS.
"""

MAIN_VOLTAGES = ReadCommand(59, ">HH")
"""Lowest and highest voltage of the main battery [0.1 V]; outside them the motors are off."""

NEW_MAIN_VOLTAGES = ReadCommand(59, ">HHB")
"""The same in newer firmware, with the flag for automatic offset, which command 57 takes as well.

This layout is in Basicmicro's Python library, and not in the manual.
"""

ENCODERS = ReadCommand(78, ">II")
"""Counters of both encoders, which wrap at 2^32; one packet, so both are of the same moment."""

TEMPERATURE = ReadCommand(82, ">H")
"""Temperature of the board [0.1 deg C]."""

STATUS = ReadCommand(READ_STATUS, ">I")
"""Status bits, 4 bytes; see `decode_status`."""

OLD_STATUS = ReadCommand(READ_STATUS, ">H")
"""Status bits of old firmware, 2 bytes with other meanings; see `decode_status`."""


def crc16(data: bytes) -> int:
    """Return the CRC of bytes: polynomial 0x1021, initial value 0, not reflected (XMODEM)."""
    return crc_hqx(data, 0)


def write_packet(address: int, command: int, data: bytes = b"") -> bytes:
    """Return the packet of a command that sets something; `ACKNOWLEDGED` answers it."""
    packet = bytes((address, command)) + data
    return packet + crc16(packet).to_bytes(CRC_SIZE, "big")


def read_packet(address: int, command: int) -> bytes:
    """Return the packet of a command that reads. It has no CRC: the reply's CRC covers it."""
    return bytes((address, command))


def reply_packet(address: int, command: int, data: bytes) -> bytes:
    """Return the reply to a command that reads: data, and the CRC of command and data."""
    covered = read_packet(address, command) + data
    return data + crc16(covered).to_bytes(CRC_SIZE, "big")


def reply_data(address: int, command: int, reply: bytes) -> bytes | None:
    """Return the data of a reply; None if its CRC is wrong or it answers another command."""
    data = reply[:-CRC_SIZE]
    return data if reply_packet(address, command, data) == reply else None


def set_timeout(seconds: float) -> WriteCommand:
    """Stop the motors after this time without bytes [s]; kept until power is off."""
    return WriteCommand(SET_TIMEOUT, struct.pack(">B", timeout_steps(seconds)))


def timeout_steps(seconds: float) -> int:
    """Return a serial timeout [s] in steps of 0.1 s: at least one, as 0 disables it."""
    return max(1, round(min(seconds, LONGEST_TIMEOUT_S) / TIMEOUT_STEP_S))


def drive_speed(acceleration: int, first: int, second: int) -> WriteCommand:
    """Drive M1 and M2 by their speed loops at speeds [counts/s], with an acceleration limit."""
    return WriteCommand(DRIVE_SPEED, struct.pack(">Iii", acceleration, first, second))


def drive_duty(first: float, second: float) -> WriteCommand:
    """Drive M1 and M2 with shares of full power, -1 to 1, without encoders and speed loops."""
    duties = (round(32767 * max(-1.0, min(1.0, duty))) for duty in (first, second))
    return WriteCommand(DRIVE_DUTY, struct.pack(">hh", *duties))


def switch_off() -> WriteCommand:
    """Switch off the power of M1 and M2."""
    return drive_duty(0.0, 0.0)


def set_main_voltages(lowest: float, highest: float, *rest: int) -> WriteCommand:
    """Switch the motors off while the main battery is outside these limits [V].

    `rest`: the bytes that follow the limits in the reply to `NEW_MAIN_VOLTAGES`; none for
    `MAIN_VOLTAGES`.
    """
    limits = struct.pack(">HH", round(lowest * 10), round(highest * 10))
    return WriteCommand(SET_MAIN_VOLTAGES, limits + bytes(rest))


@dataclass(frozen=True)
class ControllerStatus:
    """Status bits of a RoboClaw by name. Errors stop its motors, warnings do not."""

    errors: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def decode_status(bits: int, *, old: bool) -> ControllerStatus:
    """Return what the bits of a status mean, of old firmware or of new."""
    errors, warnings = (_OLD_ERRORS, _OLD_WARNINGS) if old else (_ERRORS, _WARNINGS)
    unknown = bits & ~sum(errors) & ~sum(warnings)
    return ControllerStatus(
        errors=tuple(name for bit, name in errors.items() if bits & bit),
        warnings=tuple(name for bit, name in warnings.items() if bits & bit)
        + ((f"unknown status 0x{unknown:08x}",) if unknown else ()),
    )


# Command 90, "Read Status". Which firmware has which bits follows from the length of its reply.
_ERRORS = {
    0x00000001: "emergency stop",
    0x00000002: "too hot (sensor 1)",
    0x00000004: "too hot (sensor 2)",
    0x00000008: "main battery voltage too high",
    0x00000010: "logic battery voltage too high",
    0x00000020: "logic battery voltage too low",
    0x00000040: "driver fault of M1",
    0x00000080: "driver fault of M2",
    0x00000100: "speed error of M1",
    0x00000200: "speed error of M2",
    0x00000400: "position error of M1",
    0x00000800: "position error of M2",
    0x00001000: "current error of M1",
    0x00002000: "current error of M2",
    # A warning by its name; but below the set limit "RoboClaw will stop driving the motors".
    0x00080000: "main battery voltage low",
}
_WARNINGS = {
    0x00010000: "over-current of M1",
    0x00020000: "over-current of M2",
    0x00040000: "main battery voltage high",
    0x00100000: "hot (sensor 1)",
    0x00200000: "hot (sensor 2)",
    0x00400000: "signal S4",
    0x00800000: "signal S5",
    0x01000000: "speed error near its limit",
    0x02000000: "position error near its limit",
}
_OLD_ERRORS = {
    0x0004: "emergency stop",
    0x0008: "too hot (sensor 1)",
    0x0010: "too hot (sensor 2)",
    0x0020: "main battery voltage too high",
    0x0040: "logic battery voltage too high",
    0x0080: "logic battery voltage too low",
    0x0100: "driver fault of M1",
    0x0200: "driver fault of M2",
    0x0800: "main battery voltage low",
}
_OLD_WARNINGS = {
    0x0001: "over-current of M1",
    0x0002: "over-current of M2",
    0x0400: "main battery voltage high",
    0x1000: "hot (sensor 1)",
    0x2000: "hot (sensor 2)",
    0x4000: "home of M1",
    0x8000: "home of M2",
}
