"""The commands of SCIP 2 that ask a sensor to measure. Section "Sensor's commands"."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Encoding = Literal[2, 3]
"""Characters of a distance: 3 for up to 262 m, 2 for up to 4.095 m, a third less on the line."""


@dataclass(frozen=True)
class ScanRequest:
    """A stream of scans without end: which steps, how many of them are one value, which scans.

    `cluster` neighbors become one value, the smallest; `skip` scans are left out after each one.
    """

    first: int
    last: int
    cluster: int = 1
    skip: int = 0
    intensity: bool = False
    multi_echo: bool = False
    encoding: Encoding = 3

    @property
    def values(self) -> int:
        """How many steps or clusters of steps a scan has."""
        return -(-(self.last - self.first + 1) // self.cluster)

    @property
    def command(self) -> bytes:
        """The command that begins the stream: MD, MS, ME, ND or NE."""
        return self._words + b"00"

    @property
    def _words(self) -> bytes:
        letters = "N" if self.multi_echo else "M"
        letters += "E" if self.intensity else "D" if self.encoding == 3 or self.multi_echo else "S"
        steps = f"{self.first:04d}{self.last:04d}"
        return f"{letters}{steps}{self.cluster:02d}{self.skip:01d}".encode()

    def is_echo(self, echo: bytes) -> bool:
        """Whether a reply's echo is of this stream; its last two digits count scans down."""
        return echo[:-2] == self._words and echo[-2:].isdigit()
