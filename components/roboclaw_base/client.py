"""The client side of a RoboClaw's line: open it, send commands with retries, prepare for driving.

`RoboclawClient` repeats commands whose replies are missing or damaged, `EncoderReader` stamps
encoder counts, and `handshake` sets, reads back and checks what driving depends on.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from cairn import CairnError
from cairn.components.roboclaw_base import protocol
from cairn.components.roboclaw_base.kinematics import BaseLimits, WheelGeometry, count_difference
from cairn.components.roboclaw_base.protocol import (
    ACKNOWLEDGED,
    CRC_SIZE,
    ENCODERS,
    MAIN_VOLTAGES,
    NEW_MAIN_VOLTAGES,
    PACKET_TIMEOUT_S,
    SPEED_LOOPS,
    TIMEOUT,
    TIMEOUT_STEP_S,
    ControllerStatus,
    ReadCommand,
    WriteCommand,
    read_packet,
    reply_data,
    write_packet,
)
from cairn.driver.errors import DeviceError, LinkLost
from cairn.driver.serial_and_tcp import Link, SerialLink, TcpLink

_TCP = "tcp:"
_BITS_PER_BYTE = 10  # start, eight of data, stop
_LATE_BYTES = 128  # of earlier replies, which may precede the reply that is awaited
_READINGS = 3
_PROMPT_S = 0.004  # a reply that takes so much longer than usual was late
_USUAL_GROWTH = 1.02  # per reading: a line that becomes slower is usual after a while
_FULL_SPEED_SHARE = 0.95  # the speed loop needs a reserve


class UnusableControllerError(CairnError):
    """The RoboClaw works, but must not drive this base with its present settings."""


@dataclass
class PacketCounts:
    """How many packets were sent, and how many of them once more."""

    packets: int = 0
    retries: int = 0
    missing: int = 0
    """Retries because the reply, or a part of it, did not arrive in time."""
    damaged: int = 0
    """Retries because something else than the reply arrived, or its CRC was wrong."""


@dataclass(frozen=True)
class EncoderReading:
    """The counters of M1 and M2, and when they were read: halfway from command to reply."""

    at: float
    """[s of the monotonic clock]"""
    stamp: int
    """The same by the system's clock [ns]."""
    counts: tuple[int, ...]

    def since(self, before: EncoderReading) -> tuple[int, int]:
        """Return how far both have counted since another reading."""
        pairs = zip(before.counts, self.counts, strict=True)
        first, second = (count_difference(a, b) for a, b in pairs)
        return first, second

    def from_zero(self) -> tuple[int, int]:
        """Return how far both are from 0, where they start when the RoboClaw is switched on."""
        first, second = (count_difference(0, count) for count in self.counts)
        return first, second


@dataclass(frozen=True)
class ControllerHandshake:
    """What was found out about a RoboClaw that is ready to drive."""

    version: str
    fastest_wheel: float
    """The speed that both wheels can hold [m/s]."""
    kept_power: bool
    """Whether it still had the driver's serial timeout: then its counters have gone on."""


def open_line(port: str, baud: int) -> Link:
    """Open a serial port, or a serial device server for `tcp:HOST:PORT`; raises `LinkLost`."""
    if not port.startswith(_TCP):
        return SerialLink(port, baud)
    host, _, number = port.removeprefix(_TCP).rpartition(":")
    if not (host and number.isdecimal() and int(number) < 65536):
        raise LinkLost(f"{port} names no TCP port; write it as tcp:192.168.0.7:4001")
    return TcpLink(host, int(number))


class RoboclawClient:
    """Sends commands to one RoboClaw on a line, one packet at a time.

    All packets that it sends may arrive twice without harm: none of them is relative.
    """

    def __init__(
        self,
        link: Link,
        address: int,
        baud: int,
        counts: PacketCounts,
        *,
        reply_timeout_s: float = 0.06,
        tries: int = 4,
    ) -> None:
        """`reply_timeout_s`: for a reply, in addition to its bytes at `baud` [bit/s]."""
        self._link = link
        self._address = address
        self._byte_s = _BITS_PER_BYTE / baud
        self._counts = counts
        self._timeout_s = reply_timeout_s
        self._tries = tries
        self._shorter: set[int] = set()  # commands whose replies are known to be short

    def write(self, command: WriteCommand) -> None:
        """Send a command that sets something, until acknowledged; raises `DeviceError`."""
        packet = write_packet(self._address, command.command, command.data)
        self._exchange(command.command, packet, len(ACKNOWLEDGED), _acknowledgment)

    def read(self, command: ReadCommand) -> tuple[int, ...]:
        """Return the numbers that a command reads; raises `DeviceError`."""
        return command.decode(self._read(command.command, command.size, self._parser(command)))

    def read_either(self, longer: ReadCommand, shorter: ReadCommand) -> tuple[int, ...]:
        """Return the numbers of a reply that is longer in newer firmware.

        Which length it has is found out by the first reply, and remembered.
        """
        if longer.command in self._shorter:
            return self.read(shorter)
        parse, parse_short = self._parser(longer), self._parser(shorter)
        data = self._read(longer.command, longer.size, parse, at_timeout=parse_short)
        if len(data) == longer.size:
            return longer.decode(data)
        self._shorter.add(longer.command)
        return shorter.decode(data)

    def version(self) -> str:
        """Return the product's name and the version of its firmware."""

        def parse(reply: bytes) -> bytes | None:
            end = reply.find(protocol.VERSION_END)
            if end < 0:
                return None
            size = end + len(protocol.VERSION_END) + CRC_SIZE
            return reply_data(self._address, protocol.READ_VERSION, reply[:size])

        data = self._read(protocol.READ_VERSION, protocol.LONGEST_VERSION, parse)
        return data.rstrip(protocol.VERSION_END).decode("ascii", "replace")

    def status(self) -> ControllerStatus:
        """Return the status bits by name, of old or new firmware."""
        (bits,) = self.read_either(protocol.STATUS, protocol.OLD_STATUS)
        return protocol.decode_status(bits, old=protocol.READ_STATUS in self._shorter)

    def _parser(self, command: ReadCommand) -> Callable[[bytes], bytes | None]:
        size = command.size + CRC_SIZE

        def parse(reply: bytes) -> bytes | None:
            # A late reply to an earlier command may precede it.
            return reply_data(self._address, command.command, reply[-size:])

        return parse

    def _read(
        self,
        command: int,
        size: int,
        parse: Callable[[bytes], bytes | None],
        at_timeout: Callable[[bytes], bytes | None] | None = None,
    ) -> bytes:
        packet = read_packet(self._address, command)
        return self._exchange(command, packet, size + CRC_SIZE, parse, at_timeout)

    def _exchange(
        self,
        command: int,
        packet: bytes,
        size: int,
        parse: Callable[[bytes], bytes | None],
        at_timeout: Callable[[bytes], bytes | None] | None = None,
    ) -> bytes:
        """Send a packet until its reply arrives: at most `size` bytes, turned to data by `parse`.

        `at_timeout` parses what has arrived when the time is over.
        """
        self._counts.packets += 1
        reply = b""
        deadline = time.monotonic() + self._tries * (self._timeout_s + 4.0 * PACKET_TIMEOUT_S)
        for attempt in range(self._tries):
            if attempt and time.monotonic() > deadline + self._tries * size * self._byte_s:
                break  # this process was held up: the command may be wrong by now
            if attempt:
                self._counts.retries += 1
                # In this time the RoboClaw discards a partial packet, and sends what it still has.
                self._link.read(2.0 * PACKET_TIMEOUT_S)
            self._link.discard()
            self._link.write(packet)
            reply, data = self._receive(size, parse)
            if data is None and at_timeout is not None:
                data = at_timeout(reply)
            if data is not None:
                return data
            if len(reply) < size:
                self._counts.missing += 1
            else:
                self._counts.damaged += 1
        raise DeviceError(
            f"{self._link.name}: the RoboClaw at address 0x{self._address:02x} "
            + (
                f"answers command {command} with an invalid reply ({reply[:16].hex(' ')})"
                if reply
                else f"does not answer command {command}"
            )
            + "; check that it is in packet serial mode, and that address and baud are right"
        )

    def _receive(
        self, size: int, parse: Callable[[bytes], bytes | None]
    ) -> tuple[bytes, bytes | None]:
        reply = b""
        deadline = time.monotonic() + self._timeout_s + size * self._byte_s
        while len(reply) < size + _LATE_BYTES:
            received = self._link.read(max(0.0, deadline - time.monotonic()))
            if not received:
                break
            reply += received
            data = parse(reply)
            if data is not None:
                return reply, data
        return reply, None


class EncoderReader:
    """Reads both counters in one packet.

    If the reply takes longer than usual on this line, the time of the reading is uncertain, and
    they are read again: otherwise speeds would be wrong by the share that this is of a period.
    """

    def __init__(self, client: RoboclawClient) -> None:
        self._client = client
        self._usual_s = float("inf")

    def read(self) -> EncoderReading:
        """Read the counters now; raises `DeviceError`."""
        readings = []
        for _ in range(_READINGS):
            took_s, reading = self._read_once()
            readings.append((took_s, reading))
            self._usual_s = min(took_s, self._usual_s * _USUAL_GROWTH)
            if took_s < self._usual_s + _PROMPT_S:
                break
        return min(readings, key=lambda timed: timed[0])[1]

    def _read_once(self) -> tuple[float, EncoderReading]:
        sent, sent_ns = time.monotonic(), time.time_ns()
        counts = self._client.read(ENCODERS)
        took_s, took_ns = time.monotonic() - sent, time.time_ns() - sent_ns
        return took_s, EncoderReading(sent + 0.5 * took_s, sent_ns + took_ns // 2, counts)


def handshake(
    client: RoboclawClient,
    geometry: WheelGeometry,
    limits: BaseLimits,
    timeout_s: float,
    main_voltages: tuple[float, float] | None,
) -> ControllerHandshake:
    """Set the serial timeout and the battery's limits, and check that speed loops are tuned.

    Args:
        client: the line to the RoboClaw.
        geometry: of the base.
        limits: of the base; the wheels must be able to reach them.
        timeout_s: silence after which the RoboClaw stops the motors by itself [s].
        main_voltages: lowest and highest of the main battery [V]; None leaves them as they are.

    Raises `DeviceError` if it does not answer, `UnusableControllerError` if it must not be used so.
    """
    version = client.version()
    kept_power = _set_timeout(client, version, timeout_s)
    if main_voltages is not None:
        _set_main_voltages(client, version, main_voltages)
    return ControllerHandshake(
        version, _fastest_wheel(client, version, geometry, limits), kept_power
    )


def has_timeout(client: RoboclawClient, timeout_s: float) -> bool:
    """Return whether the RoboClaw's serial timeout is `timeout_s` [s]."""
    return client.read(TIMEOUT) == (protocol.timeout_steps(timeout_s),)


def _set_timeout(client: RoboclawClient, version: str, timeout_s: float) -> bool:
    kept_power = has_timeout(client, timeout_s)
    client.write(protocol.set_timeout(timeout_s))
    if not has_timeout(client, timeout_s):
        (found,) = client.read(TIMEOUT)
        raise UnusableControllerError(
            f"{version}: its serial timeout is {found * TIMEOUT_STEP_S:g} s after {timeout_s:g} s "
            "were set; without it nothing would stop the wheels if this process hung, so it is not "
            "used: update its firmware"
        )
    return kept_power


def _set_main_voltages(client: RoboclawClient, version: str, limits: tuple[float, float]) -> None:
    _, _, *rest = client.read_either(NEW_MAIN_VOLTAGES, MAIN_VOLTAGES)
    client.write(protocol.set_main_voltages(*limits, *rest))
    low, high, *_ = client.read_either(NEW_MAIN_VOLTAGES, MAIN_VOLTAGES)
    if (low, high) != tuple(round(10 * limit) for limit in limits):
        raise UnusableControllerError(
            f"{version}: the main battery's limits are {low / 10:g} to {high / 10:g} V after "
            f"{limits[0]:g} to {limits[1]:g} V were set; this model may not take them: change "
            "battery_min_v and battery_max_v"
        )


def _fastest_wheel(
    client: RoboclawClient, version: str, geometry: WheelGeometry, limits: BaseLimits
) -> float:
    loops = [client.read(loop) for loop in SPEED_LOOPS]
    for number, (p, i, d, full_speed) in enumerate(loops, start=1):
        if not full_speed or not (p or i or d):
            raise UnusableControllerError(
                f"{version}: the speed loop of M{number} is not tuned (P {p}, I {i}, D {d}, QPPS "
                f"{full_speed}); tune it in Motion Studio and save it, see docs/drivers/base.md"
            )
    fastest = _FULL_SPEED_SHARE * geometry.fastest_wheels(loops[0][3], loops[1][3])
    if limits.speed > fastest:
        raise UnusableControllerError(
            f"{version}: the wheels reach {fastest:.2f} m/s by the QPPS of its speed loops, less "
            f"than speed = {limits.speed:g} m/s; lower speed, or correct wheel_radius, "
            "counts_per_turn or QPPS"
        )
    return fastest


def _acknowledgment(reply: bytes) -> bytes | None:
    return reply if reply == ACKNOWLEDGED else None
