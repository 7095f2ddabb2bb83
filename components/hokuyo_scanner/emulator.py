"""An emulated scanner that speaks SCIP 1.1 and 2: URG, UHG, UTM (UTM-30LX), UST.

It has the commands, statuses, refusals and scans, without line or clock. Its models are
in `emulator_models`, its mirror and what it measures in `emulator_sensor`.

Sources: Hokuyo, *Communication Protocol Specification For SCIP2.0* (C-42-03320B); for SCIP 1.1,
which the first URG-04LX uses after power-on, the drivers of Player and of Hokuyo.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cairn.components.hokuyo_scanner.emulator_models import (
    MODELS,
    ScipModel,
    spec_lines,
    version_lines,
)
from cairn.components.hokuyo_scanner.emulator_sensor import (
    SLOWEST,
    EmulatedRoom,
    EmulatedScene,
    EmulatedSensor,
    MeasureCommand,
    SentScan,
    Values,
    state_lines,
)
from cairn.components.hokuyo_scanner.protocol import (
    BLOCK,
    NO_ECHO,
    encode_number,
    encode_numbers,
    with_sum,
)

MEASURING = frozenset(family + kind for family in "GHMN" for kind in "DES") - {"HS", "NS"}
"""All commands that measure, of any model."""

COMMANDS = frozenset(
    ("VV", "PP", "II", "BM", "QT", "RS", "RT", "RB", "TM", "SS", "CR", "HS", "DB", "%ST", "%SL")
)

RS232_BAUDS = (19200, 38400, 57600, 115200, 250000, 500000, 750000)
"""Speeds of RS-232 [bit/s]."""

REBOOT_S = 1.0
"""How long a booting sensor receives nothing [s]."""

_REBOOT_WITHIN_S = 1.0  # RB must be received twice within this

# Statuses that DB makes a stream send instead of its next scans: a malfunction is verified and not
# confirmed, or confirmed; or there is one at once.
_SIMULATED = {
    "02": (),
    "03": ("21", "98"),
    "04": ("21", "50"),
    "05": ("50",),
    "10": (),
}

Answer = tuple[str, list[bytes]]
"""A status, and the lines that follow it."""

SCIP1_OK, SCIP1_REFUSED, SCIP1_UNKNOWN = "0", "1", "E"

SCIP1_SWITCH = "SCIP2.0"
"""The command that switches to SCIP 2, until power-off."""

_ECHO_MARK = ord("&")  # precedes each echo of a step but the first

_LONGEST = 128  # bytes of a command; anything longer is noise
_BACKLOG_S = 0.1  # older scans are not sent once a busy line is free
_STRING_LENGTH = 16
_STRING = re.compile(rb"[A-Za-z0-9 ._+@]*")
_LINE_END = re.compile(rb"[\r\n]")


@dataclass
class _Measuring:
    """A command that measures: how many scans are left, and the next one's turn."""

    request: MeasureCommand
    command: bytes
    string: bytes
    left: int
    turn: int

    def echo(self) -> bytes:
        """Return the echo of a scan: a stream's has the number of scans left after it."""
        if not self.request.is_stream:
            return self.command + self.string
        return self.command[:-2] + f"{self.left:02d}".encode() + self.string


class EmulatedScip:
    """A scanner of one of the `MODELS`. Implements `cairn.driver.emulator.EmulatedDevice`."""

    def __init__(
        self,
        model: str = "UTM-30LX",
        *,
        scene: EmulatedScene | None = None,
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
        """Create a scanner that is switched off; see `powered_on`.

        Args:
            model: one of `MODELS`.
            scene: its surroundings; None: an `EmulatedRoom`.
            seed: of the room.
            rs232_baud: it is on its RS-232 line, at this speed after power-on [bit/s], instead of
                USB or Ethernet.
            speaks_scip1: it uses SCIP 1.1 after power-on.
            knows_scip2: it can be switched from SCIP 1.1 to 2.
            clock_start_ms: its clock at power-on [ms].
            drift_ppm: by how much its clock goes too fast [1e-6].
            sums_arrows: False leaves what follows `<-` out of II's check sums, as some UTM-30LX
                do, whose state Hokuyo's own library cannot read.
            serial_number: as VV reports it.
            on_scan: called with each scan as it is sent.
        """
        self.model = MODELS[model]
        self.sensor = EmulatedSensor(
            self.model,
            scene or EmulatedRoom(self.model, seed),
            baud=rs232_baud,
            clock_start_ms=clock_start_ms,
            drift_ppm=drift_ppm,
            sums_arrows=sums_arrows,
        )
        self._commands = CommandHandler(self.sensor, serial_number)
        self._serial_number = serial_number
        self._starts_in_scip1 = speaks_scip1
        self._knows_scip2 = knows_scip2
        self._on_scan = on_scan
        self._measuring: _Measuring | None = None
        self.powered_on(0.0)

    def powered_on(self, now: float) -> None:
        """Start as after power-on."""
        self._rest = b""
        self._scip1 = self._starts_in_scip1
        self._measuring = None
        self.sensor.powered_on(now)

    def disconnected(self, _: float) -> None:
        """Discard an incomplete command; on Ethernet, stop measuring."""
        self._rest = b""
        if self.model.line == "ethernet":
            self.sensor.laser_off()
            self.sensor.adjusting = False
            self._measuring = None

    def baud(self) -> int | None:
        """Return the speed of its RS-232 line [bit/s]; USB and Ethernet have none."""
        return self.sensor.baud

    def send_status(self, status: str, scans: int = 1) -> None:
        """Send a status without data instead of the next scans of a stream.

        `0M`: temporarily unstable; 21 to 49: it stops to verify an error; 98: it continues; 50 to
        97: it has a defect, and the stream ends.
        """
        self.sensor.next_statuses.extend([status] * scans)

    def due(self) -> float:
        """Return when the next requested scan is measured [s]."""
        if self._measuring is None:
            return math.inf
        return self.sensor.mirror.measured(self._measuring.turn)

    def tick(self, now: float) -> list[bytes]:
        """Return the requested scans that have been measured meanwhile."""
        frames, newest = [], self.sensor.mirror.newest(now)
        while self._measuring is not None and self._measuring.turn <= newest:
            frames.append(self._next(self._measuring, now))
        return frames

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Take commands; return what is answered at once."""
        if now < self.sensor.deaf_until:
            return []
        *lines, self._rest = _LINE_END.split(self._rest + data)
        self._rest = self._rest[-_LONGEST:]
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
            return self._measure(line, command, semicolon + string, now)
        status, lines = self._commands.run(name, parameters, now)
        if not self.sensor.laser:
            self._measuring = None
        return reply(line, status, lines)

    def _measure(self, line: bytes, command: bytes, string: bytes, now: float) -> bytes | None:
        """Start measuring; a single scan is answered once it is measured."""
        text = command.decode("ascii", "replace")
        if text[:2] not in self.model.commands:
            is_ust = self.model.generation == "UST"
            return reply(line, "0F" if is_ust and text[:2] in MEASURING else "0E")
        if self.sensor.adjusting:
            return reply(line, "0E" if self.model.generation == "first" else "10")
        request = parse_measure_command(text[:2], text[2:], self.model)
        if isinstance(request, str):
            return reply(line, request)
        if self.sensor.defect is not None:
            return reply(line, self.sensor.defect)
        if request.is_stream:
            self.sensor.laser_on(now)
            self.sensor.streaming = True
            turn = self.sensor.mirror.next(now)
            self._measuring = _Measuring(request, command, string, request.scans, turn)
            return reply(line, "00")
        if not self.sensor.laser:
            return reply(line, "10")
        measuring = _Measuring(request, command, string, 1, self.sensor.newest_turn(now))
        if self._measuring is None and measuring.turn > self.sensor.mirror.newest(now):
            self._measuring = measuring
            return None
        return self._data(measuring, "00", measuring.turn)

    def _next(self, measuring: _Measuring, now: float) -> bytes:
        """Return the next requested scan that is not too old."""
        request = measuring.request
        if not request.is_stream:
            self._measuring = None
            return self._data(measuring, "00", measuring.turn)
        step = 1 + request.interval
        late = self.sensor.mirror.newest(now - _BACKLOG_S) - measuring.turn
        turn = measuring.turn + max(0, -(-late // step)) * step
        measuring.turn = turn + step
        if self.sensor.next_statuses:
            return self._status_instead(measuring, self.sensor.next_statuses.popleft())
        measuring.left = max(0, measuring.left - 1)
        frame = self._data(measuring, "99", turn)
        if request.scans and not measuring.left:
            self._measuring = None
            self.sensor.laser_off()
        return frame

    def _status_instead(self, measuring: _Measuring, status: str) -> bytes:
        if status.isdigit() and 50 <= int(status) <= 97:
            self.sensor.fail(status)
            self._measuring = None
        return reply(measuring.echo(), status)

    def _data(self, measuring: _Measuring, status: str, turn: int) -> bytes:
        scan = self._sent(turn, measuring.request)
        return scan_reply(measuring.echo(), status, scan)

    def _sent(self, turn: int, request: MeasureCommand) -> SentScan:
        scan = self.sensor.scan(turn, request)
        if self._on_scan is not None:
            self._on_scan(scan)
        return scan

    def _answer_scip1(self, line: bytes, text: str, now: float) -> bytes:
        lines: list[bytes] = []
        status = SCIP1_OK
        if text == SCIP1_SWITCH and self._knows_scip2:
            self._scip1 = False
        elif text == "V":
            lines = version_lines(self.model, self._serial_number)
            lines = [one[:-2] for one in lines]  # without semicolons and check sums
        elif text == "L0":
            self.sensor.laser_off()
        elif text == "L1":
            self.sensor.laser_on(now)
        elif text[:1] == "S" and len(text) == 14 and text[1:].isdigit():
            if int(text[1:7]) in RS232_BAUDS and self.sensor.baud is not None:
                self.sensor.baud = int(text[1:7])
            else:
                status = SCIP1_REFUSED
        elif text[:1] == "G":
            request = parse_scip1_gather(text[1:], self.model)
            if request is not None and self.sensor.laser:
                scan = self._sent(self.sensor.newest_turn(now), request)
                lines = scip1_scan_lines(scan.distances)
            else:
                status = SCIP1_REFUSED
        else:
            status = SCIP1_UNKNOWN
        return b"\n".join((line, status.encode(), *lines, b"", b""))


class CommandHandler:
    """Executes the `COMMANDS`, which do not measure, and answers them."""

    def __init__(self, sensor: EmulatedSensor, serial_number: str) -> None:
        self._sensor = sensor
        self._serial_number = serial_number
        self._reboot_asked = -math.inf

    def run(self, name: str, parameters: str, now: float) -> Answer:
        """Execute a command, or refuse it."""
        sensor = self._sensor
        first = sensor.model.generation == "first"
        if name not in sensor.model.commands:
            return "0F" if sensor.model.generation == "UST" else "0E", []
        if sensor.adjusting and first and name != "TM":
            return "0E", []
        if sensor.adjusting and name in ("BM", "QT"):
            return "10", []
        if sensor.defect is not None and not first and name in ("BM", "QT", "RS", "TM"):
            return "0L", []
        return self._run(name, parameters, now)

    def _run(self, name: str, parameters: str, now: float) -> Answer:
        sensor = self._sensor
        match name:
            case "VV":
                return "00", version_lines(sensor.model, self._serial_number)
            case "PP":
                return "00", spec_lines(sensor.model)
            case "II":
                return "00", state_lines(sensor, now)
            case "BM":
                return self._laser_on(now), []
            case "QT":
                sensor.laser_off()
            case "RS":
                sensor.reset(now)
            case "RT":
                sensor.reset(now, keep_speeds=True)
            case "RB":
                return self._reboot(now), []
            case "TM":
                return self._adjust(parameters, now)
            case "SS":
                return self._set_baud(parameters), []
            case "CR":
                return self._set_level(parameters, now), []
            case "HS":
                return self._set_sensitive(parameters), []
            case "DB":
                return self._simulate(parameters), []
            case "%ST":
                return "00", [with_sum(sensor.state_number().encode())]
            case "%SL":
                sensor.laser_off()
                sensor.asleep = True
        return "00", []

    def _laser_on(self, now: float) -> str:
        if self._sensor.defect is not None:
            return "01"
        if self._sensor.laser:
            return "02"
        self._sensor.laser_on(now)
        return "00"

    def _reboot(self, now: float) -> str:
        if now - self._reboot_asked > _REBOOT_WITHIN_S:
            self._reboot_asked = now
            return "01"
        self._reboot_asked = -math.inf
        self._sensor.powered_on(now)
        self._sensor.deaf_until = now + REBOOT_S
        return "00"

    def _adjust(self, parameters: str, now: float) -> Answer:
        """TM: the laser is off while host and sensor compare their clocks."""
        sensor = self._sensor
        if parameters not in ("0", "1", "2"):
            return "01", []
        if parameters == "1":
            if not sensor.adjusting and sensor.model.generation == "first":
                return "04", []  # the others report their time at any time
            return "00", [with_sum(encode_number(sensor.clock.ms(now), 4))]
        if sensor.adjusting == (parameters == "0"):
            return "02" if sensor.adjusting else "03", []
        if sensor.streaming and sensor.model.generation != "first":
            return "10", []
        sensor.laser_off()
        sensor.adjusting = parameters == "0"
        return "00", []

    def _set_baud(self, parameters: str) -> str:
        if len(parameters) < 6:
            return "0C"
        if not (parameters.isascii() and parameters.isdigit()):
            return "01"
        if int(parameters) not in RS232_BAUDS:
            return "02"
        if self._sensor.baud is None:
            return "04"
        if self._sensor.baud == int(parameters):
            return "03"
        self._sensor.baud = int(parameters)
        return "00"

    def _set_level(self, parameters: str, now: float) -> str:
        if len(parameters) != 2 or not (parameters.isascii() and parameters.isdigit()):
            return "01"
        level = 0 if parameters == "99" else int(parameters)
        if level > SLOWEST:
            return "02"
        if level == self._sensor.level:
            return "03"
        self._sensor.set_level(level, now)
        return "00"

    def _set_sensitive(self, parameters: str) -> str:
        if parameters not in ("0", "1"):
            return "01"
        if self._sensor.sensitive == (parameters == "1"):
            return "02"
        self._sensor.sensitive = parameters == "1"
        return "00"

    def _simulate(self, parameters: str) -> str:
        """DB: simulate a malfunction, to test the host's reaction."""
        if parameters not in _SIMULATED:
            return "01"
        if parameters == "02":
            self._sensor.fail("50")
        elif parameters == "10":
            self._sensor.defect = None
        self._sensor.next_statuses.extend(_SIMULATED[parameters])
        return "00"


def parse_measure_command(letters: str, parameters: str, model: ScipModel) -> MeasureCommand | str:
    """Parse a command that measures, as strictly as a real sensor; else return the refusal."""
    stream = letters[0] in "MN"
    lengths = (4, 4, 2, 1, 2) if stream else (4, 4, 2)
    if len(parameters) < sum(lengths):
        return "0C"
    if len(parameters) > sum(lengths):
        return "0D"
    values = []
    at = 0
    for length, status in zip(lengths, ("01", "02", "03", "06", "07"), strict=False):
        text = parameters[at : at + length]
        if not (text.isascii() and text.isdigit()):
            return status
        values.append(int(text))
        at += length
    first, last, cluster, *more = values
    if last > model.most_step:
        return "04"
    if last < first:
        return "05"
    return MeasureCommand(letters, first, last, max(1, cluster), *more)


def reply(echo: bytes, status: str, lines: Iterable[bytes] = ()) -> bytes:
    """Return a whole reply: the command's echo, its status, further lines, an empty line."""
    return b"\n".join((echo, with_sum(status.encode()), *lines, b"", b""))


def scan_reply(echo: bytes, status: str, scan: SentScan) -> bytes:
    """Return a whole reply with a scan: the time stamp, then values in lines of 64 characters.

    A number that does not fit into its characters is sent as the largest one that does.
    """
    stamp = with_sum(encode_number(scan.time_ms, 4))
    return reply(echo, status, (stamp, _blocks(_scan_text(scan))))


def _scan_text(scan: SentScan) -> NDArray[np.uint8]:
    width = scan.command.width
    parts = [scan.distances] if scan.intensities is None else [scan.distances, scan.intensities]
    sent_echoes = scan.distances if scan.command.multi_echo else scan.distances[:, :1]
    count, echoes = sent_echoes.shape
    most = (1 << 6 * width) - 1
    cells = np.empty((count, echoes, 1 + width * len(parts)), np.uint8)
    cells[..., 0] = _ECHO_MARK
    for place, values in enumerate(parts):
        numbers = np.clip(values[:, :echoes], 0, most).reshape(-1)
        text = np.frombuffer(encode_numbers(numbers, width), np.uint8)
        cells[..., 1 + width * place : 1 + width * (place + 1)] = text.reshape(count, echoes, width)
    sent = np.repeat((sent_echoes != NO_ECHO)[..., None], cells.shape[2], axis=2)
    sent[:, 0, 0] = False  # no mark before a first echo
    chosen: NDArray[np.uint8] = cells[sent]
    return chosen


def _blocks(text: NDArray[np.uint8]) -> bytes:
    full, rest = divmod(text.size, BLOCK)
    lines = np.full((full, BLOCK + 2), ord("\n"), np.uint8)
    lines[:, :BLOCK] = text[: full * BLOCK].reshape(full, BLOCK)
    lines[:, BLOCK] = (lines[:, :BLOCK].sum(axis=1) & 0x3F) + 0x30
    last = with_sum(text[full * BLOCK :].tobytes()) + b"\n" if rest else b""
    return (lines.tobytes() + last)[:-1]


def parse_scip1_gather(parameters: str, model: ScipModel) -> MeasureCommand | None:
    """Parse `G`: first step (3 digits), last (3), cluster (2); None if it is invalid."""
    if len(parameters) != 8 or not (parameters.isascii() and parameters.isdigit()):
        return None
    first, last, cluster = int(parameters[:3]), int(parameters[3:6]), int(parameters[6:])
    if not first <= last <= model.most_step:
        return None
    return MeasureCommand("GS", first, last, max(1, cluster))


def scip1_scan_lines(distances: Values) -> list[bytes]:
    """Return distances in two characters each, in lines of 64."""
    text = encode_numbers(np.clip(distances[:, 0], 0, 4095), 2)
    return [text[at : at + BLOCK] for at in range(0, len(text), BLOCK)]
