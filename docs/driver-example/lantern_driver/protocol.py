"""The Lantern's protocol: bytes and numbers, no line, no clock, no bus.

The command `G` starts measuring, `X` stops it. Twenty times per second the Lantern sends a line of
text: `T`, the end of the turn [ms of its own clock, 16 bits], the distances of 91 beams [mm, 0:
nothing hit], `*`, and the sum of all bytes before that as two hexadecimal digits. It turns
clockwise: the first beam points to the left, the last one to the right.
"""

from dataclasses import dataclass

BAUD = 115_200
START, STOP = b"G\n", b"X\n"
BEAMS = 91
RATE_HZ = 20.0
SWEEP_S = 0.025  # it measures ahead, in half of each turn
CLOCK_HZ, CLOCK_BITS = 1000.0, 16
NEAREST_MM, FARTHEST_MM = 50, 8000

_LONGEST = 1000  # bytes of a line


class DamagedLine(ValueError):
    """A line is not what the Lantern sent."""


@dataclass(frozen=True)
class Turn:
    """When a turn ended by the device's clock [ms], and its distances [mm], from left to right."""

    ended_ms: int
    millimeters: tuple[int, ...]


def write_turn(turn: Turn) -> bytes:
    """Return the line that describes a turn: for emulators."""
    body = " ".join(["T", str(turn.ended_ms), *map(str, turn.millimeters)]).encode()
    return b"%s*%02X\n" % (body, sum(body) & 0xFF)


def read_turn(line: bytes) -> Turn:
    """Return the turn that a line describes; raises `DamagedLine` if it is damaged."""
    body, star, received = line.rstrip(b"\n").rpartition(b"*")
    if not star or received != b"%02X" % (sum(body) & 0xFF):
        raise DamagedLine(f"the sum of {line[:20]!r} ... is wrong")
    kind, *words = body.split(b" ")
    if kind != b"T" or len(words) != 1 + BEAMS or not all(word.isdigit() for word in words):
        raise DamagedLine(f"{line[:20]!r} ... is not a turn of {BEAMS} beams")
    ended, *millimeters = map(int, words)
    return Turn(ended, tuple(millimeters))


class Lines:
    """Splits received bytes into lines."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Return the lines that are complete now; of an endless line only the end is kept."""
        *lines, rest = (self._rest + data).split(b"\n")
        self._rest = rest[-_LONGEST:]
        return lines
