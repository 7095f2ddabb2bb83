"""An emulated scanner that speaks SCIP 1.1 and 2: what its line shows, without line or clock.

Hokuyo, *Communication Protocol Specification For SCIP2.0* (C-42-03320B).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass

from cairn.components.hokuyo import emulated_facts as facts
from cairn.components.hokuyo import emulated_scip1 as scip1
from cairn.components.hokuyo.emulated_asked import MEASURING, Asked, asked
from cairn.components.hokuyo.emulated_commands import BAUDS, COMMANDS, Commands
from cairn.components.hokuyo.emulated_models import MODELS
from cairn.components.hokuyo.emulated_record import SentScan
from cairn.components.hokuyo.emulated_scene import Room, Scene
from cairn.components.hokuyo.emulated_sensor import Sensor
from cairn.components.hokuyo.emulated_text import reply, scan_reply

_LONGEST = 128  # bytes of a command; what is longer is noise
_BACKLOG_S = 0.1  # scans that are older are not sent any more once a busy line is free
_STRING_LENGTH = 16
_STRING = re.compile(rb"[A-Za-z0-9 ._+@]*")
_LINE_END = re.compile(rb"[\r\n]")


@dataclass
class _Wanted:
    """Scans that are asked for: how, by which command, how many are left, the next one's turn."""

    asked: Asked
    command: bytes
    string: bytes
    left: int
    turn: int

    def echo(self) -> bytes:
        """What stands before a scan: a stream's tells how many are left behind it."""
        if not self.asked.is_stream:
            return self.command + self.string
        return self.command[:-2] + f"{self.left:02d}".encode() + self.string


class EmulatedScip:
    """A scanner of one of the `MODELS`. Implements `cairn.driver.emulator.EmulatedDevice`."""

    def __init__(
        self,
        model: str = "UTM-30LX",
        *,
        scene: Scene | None = None,
        seed: int = 0,
        rs232_baud: int | None = None,
        speaks_scip1: bool = False,
        knows_scip2: bool = True,
        clock_start_ms: float = 0.0,
        drift_ppm: float = 0.0,
        sums_arrows: bool = True,
        serial_number: str = "H0614967",
        on_scan: Callable[[SentScan], None] | None = None,
    ) -> None:
        """`rs232_baud`: it is on its RS-232 line, with this speed after power-on [bit/s], rather
        than on USB or Ethernet. `speaks_scip1`: so it does after power-on, and unless it
        `knows_scip2` ever after. `clock_start_ms`: what its clock shows at power-on; `drift_ppm`:
        by how much that goes too fast. Without `sums_arrows` it leaves what stands from `<-` on
        out of II's check sums, as some UTM-30LX do, whose state Hokuyo's own library cannot read.
        `on_scan` is told of each scan as it is sent.
        """
        self.model = MODELS[model]
        self.sensor = Sensor(
            self.model,
            scene or Room(self.model, seed),
            baud=rs232_baud,
            clock_start_ms=clock_start_ms,
            drift_ppm=drift_ppm,
            sums_arrows=sums_arrows,
        )
        self._commands = Commands(self.sensor, serial_number)
        self._serial_number = serial_number
        self._starts_in_scip1 = speaks_scip1
        self._knows_scip2 = knows_scip2
        self._on_scan = on_scan
        self._wanted: _Wanted | None = None
        self.powered_on(0.0)

    def powered_on(self, now: float) -> None:
        """Begin as after power-on."""
        self._held = b""
        self._scip1 = self._starts_in_scip1
        self._wanted = None
        self.sensor.powered_on(now)

    def disconnected(self, now: float) -> None:  # noqa: ARG002 - as every emulated device
        """Nobody listens any more: what it heard half of is forgotten; on Ethernet it rests."""
        self._held = b""
        if self.model.line == "ethernet":
            self.sensor.darken()
            self.sensor.adjusting = False
            self._wanted = None

    def baud(self) -> int | None:
        """The speed of its RS-232 line [bit/s]; USB and Ethernet have none."""
        return self.sensor.baud

    def trouble(self, status: str, scans: int = 1) -> None:
        """Have so many of the next scans of a stream come as this status instead, without data.

        `0M`: unstable for the moment; 21 to 49: it stops to verify an error; 98: it goes on; 50 to
        97: it is broken, and the stream ends.
        """
        self.sensor.coming.extend([status] * scans)

    def due(self) -> float:
        """When the next scan that is asked for has been measured [s]."""
        return math.inf if self._wanted is None else self.sensor.mirror.measured(self._wanted.turn)

    def tick(self, now: float) -> list[bytes]:
        """The scans that are asked for and have been measured meanwhile."""
        frames = []
        while self._wanted is not None and self._wanted.turn <= self.sensor.mirror.newest(now):
            frames.append(self._next(self._wanted, now))
        return frames

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Take commands; what is answered at once."""
        if now < self.sensor.deaf_until:
            return []
        *lines, self._held = _LINE_END.split(self._held + data)
        self._held = self._held[-_LONGEST:]
        answers = [self._answer(line[-_LONGEST:], now) for line in lines if line]
        return [answer for answer in answers if answer is not None]

    def _answer(self, line: bytes, now: float) -> bytes | None:
        text = line.decode("ascii", "replace")
        if self._scip1:
            return self._answer_scip1(line, text, now)
        command, semicolon, string = line.partition(b";")
        name = text[: 3 if text.startswith("%") else 2]
        parameters = command.decode("ascii", "replace")[len(name) :]
        if len(string) > _STRING_LENGTH:
            return reply(line, "0G")
        if not _STRING.fullmatch(string):
            return reply(line, "0H")
        if name not in COMMANDS:
            return self._begin(line, command, semicolon + string, now)
        status, lines = self._commands.run(name, parameters, now)
        if not self.sensor.laser:
            self._wanted = None
        return reply(line, status, lines)

    def _begin(self, line: bytes, command: bytes, string: bytes, now: float) -> bytes | None:
        """Begin to measure; single scans are answered once they are measured."""
        text = command.decode("ascii", "replace")
        if text[:2] not in self.model.commands:
            is_ust = self.model.generation == "UST"
            return reply(line, "0F" if is_ust and text[:2] in MEASURING else "0E")
        if self.sensor.adjusting:
            return reply(line, "0E" if self.model.generation == "first" else "10")
        request = asked(text[:2], text[2:], self.model)
        if isinstance(request, str):
            return reply(line, request)
        if self.sensor.trouble is not None:
            return reply(line, self.sensor.trouble)
        if request.is_stream:
            self.sensor.light(now)
            self.sensor.streaming = True
            turn = self.sensor.mirror.next(now)
            self._wanted = _Wanted(request, command, string, request.scans, turn)
            return reply(line, "00")
        if not self.sensor.laser:
            return reply(line, "10")
        wanted = _Wanted(request, command, string, 1, self.sensor.newest_turn(now))
        if self._wanted is None and wanted.turn > self.sensor.mirror.newest(now):
            self._wanted = wanted
            return None
        return self._data(wanted, "00", wanted.turn)

    def _next(self, wanted: _Wanted, now: float) -> bytes:
        """The next scan that is wanted and not too old."""
        request = wanted.asked
        if not request.is_stream:
            self._wanted = None
            return self._data(wanted, "00", wanted.turn)
        step = 1 + request.interval
        late = self.sensor.mirror.newest(now - _BACKLOG_S) - wanted.turn
        turn = wanted.turn + max(0, -(-late // step)) * step
        wanted.turn = turn + step
        if self.sensor.coming:
            return self._troubled(wanted, self.sensor.coming.popleft())
        wanted.left = max(0, wanted.left - 1)
        frame = self._data(wanted, "99", turn)
        if request.scans and not wanted.left:
            self._wanted = None
            self.sensor.darken()
        return frame

    def _troubled(self, wanted: _Wanted, status: str) -> bytes:
        if status.isdigit() and 50 <= int(status) <= 97:
            self.sensor.fail(status)
            self._wanted = None
        return reply(wanted.echo(), status)

    def _data(self, wanted: _Wanted, status: str, turn: int) -> bytes:
        scan = self._sent(turn, wanted.asked)
        return scan_reply(wanted.echo(), status, scan)

    def _sent(self, turn: int, request: Asked) -> SentScan:
        scan = self.sensor.scan(turn, request)
        if self._on_scan is not None:
            self._on_scan(scan)
        return scan

    def _answer_scip1(self, line: bytes, text: str, now: float) -> bytes:
        lines: list[bytes] = []
        status = scip1.OK
        if text == scip1.SWITCH and self._knows_scip2:
            self._scip1 = False
        elif text == "V":
            lines = scip1.version(facts.version(self.model, self._serial_number))
        elif text == "L0":
            self.sensor.darken()
        elif text == "L1":
            self.sensor.light(now)
        elif text[:1] == "S" and len(text) == 14 and text[1:].isdigit():
            if int(text[1:7]) in BAUDS and self.sensor.baud is not None:
                self.sensor.baud = int(text[1:7])
            else:
                status = scip1.REFUSED
        elif text[:1] == "G":
            request = scip1.asked(text[1:], self.model)
            if request is not None and self.sensor.laser:
                scan = self._sent(self.sensor.newest_turn(now), request)
                lines = scip1.scan_lines(scan.distances)
            else:
                status = scip1.REFUSED
        else:
            status = scip1.UNKNOWN
        return scip1.reply(line, status, lines)
