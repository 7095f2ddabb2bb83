"""SCIP, Hokuyo's protocol, as pure functions: commands, replies, check sums, scans.

Bytes in, values out; no line and no clock. Damaged replies are detected and dropped here: see
`ScipError` and `ScanParser`.

Source: Hokuyo, *Communication Protocol Specification For SCIP2.0* (C-42-03320B): "Data encoding",
"Check sum", "Sensor's commands"; multi-echo models: the UTM-30LX-EW's specification.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

BLOCK = 64
"""Characters of data in a full line; a check sum and a line feed follow them."""

NO_ECHO = -1
"""In place of an echo that a step does not have."""

Encoding = Literal[2, 3]
"""Characters of a distance: 3 for up to 262 m, 2 for up to 4.095 m, a third less on the line."""

_ZERO = 0x30
_BASE = 64
_FULL_LINE = BLOCK + 2  # its data, its check sum, its line feed
_ECHO_MARK = ord("&")  # precedes each echo of a step but the first
_MOST_ECHOES = 3
_REPLY_END = b"\n\n"
_LONGEST_REPLY = 65536  # bytes; anything longer is noise
_WITH_DATA, _STARTED = "99", "00"  # statuses of a stream
_DEFECTS = range(50, 98)  # statuses by which a sensor reports that its hardware has a defect
_SCIP1_WIDTH = 2


class ScipError(ValueError):
    """Text that SCIP does not allow: damaged on the line, or of another protocol."""


class SensorDefect(Exception):
    """A sensor reports that its hardware has a defect; `code` is its status."""

    def __init__(self, code: str) -> None:
        super().__init__(code)
        self.code = code


@dataclass(frozen=True)
class ScanRequest:
    """A stream of scans without end: which steps, how many of them per value, which scans.

    `cluster` neighboring steps become one value, the smallest; `skip` scans are left out after each
    one.
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
        """How many steps, or clusters of steps, a scan has."""
        return -(-(self.last - self.first + 1) // self.cluster)

    @property
    def command(self) -> bytes:
        """The command that starts the stream: MD, MS, ME, ND or NE."""
        return self._prefix + b"00"

    @property
    def _prefix(self) -> bytes:
        letters = "N" if self.multi_echo else "M"
        letters += "E" if self.intensity else "D" if self.encoding == 3 or self.multi_echo else "S"
        steps = f"{self.first:04d}{self.last:04d}"
        return f"{letters}{steps}{self.cluster:02d}{self.skip:01d}".encode()

    def is_echo(self, echo: bytes) -> bool:
        """Whether a reply's echo is of this stream; its last two digits count scans down."""
        return echo[:-2] == self._prefix and echo[-2:].isdigit()


@dataclass(frozen=True)
class Reply:
    """One reply as it was received: the command's echo, the status, then the data."""

    echo: bytes
    status: bytes
    """As received: in SCIP 2 two characters and a check sum, in SCIP 1.1 one character."""
    body: bytes
    """All lines after the status, each but the last with its line feed."""

    @property
    def lines(self) -> list[bytes]:
        """The lines after the status, check sums included."""
        return self.body.split(b"\n") if self.body else []

    def code(self) -> str:
        """Return the status without its check sum; raises `ScipError` if that is wrong."""
        return without_sum(self.status).decode("ascii", "replace")


class ReplySplitter:
    """Splits received bytes into replies. After noise it recovers at the next empty line."""

    def __init__(self) -> None:
        self._rest = b""
        self.noise = 0
        """How many bytes belonged to no reply so far."""

    def feed(self, data: bytes) -> list[Reply]:
        """Return the replies that these bytes complete."""
        self._rest += data
        if _REPLY_END not in data and _REPLY_END not in self._rest[-len(data) - 1 :]:
            if len(self._rest) > _LONGEST_REPLY:
                self.clear()
            return []
        *parts, self._rest = self._rest.split(_REPLY_END)
        return [reply for part in parts if (reply := self._reply(part)) is not None]

    def clear(self) -> None:
        """Discard an incomplete reply."""
        self.noise += len(self._rest)
        self._rest = b""

    def _reply(self, part: bytes) -> Reply | None:
        # A reply without its end, or a line feed too many, leaves line feeds before the next one.
        part = part.lstrip(b"\n")
        echo, _, rest = part.partition(b"\n")
        status, _, body = rest.partition(b"\n")
        if not status:
            self.noise += len(part)
            return None
        return Reply(echo, status, body)


@dataclass(frozen=True)
class SensorSpec:
    """The measuring properties of a sensor, from its reply to command PP.

    Angles are counted in steps, `turn_steps` in a full turn, to the left; step `front` is ahead.
    """

    model: str
    least_mm: int
    most_mm: int
    turn_steps: int
    first: int
    last: int
    front: int
    rpm: int

    @property
    def turn_s(self) -> float:
        """Time of a turn of its mirror [s]."""
        return 60.0 / self.rpm


# Sensors with SCIP 1.1 alone have no command PP; the only one is the first URG-04LX.
URG_04LX = SensorSpec("URG-04LX", 20, 5600, 1024, 44, 725, 384, 600)


@dataclass(frozen=True)
class ScanData:
    """What a sensor has measured in one turn, as it was sent.

    `time_ms`: the sensor's clock, of 24 bits, at step 0 [ms]; SCIP 1.1 has none. `distances` [mm;
    or a code of what failed]: shape (values, echoes), `NO_ECHO` for a missing echo; one echo
    unless several were requested. `intensities` [no unit]: the same shape, if requested.
    """

    time_ms: int | None
    distances: NDArray[np.int32]
    intensities: NDArray[np.int32] | None = None


class ScanParser:
    """Parses the scans of a stream; counts damaged replies and statuses instead of scans.

    The counts are of all streams since it was created.
    """

    def __init__(self) -> None:
        self.good = 0
        self.damaged = 0
        self.last_damage = ""
        self.statuses: dict[str, int] = {}
        """How often the sensor sent a status instead of a scan, by status."""

    def parse(self, reply: Reply, request: ScanRequest, *, scip2: bool) -> ScanData | None:
        """Return the scan in a reply; None if it holds none, or a damaged one, which is counted.

        Raises `SensorDefect` if the sensor reports one.
        """
        try:
            data = self._parse2(reply, request) if scip2 else self._parse1(reply, request)
        except ScipError as error:
            self.damaged += 1
            self.last_damage = str(error)
            return None
        if data is not None:
            self.good += 1
        return data

    def _parse2(self, reply: Reply, request: ScanRequest) -> ScanData | None:
        if not request.is_echo(reply.echo):
            raise ScipError(f"a reply begins with {reply.echo[:40]!r}")
        code = reply.code()
        if code == _WITH_DATA:
            return scan_data(reply, request)
        if code != _STARTED:
            self.statuses[code] = self.statuses.get(code, 0) + 1
        if code.isdigit() and int(code) in _DEFECTS:
            raise SensorDefect(code)
        return None

    def _parse1(self, reply: Reply, request: ScanRequest) -> ScanData:
        if not reply.echo.endswith(scip1_scan_command(request).encode("ascii")):
            raise ScipError(f"a reply begins with {reply.echo[:40]!r}")
        return scip1_scan_data(reply, request)


def scan_data(reply: Reply, request: ScanRequest) -> ScanData:
    """Return the scan in a SCIP 2 reply of status 99 to the request.

    Raises `ScipError` if a check sum is wrong, or if it holds anything but the requested data:
    bytes that were lost or added must not shift one beam's range to another.
    """
    stamp, _, body = reply.body.partition(b"\n")
    time_ms = decode_number(without_sum(stamp))
    if len(stamp) != 5:
        raise ScipError(f"the time {stamp!r} is not of four characters")
    text = _joined(body)
    width = 2 if request.command.startswith(b"MS") else 3
    if request.multi_echo:
        numbers, step, echo = _echoes(text, 2 * width if request.intensity else width)
        steps = int(step[-1]) + 1 if step.size else 0
    else:
        numbers, step, echo = text, None, None
        steps, rest = divmod(text.size, 2 * width if request.intensity else width)
        if rest:
            raise ScipError(f"{text.size} characters are not a whole number of values")
    values = decode_numbers(numbers, width).reshape(-1, 2 if request.intensity else 1)
    if steps != request.values:
        raise ScipError(f"{steps} values were received, but {request.values} were requested")
    columns = [_by_echo(values[:, one], step, echo, steps) for one in range(values.shape[1])]
    return ScanData(time_ms, columns[0], columns[1] if request.intensity else None)


def scip1_scan_command(request: ScanRequest) -> str:
    """Return the command of SCIP 1.1 that asks for one scan."""
    return f"G{request.first:03d}{request.last:03d}{request.cluster:02d}"


def scip1_scan_data(reply: Reply, request: ScanRequest) -> ScanData:
    """Return the scan in a SCIP 1.1 reply; raises `ScipError` unless it is the requested one.

    SCIP 1.1 has no check sums: only missing values and invalid numbers reveal damage.
    """
    if reply.status != b"0":
        raise ScipError(f"its status is {reply.status!r}")
    lines = reply.lines
    if not lines:
        raise ScipError("the reply has no data")
    if any(len(line) != BLOCK for line in lines[:-1]) or len(lines[-1]) > BLOCK:
        raise ScipError("a line of data does not have 64 characters")
    values = decode_numbers(np.frombuffer(b"".join(lines), np.uint8), _SCIP1_WIDTH)
    if values.size != request.values:
        raise ScipError(f"{values.size} values were received, but {request.values} were requested")
    return ScanData(None, values.reshape(-1, 1))


def parse_fields(lines: Sequence[bytes]) -> dict[str, str]:
    """Return the values of lines such as `MODL:UTM-30LX;3`, by key, after checking their sums.

    Sensors sum up the line with its semicolon or without it, and the UTM-30LX leaves out what
    follows `<-` in a line of II. Raises `ScipError` if none of these sums is right.
    """
    fields = {}
    for line in lines:
        text, received = line[:-1], line[-1:]
        summed = (text, text.removesuffix(b";"), text.partition(b"<-")[0])
        if not any(check_sum(one) == received for one in summed):
            raise ScipError(f"the check sum of {line!r} is wrong")
        key, colon, value = text.decode("ascii", "replace").removesuffix(";").partition(":")
        if colon:
            fields[key.strip()] = value.strip()
    return fields


def sensor_spec(fields: Mapping[str, str]) -> SensorSpec:
    """Return how a sensor measures, from the fields of PP; unknown keys are ignored.

    Raises `ScipError` that names what is missing or impossible.
    """
    keys = ("DMIN", "DMAX", "ARES", "AMIN", "AMAX", "AFRT", "SCAN")
    try:
        numbers = [int(fields[key]) for key in keys]
    except KeyError as error:
        raise ScipError(f"the answer to PP has no {error.args[0]}") from error
    except ValueError as error:
        raise ScipError(f"the answer to PP has a value that is not a number: {error}") from error
    spec = SensorSpec(fields.get("MODL", "unknown"), *numbers)
    if not (
        0 <= spec.least_mm < spec.most_mm
        and 0 <= spec.first < spec.last
        and spec.turn_steps > 0
        and spec.last - spec.first < spec.turn_steps
        and spec.rpm > 0
    ):
        raise ScipError(f"the answer to PP is impossible: {dict(fields)}")
    return spec


def check_sum(text: bytes) -> bytes:
    """Return the character that is sent after `text`: the sum's lowest six bits, printable."""
    return bytes([(sum(text) & 0x3F) + _ZERO])


def with_sum(text: bytes) -> bytes:
    """Return a line's text with its check sum."""
    return text + check_sum(text)


def without_sum(line: bytes) -> bytes:
    """Return a line's text without its check sum; raises `ScipError` if that is wrong."""
    text = line[:-1]
    if not text or check_sum(text) != line[-1:]:
        raise ScipError(f"the check sum of {_shown(line)} is wrong")
    return text


def encode_number(value: int, width: int) -> bytes:
    """Return a number in `width` characters of six bits, the highest first.

    Raises `ScipError` if it is too large.
    """
    if not 0 <= value < _BASE**width:
        raise ScipError(f"{value} does not fit into {width} characters")
    return bytes(_ZERO + (value >> 6 * place) % _BASE for place in reversed(range(width)))


def decode_number(text: bytes) -> int:
    """Return the number that these characters encode; raises `ScipError` for other characters."""
    value = 0
    for character in text:
        if not _ZERO <= character < _ZERO + _BASE:
            raise ScipError(f"{_shown(text)} is not a number")
        value = value * _BASE + character - _ZERO
    return value


def encode_numbers(values: NDArray[np.integer], width: int) -> bytes:
    """Return numbers of `width` characters each, one after the other.

    Raises `ScipError` if one is too large.
    """
    if values.size and not 0 <= values.min() <= values.max() < _BASE**width:
        raise ScipError(f"there are values that do not fit into {width} characters")
    places = 6 * np.arange(width - 1, -1, -1)
    digits = (values.astype(np.int64)[:, None] >> places) % _BASE
    return (digits + _ZERO).astype(np.uint8).tobytes()


def decode_numbers(text: NDArray[np.uint8], width: int) -> NDArray[np.int32]:
    """Return the numbers that characters encode, `width` of them (at most 5) each.

    Raises `ScipError` if a character is not a digit of SCIP, or the last number is not whole.
    """
    digits = text - np.uint8(_ZERO)  # what is below "0" becomes large
    if text.size % width or (text.size and int(digits.max()) >= _BASE):
        raise ScipError(f"{text.size} characters are not numbers of {width} characters")
    weights = _BASE ** np.arange(width - 1, -1, -1, dtype=np.int32)
    return digits.reshape(-1, width).astype(np.int32) @ weights


def _joined(body: bytes) -> NDArray[np.uint8]:
    """Return the data of all lines in one, after checking their sums."""
    full, rest = divmod(len(body) + 1, _FULL_LINE)  # the reply's end took the last line feed
    data = np.frombuffer(body + b"\n", np.uint8)
    lines = data[: full * _FULL_LINE].reshape(-1, _FULL_LINE)
    if np.any(lines[:, -1] != 10):
        raise ScipError("a line of data does not have 64 characters")
    sums = (lines[:, :BLOCK].sum(axis=1) & 0x3F) + 0x30
    if np.any(sums != lines[:, BLOCK]):
        raise ScipError("the check sum of a line of data is wrong")
    text = lines[:, :BLOCK].reshape(-1)
    if rest == 0:
        return text
    last = without_sum(body[full * _FULL_LINE :])
    return np.concatenate((text, np.frombuffer(last, np.uint8)))


def _echoes(
    text: NDArray[np.uint8], width: int
) -> tuple[NDArray[np.uint8], NDArray[np.intp], NDArray[np.intp]]:
    """Return the characters without `&`; and for each `width` of them their step and echo."""
    marks = np.flatnonzero(text == _ECHO_MARK)
    numbers = text[text != _ECHO_MARK]
    before = marks - np.arange(marks.size)  # characters before each mark
    if numbers.size % width or np.any(before % width) or np.any(before >= numbers.size):
        raise ScipError("an echo's mark stands within a value")
    is_further = np.zeros(numbers.size // width, bool)
    is_further[before // width] = True
    if np.count_nonzero(is_further) != marks.size or (is_further.size and is_further[0]):
        raise ScipError("an echo's mark has no echo after it")
    step = np.cumsum(~is_further) - 1
    firsts = np.flatnonzero(~is_further)
    echo = np.arange(is_further.size) - firsts[step] if step.size else step
    if echo.size and int(echo.max()) >= _MOST_ECHOES:
        raise ScipError(f"a step has more than {_MOST_ECHOES} echoes")
    return numbers, step, echo


def _by_echo(
    values: NDArray[np.int32],
    step: NDArray[np.intp] | None,
    echo: NDArray[np.intp] | None,
    steps: int,
) -> NDArray[np.int32]:
    if step is None or echo is None:
        return values.reshape(-1, 1)
    table = np.full((steps, _MOST_ECHOES), NO_ECHO, np.int32)
    table[step, echo] = values
    return table


def _shown(text: bytes) -> str:
    return repr(text[:40].decode("ascii", "replace"))
