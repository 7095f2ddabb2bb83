"""The RoboClaw's status bits by name: what stops its motors, and what it warns of.

Source: RoboClaw Series User Manual, command 90 "Read Status": 32 bits; the older edition of the
manual for 16 bits. Which firmware has which is told by the length of its reply.
"""

from __future__ import annotations

from dataclasses import dataclass

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


@dataclass(frozen=True)
class Status:
    """What a RoboClaw says of itself. Errors stop its motors, warnings do not."""

    errors: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def decode(bits: int) -> Status:
    """The 32 bits of firmware of these years; unknown ones are told as warnings."""
    return _named(bits, _ERRORS, _WARNINGS)


def decode_old(bits: int) -> Status:
    """The 16 bits of old firmware."""
    return _named(bits, _OLD_ERRORS, _OLD_WARNINGS)


def _named(bits: int, errors: dict[int, str], warnings: dict[int, str]) -> Status:
    unknown = bits & ~sum(errors) & ~sum(warnings)
    return Status(
        errors=tuple(name for bit, name in errors.items() if bits & bit),
        warnings=tuple(name for bit, name in warnings.items() if bits & bit)
        + ((f"unknown status 0x{unknown:08x}",) if unknown else ()),
    )
