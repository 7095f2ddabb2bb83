"""The client side of SCIP on a line: handshake, commands and their replies, beside a scan stream.

`handshake` finds the speed and version of a sensor and stops its activity; `Scip1` and `Scip2`
are the commands of each version.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TypeVar

from cairn.components.hokuyo_scanner.protocol import (
    URG_04LX,
    Reply,
    ReplySplitter,
    ScanRequest,
    ScipError,
    SensorSpec,
    decode_number,
    parse_fields,
    scip1_scan_command,
    sensor_spec,
    without_sum,
)
from cairn.driver.errors import DeviceError, LinkLost
from cairn.driver.serial_and_tcp import Link

T = TypeVar("T")

BAUDS = (115200, 19200, 57600, 750000, 500000, 250000, 38400)
"""All speeds of command SS [bit/s], the usual ones first."""

_REPLY_TIMEOUT_S = 0.5  # sensors answer within milliseconds, but computers may be busy
_LONGEST_REPLY_BYTES = 500  # of those that are not scans
_POLL_S = 0.1  # how often `stopping` is checked
_BITS_PER_BYTE = 10  # start, eight of data, stop
_TRIES = 3  # how often a command is sent that every sensor knows
_DAMAGED_TRIES = 3  # damaged replies in a row, after which the line counts as unusable
_HANDSHAKE_TRIES = 4
_QUIET_S, _QUIET_TIMEOUT_S = 0.14, 0.5
_SPEED_CHANGE_S = 0.15
_CLOCK_READINGS = 10
_SHOWN_BYTES = 40  # of a reply that is not understood
_LASER_OFF = "10"
_VERSION_KEYS = ("VEND", "PROD", "FIRM", "PROT", "SERI")


class NoReply(DeviceError):
    """A sensor has not replied to a command."""


class Stopped(DeviceError):
    """A command was given up because the driver is stopping."""


class CommandRefused(DeviceError):
    """A sensor has refused a command; `code` is its status."""

    def __init__(self, message: str, code: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True)
class TimedReply:
    """A reply, and when its last byte was received [ns of the system's monotonic clock]."""

    reply: Reply
    at: int


@dataclass(frozen=True)
class ClockReading:
    """The sensor's clock [ms], read between two times [ns of the system's monotonic clock]."""

    time_ms: int
    sent: int
    received: int


@dataclass(frozen=True)
class Handshake:
    """The protocol of a sensor, SCIP 2 or else 1.1, and its speed [bit/s]."""

    scip2: bool
    baud: int


class ScipClient:
    """Sends commands and finds their replies among everything received. For one thread."""

    def __init__(self, link: Link, stopping: threading.Event | None = None) -> None:
        """Commands are given up once `stopping` is set."""
        self.link = link
        self.stopping = stopping
        self.bytes_received = 0
        self.last_received = b""
        self.reply_timeout_s = _REPLY_TIMEOUT_S
        """How long a reply is awaited [s]."""
        self._splitter = ReplySplitter()
        self._kept: deque[TimedReply] = deque()

    @property
    def noise(self) -> int:
        """How many bytes belonged to no reply so far."""
        return self._splitter.noise

    def set_baud(self, baud: int) -> None:
        """Change the speed [bit/s], and await replies as long as they take at that speed."""
        self.link.set_baud(baud)
        line_s = _LONGEST_REPLY_BYTES * _BITS_PER_BYTE / baud if self.link.paced else 0.0
        self.reply_timeout_s = _REPLY_TIMEOUT_S + line_s

    def request(self, command: str, tries: int = _TRIES) -> Reply:
        """Send a command, and return its reply; other replies are kept for `replies`.

        A command or its reply may be damaged on the line, so it is sent several times; no command
        of SCIP does harm if it arrives twice. Raises `NoReply`, `LinkLost`.
        """
        for _ in range(tries):
            self.send(command)
            reply = self.find(command)
            if reply is not None:
                return reply
        raise NoReply(f"{self.link.name}: the sensor does not reply to {command}")

    def send(self, command: str) -> None:
        """Send a command without awaiting its reply; raises `LinkLost`."""
        self.link.write(command.encode("ascii") + b"\n")

    def find(self, command: str) -> Reply | None:
        """Return the reply to a sent command, None if it is late; other replies are kept."""
        echo = command.encode("ascii")
        deadline = time.monotonic() + self.reply_timeout_s
        while (left_s := deadline - time.monotonic()) > 0:
            self._check_stopping()
            found = None
            for timed in self._receive(min(left_s, _POLL_S)):
                # The rest of a stream may precede the first reply after it.
                if found is None and timed.reply.echo.endswith(echo):
                    found = timed.reply
                else:
                    self._kept.append(timed)
            if found is not None:
                return found
        return None

    def replies(self, timeout_s: float) -> list[TimedReply]:
        """Return the replies received, waiting up to `timeout_s` [s]; raises `LinkLost`."""
        if self._kept:
            kept = list(self._kept)
            self._kept.clear()
            return kept
        return self._receive(timeout_s)

    def drain(self, quiet_s: float, timeout_s: float) -> None:
        """Discard what is received until the line is quiet for a while, or the time is over."""
        deadline = time.monotonic() + timeout_s
        while self.link.read(quiet_s) and time.monotonic() < deadline:
            self._check_stopping()
        self.discard()

    def discard(self) -> None:
        """Discard everything received so far."""
        self.link.discard()
        self._splitter.clear()
        self._kept.clear()

    def _check_stopping(self) -> None:
        if self.stopping is not None and self.stopping.is_set():
            raise Stopped(f"{self.link.name}: command given up, as the driver is stopping")

    def _receive(self, timeout_s: float) -> list[TimedReply]:
        data = self.link.read(timeout_s)
        at = time.monotonic_ns()
        self.bytes_received += len(data)
        self.last_received = data or self.last_received
        return [TimedReply(reply, at) for reply in self._splitter.feed(data)] if data else []


def handshake(client: ScipClient, bauds: Sequence[int]) -> Handshake:
    """Stop a sensor's activity, at the first of these speeds [bit/s] at which it replies.

    It may be streaming, be in the mode that adjusts clocks, or use SCIP 1.1, from which it is
    switched to 2 if it can. Its laser is off then. Raises `DeviceError` if nothing replies.
    """
    for baud in bauds:
        try:
            client.set_baud(baud)
        except LinkLost:
            raise
        except DeviceError:
            if baud == bauds[0]:
                raise  # this one was configured
            continue
        scip2 = _stopped(client)
        if scip2 is not None:
            return Handshake(scip2, baud)
    tried = f" (tried {', '.join(map(str, bauds))} bit/s)" if len(bauds) > 1 else ""
    raise DeviceError(
        f"{client.link.name}: nothing replies as a SCIP sensor{tried}; "
        + (
            f"what is received is not SCIP: {client.last_received[-_SHOWN_BYTES:]!r}; check that "
            "this is the scanner's port"
            if client.last_received
            else "check that it is switched on, and that no other program uses it"
        )
    )


class Scip1:
    """Commands of SCIP 1.1: an URG-04LX with the firmware of its first years.

    It has no stream, no clock, no check sums and no command that returns how it measures: the
    driver asks for each scan.
    """

    def __init__(self, client: ScipClient) -> None:
        """Use a client after its `handshake`."""
        self._client = client
        self._name = client.link.name
        self._request: ScanRequest | None = None
        self._next_turn = 0.0
        self.spec = URG_04LX

    def version(self) -> Mapping[str, str]:
        """Return maker, product, firmware, protocol and serial number: VEND, PROD, ..., SERI."""
        lines = [line.decode("ascii", "replace") for line in self._client.request("V").lines]
        found = dict(line.split(":", 1) for line in lines if ":" in line)
        return found or dict(zip(_VERSION_KEYS, lines, strict=False))

    def start(self, request: ScanRequest) -> None:
        """Switch the laser on; `replies` asks for scans from now on."""
        self._switch_laser("L1")
        self._request = request

    def replies(self, timeout_s: float) -> list[TimedReply]:
        """Return the next scan's reply, waiting for it as long as for any reply.

        A sensor that is asked more often than it turns sends the same scan again: until a turn is
        over it is not asked, and nothing is received within `timeout_s` [s].
        """
        if self._request is None:
            return []
        now = time.monotonic()
        if now < self._next_turn:
            return self._client.replies(min(timeout_s, self._next_turn - now))
        self._next_turn = max(self._next_turn + self.spec.turn_s, now)
        command = scip1_scan_command(self._request)
        self._client.send(command)
        reply = self._client.find(command)
        return [] if reply is None else [TimedReply(reply, time.monotonic_ns())]

    def stop(self) -> None:
        """Switch the laser off."""
        self._request = None
        self._switch_laser("L0")

    def _switch_laser(self, command: str) -> None:
        status = self._client.request(command).status
        if status != b"0":
            raise DeviceError(
                f"{self._name}: the sensor does not switch its laser (status "
                f"{status.decode('ascii', 'replace')}); see its manual"
            )


class Scip2:
    """Commands of SCIP 2.0, 2.1 and 2.2."""

    def __init__(self, client: ScipClient) -> None:
        """Ask how the sensor measures; raises `DeviceError` if its reply is not understood."""
        self._client = client
        self._name = client.link.name
        try:
            self.spec: SensorSpec = sensor_spec(self._fields("PP"))
        except ScipError as error:
            raise DeviceError(f"{self._name}: {error}") from error

    def version(self) -> Mapping[str, str]:
        """Return maker, product, firmware, protocol and serial number: VEND, PROD, ..., SERI."""
        return self._fields("VV", tries=1)

    def state(self) -> Mapping[str, str]:
        """Return the sensor's state by the sensor's keys: LASR, SCSP, MESM, SBPS, TIME, STAT."""
        return self._fields("II", tries=1)

    def set_baud(self, baud: int) -> None:
        """Change the speed of sensor and line [bit/s]; raises `CommandRefused`, `DeviceError`."""
        code, _ = self._status(f"SS{baud:06d}")
        if code not in ("00", "03"):
            raise CommandRefused(
                f"{self._name}: the sensor refuses {baud} bit/s (status {code})", code
            )
        self._client.set_baud(baud)
        self._client.drain(_SPEED_CHANGE_S, _SPEED_CHANGE_S)

    def read_clock(self) -> list[ClockReading]:
        """Read its clock several times, the laser off; empty if it has no such mode."""
        readings: list[ClockReading] = []
        code, _ = self._status("TM0", tries=1)
        if code not in ("00", "02"):
            return readings
        for _ in range(_CLOCK_READINGS):
            sent = time.monotonic_ns()
            self._client.send("TM1")
            reply = self._client.find("TM1")
            received = time.monotonic_ns()
            try:
                if reply is not None and reply.code() == "00":
                    time_ms = decode_number(without_sum(reply.body))
                    readings.append(ClockReading(time_ms, sent, received))
            except ScipError:
                continue  # damaged on the line: one of ten
        self._status("TM2")
        return readings

    def start(self, request: ScanRequest) -> None:
        """Switch the laser on and start a stream; raises `CommandRefused` if it cannot."""
        self._client.discard()
        command = request.command.decode("ascii")
        code, _ = self._status(command)
        if code == _LASER_OFF:  # some models do not switch it on by themselves
            self._status("BM")
            code, _ = self._status(command)
        if code not in ("00", "99"):  # 99: the reply was lost, and this is a scan
            raise CommandRefused(
                f"{self._name}: the sensor refuses {command} (status {code})", code
            )

    def replies(self, timeout_s: float) -> list[TimedReply]:
        """Return the replies received, waiting up to `timeout_s` [s]."""
        return self._client.replies(timeout_s)

    def stop(self) -> None:
        """Stop the stream and switch the laser off."""
        self._status("QT")
        self._client.discard()

    def _fields(self, command: str, *, tries: int = _TRIES) -> Mapping[str, str]:
        def read(reply: Reply) -> Mapping[str, str]:
            if reply.code() != "00":
                raise ScipError(f"its status is {reply.code()}")
            return parse_fields(reply.lines)

        return self._parsed(command, read, tries)

    def _status(self, command: str, *, tries: int = _TRIES) -> tuple[str, list[bytes]]:
        """Return the status of a command's reply, and the lines that follow."""
        return self._parsed(command, lambda reply: (reply.code(), reply.lines), tries)

    def _parsed(self, command: str, read: Callable[[Reply], T], tries: int) -> T:
        """Return a command's reply, parsed by `read`; repeat the command if the reply is damaged.

        A reply that does not arrive at all is awaited `tries` times.
        """
        for _ in range(_DAMAGED_TRIES - 1):
            with suppress(ScipError):
                return read(self._client.request(command, tries))
        try:
            return read(self._client.request(command, tries))
        except ScipError as error:
            raise DeviceError(
                f"{self._name}: the reply to {command} is not understood: {error}"
            ) from error


def _stopped(client: ScipClient) -> bool | None:
    """Stop a sensor; return whether it uses SCIP 2, None if it does not reply."""
    client.send("")  # ends an incomplete command on the line
    client.drain(_QUIET_S, _QUIET_TIMEOUT_S)
    refusal = ""
    for _ in range(_HANDSHAKE_TRIES):
        before = client.bytes_received
        client.send("QT")
        reply = client.find("QT")
        if reply is None:
            if client.bytes_received == before:
                break
            continue  # a device replied: the reply may be damaged, or follow a scan
        match reply.status:
            case b"00P":
                return True
            case b"0" | b"E":
                return _switched_to_scip2(client)
            case b"0Ee" | b"10Q":  # it adjusts clocks, and takes no other command
                client.send("TM2")
                client.find("TM2")
            case other:
                refusal = other.decode("ascii", "replace")
    if refusal:
        raise DeviceError(
            f"{client.link.name}: a sensor is there, but replies to QT with status {refusal}: it "
            "is starting, or has a defect; see its manual"
        )
    return None


def _switched_to_scip2(client: ScipClient) -> bool:
    client.send("L0")  # it has no command QT, and may be measuring
    client.find("L0")
    client.send("SCIP2.0")
    reply: Reply | None = client.find("SCIP2.0")
    return reply is not None and reply.status == b"0"
