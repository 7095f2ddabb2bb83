"""A sensor that speaks SCIP 1.1 alone: an URG-04LX with the firmware of its first years.

It has no stream, no clock, no check sums and no way to say how it measures: it is asked for each
scan, and damage can be told by what is missing or is no number alone.
"""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np

from cairn.components.hokuyo.device_facts import URG_04LX
from cairn.components.hokuyo.dialogue import Arrival, Dialogue
from cairn.components.hokuyo.replies import Reply
from cairn.components.hokuyo.requests import ScanRequest
from cairn.components.hokuyo.scan_data import ScanData
from cairn.components.hokuyo.scip_text import BLOCK, ScipError, decode_numbers
from cairn.driver.errors import DeviceError

_WIDTH = 2
_KEYS = ("VEND", "PROD", "FIRM", "PROT", "SERI")


class Scip1:
    """Talks with a sensor that was greeted; see `greeting`."""

    def __init__(self, dialogue: Dialogue) -> None:
        self._dialogue = dialogue
        self._name = dialogue.link.name
        self._request: ScanRequest | None = None
        self._next_turn = 0.0
        self.measuring = URG_04LX

    def version(self) -> Mapping[str, str]:
        """Who made it: VEND, PROD, FIRM, PROT, SERI."""
        lines = [line.decode("ascii", "replace") for line in self._dialogue.ask("V").lines]
        found = dict(line.split(":", 1) for line in lines if ":" in line)
        return found or dict(zip(_KEYS, lines, strict=False))

    def start(self, request: ScanRequest) -> None:
        """Switch the laser on; from now on scans are asked for."""
        self._laser("L1")
        self._request = request

    def arrivals(self, limit_s: float) -> list[Arrival]:
        """The next scan's reply, waiting for it as long as for any answer.

        A sensor that is asked more often than it turns tells the same scan again: until a turn is
        over it is not asked, and nothing comes within `limit_s` [s].
        """
        if self._request is None:
            return []
        now = time.monotonic()
        if now < self._next_turn:
            return self._dialogue.arrivals(min(limit_s, self._next_turn - now))
        self._next_turn = max(self._next_turn + self.measuring.turn_s, now)
        command = gather(self._request)
        self._dialogue.send(command)
        reply = self._dialogue.find(command)
        return [] if reply is None else [Arrival(reply, time.monotonic_ns())]

    def stop(self) -> None:
        """Switch the laser off."""
        self._request = None
        self._laser("L0")

    def _laser(self, command: str) -> None:
        status = self._dialogue.ask(command).status
        if status != b"0":
            raise DeviceError(
                f"{self._name}: the sensor does not switch its laser (status "
                f"{status.decode('ascii', 'replace')})"
            )


def gather(request: ScanRequest) -> str:
    """The command that asks for one scan."""
    return f"G{request.first:03d}{request.last:03d}{request.cluster:02d}"


def scan_data_1(reply: Reply, request: ScanRequest) -> ScanData:
    """The scan in a reply; raises `ScipError` unless it is just what was asked for."""
    if reply.status != b"0":
        raise ScipError(f"its status is {reply.status!r}")
    lines = reply.lines
    if not lines:
        raise ScipError("there is no data in it")
    if any(len(line) != BLOCK for line in lines[:-1]) or len(lines[-1]) > BLOCK:
        raise ScipError("a line of data is not of 64 characters")
    values = decode_numbers(np.frombuffer(b"".join(lines), np.uint8), _WIDTH)
    if values.size != request.values:
        raise ScipError(f"{values.size} values came, but {request.values} were asked for")
    return ScanData(None, values.reshape(-1, 1))
