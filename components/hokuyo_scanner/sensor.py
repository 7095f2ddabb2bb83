"""A connected sensor, and the loop that has it measure: connects, watches, restarts its stream.

A silent sensor gets the command to start again here; one that was unplugged is opened again by
`cairn.driver.device_thread`.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TypeVar

from cairn import CairnError
from cairn.components.hokuyo_scanner.client import (
    BAUDS,
    CommandRefused,
    NoReply,
    Scip1,
    Scip2,
    ScipClient,
    Stopped,
    handshake,
)
from cairn.components.hokuyo_scanner.config import HokuyoConfig
from cairn.components.hokuyo_scanner.protocol import (
    BLOCK,
    ScanData,
    ScanParser,
    ScanRequest,
    SensorDefect,
    SensorSpec,
)
from cairn.components.hokuyo_scanner.stamping import ScanStamper
from cairn.driver.errors import DeviceError, LinkLost
from cairn.driver.serial_and_tcp import Link, SerialLink, TcpLink

T = TypeVar("T")

_BITS_PER_BYTE = 10  # start, eight of data, stop
_POLL_S = 0.1
_TURNS_OF_GRACE = 2  # a scan may arrive one turn late
_DAMAGED_GRACE = 10  # damage alone is tolerated for this many times the silence
# How often a sensor that does not reply is tried at its last speed alone: trying all speeds takes
# long, and a sensor that starts, or a busy computer, needs some time.
_TRIES_AT_LAST_SPEED = 5


@dataclass
class ConnectedSensor:
    """A sensor at the end of a line, its laser off, ready to be asked for scans."""

    link: Link
    client: ScipClient
    protocol: Scip1 | Scip2
    baud: int
    version: Mapping[str, str]
    state: Mapping[str, str]
    """As reported when it was connected: asked while they stream, some sensors fall silent."""
    stamper: ScanStamper

    @property
    def spec(self) -> SensorSpec:
        """How it measures."""
        return self.protocol.spec

    @property
    def serial_number(self) -> str:
        """Its serial number; empty if it does not report one."""
        return self.version.get("SERI", "")

    def synchronize(self, *, read_clock: bool) -> None:
        """Find the offset of its clock again; with `read_clock` by reading it, 0.1 s.

        Call this each time it starts measuring: while it rests, its clock drifts unnoticed.
        """
        self.stamper = ScanStamper(self.spec)
        if read_clock and isinstance(self.protocol, Scip2):
            self.stamper.calibrate(_optional(self.protocol.read_clock, []))

    def start(self, config: HokuyoConfig) -> ScanRequest:
        """Start the scans that the parameters ask for; return what is sent, without the options
        that it does not have.

        Raises `DeviceError` if it does not start at all.
        """
        try:
            full = request_of(config, self.spec)
        except CairnError as error:
            raise DeviceError(f"{self.link.name}: {error}") from error
        if isinstance(self.protocol, Scip1):
            plain = replace(full, intensity=False, multi_echo=False, skip=0, encoding=2)
            self.protocol.start(plain)
            return plain
        for request in _fallbacks(full):
            try:
                self.protocol.start(request)
            except CommandRefused as refusal:
                last = refusal
            else:
                return request
        raise last

    def line_s(self, request: ScanRequest) -> float:
        """Return the least time that the line takes for a scan [s]."""
        return scan_bytes(request) * _BITS_PER_BYTE / self.baud if self.link.paced else 0.0


@dataclass(frozen=True)
class StampedScan:
    """A scan, its request, and when its first ray was measured [ns, monotonic clock]."""

    data: ScanData
    request: ScanRequest
    sensor: ConnectedSensor
    first_ray: int


class Measurement:
    """Has a sensor measure: connects it, starts the stream, watches it, starts it again.

    `run` is for a `DeviceThread`. Other threads may read the attributes, and set `config`.
    """

    def __init__(self, config: HokuyoConfig, on_scan: Callable[[StampedScan], None]) -> None:
        self.config = config
        self.parser = ScanParser()
        self.sensor: ConnectedSensor | None = None
        self.request: ScanRequest | None = None
        self.spec: SensorSpec | None = None
        """How the sensor that was connected last measures."""
        self.restarts = 0
        """How often a silent sensor got the command to start again."""
        self.connections = 0
        self._on_scan = on_scan
        self._last_baud: int | None = None
        self._failures = 0

    def connect(self, stopping: threading.Event | None = None) -> ConnectedSensor:
        """Connect the sensor; raises `DeviceError`, `Stopped` soon after `stopping` is set."""
        last = self._last_baud if self._failures < _TRIES_AT_LAST_SPEED else None
        try:
            sensor = connect(self.config, () if last is None else (last,), stopping)
        except LinkLost:  # which says nothing about its speed
            raise
        except DeviceError:
            self._failures += 1
            raise
        self._last_baud, self._failures = sensor.baud, 0
        self.connections += 1
        self.sensor, self.spec = sensor, sensor.spec
        return sensor

    def disconnect(self) -> None:
        """Close the line, after a command to rest, should the sensor receive it."""
        sensor, self.sensor, self.request = self.sensor, None, None
        if sensor is not None:
            with suppress(DeviceError):  # it is gone
                sensor.client.send("QT")
            sensor.link.close()

    def run(self, stopping: threading.Event, report_working: Callable[[str], None]) -> None:
        """Have it measure until `stopping`; its laser is off then, and it stays connected.

        Raises `DeviceError` if the sensor fails, also if it cannot be stopped.
        """
        try:
            with suppress(Stopped):
                sensor = self.sensor or self.connect(stopping)
                sensor.client.stopping = stopping
                sensor.synchronize(read_clock=self.config.calibrate_time)
                self._measure(sensor, stopping, report_working)
            self._rest()
        except BaseException:
            self.disconnect()
            raise

    def _rest(self) -> None:
        self.request = None
        if self.sensor is None:
            return
        self.sensor.client.stopping = None  # this command is part of stopping
        try:
            self.sensor.protocol.stop()
        except NoReply as error:
            raise DeviceError(
                f"{self.sensor.link.name}: the sensor does not reply to the command to stop; its "
                "laser may still be on"
            ) from error

    def _measure(
        self,
        sensor: ConnectedSensor,
        stopping: threading.Event,
        report_working: Callable[[str], None],
    ) -> None:
        restarted = False
        while not stopping.is_set():
            config = self.config
            request = self.request = sensor.start(config)
            any_scan = self._follow(sensor, request, config, stopping, report_working)
            if self.config is config and not stopping.is_set():
                if restarted and not any_scan:
                    raise DeviceError(
                        f"{sensor.link.name}: no scan for {config.silence_s:g} s, although the "
                        f"sensor got the command to start again{self._damage()}"
                    )
                restarted = True
                self.restarts += 1
            if isinstance(sensor.protocol, Scip2) and not stopping.is_set():
                sensor.protocol.stop()

    def _follow(
        self,
        sensor: ConnectedSensor,
        request: ScanRequest,
        config: HokuyoConfig,
        stopping: threading.Event,
        report_working: Callable[[str], None],
    ) -> bool:
        """Receive scans until the parameters change, or none arrives; return whether any did.

        A sensor that sends anything is alive: to start it again would repair nothing, and cost more
        scans. Only damage that lasts long may come from something else than the line.
        """
        scip2 = isinstance(sensor.protocol, Scip2)
        any_scan = False
        line_s = sensor.line_s(request)
        silence_s = config.silence_s + _TURNS_OF_GRACE * max(
            line_s, sensor.spec.turn_s * (request.skip + 1)
        )
        received_at = scan_at = time.monotonic()
        bytes_received = sensor.client.bytes_received
        while self.config is config and not stopping.is_set():
            for timed in sensor.protocol.replies(_POLL_S):
                try:
                    data = self.parser.parse(timed.reply, request, scip2=scip2)
                except SensorDefect as defect:
                    raise DeviceError(
                        f"{sensor.link.name}: the sensor reports a defect (status {defect.code}); "
                        "see its manual"
                    ) from defect
                if data is None:
                    continue
                scan_at = time.monotonic()
                if not any_scan:
                    any_scan = True
                    which = f"{sensor.spec.model} {sensor.serial_number}".rstrip()
                    report_working(f"{sensor.link.name}: {which} measures again")
                first = sensor.stamper.first_ray(data.time_ms, timed.at, request, line_s)
                self._on_scan(StampedScan(data, request, sensor, first))
            now = time.monotonic()
            if sensor.client.bytes_received != bytes_received:  # a slow line takes long for a scan
                received_at, bytes_received = now, sensor.client.bytes_received
            if now - received_at > silence_s or now - scan_at > _DAMAGED_GRACE * silence_s:
                break
        return any_scan

    def _damage(self) -> str:
        last = self.parser.last_damage
        return f"; {self.parser.damaged} damaged replies, the last: {last}" if last else ""


def connect(
    config: HokuyoConfig, bauds: Sequence[int] = (), stopping: threading.Event | None = None
) -> ConnectedSensor:
    """Open the line and identify the sensor at its end, at one of these speeds.

    Without `bauds` at all that sensors have, the configured one first, to which it is set.
    Raises `DeviceError`, and `Stopped` soon after `stopping` is set.
    """
    link = _open(config)
    try:
        client = ScipClient(link, stopping)
        others = tuple(baud for baud in BAUDS if baud != config.baud)
        tried = bauds or ((config.baud, *others) if config.host is None else (config.baud,))
        found = handshake(client, tried)
        if not found.scip2:
            first = Scip1(client)
            stamper = ScanStamper(first.spec)
            return ConnectedSensor(link, client, first, found.baud, first.version(), {}, stamper)
        protocol, baud = Scip2(client), found.baud
        if baud != config.baud and config.host is None:
            with suppress(CommandRefused):  # then it keeps the speed that it has
                protocol.set_baud(config.baud)
                baud = config.baud
        nothing: Mapping[str, str] = {}
        version = _optional(protocol.version, nothing)
        state = _optional(protocol.state, nothing)
        stamper = ScanStamper(protocol.spec)
        return ConnectedSensor(link, client, protocol, baud, version, state, stamper)
    except BaseException:
        link.close()
        raise


def request_of(config: HokuyoConfig, spec: SensorSpec) -> ScanRequest:
    """Return the request by the parameters, for a sensor with this spec.

    Raises `CairnError` unless at least two rays lie between the angles.
    """
    per_radian = spec.turn_steps / (2.0 * math.pi)
    first = math.ceil(spec.front + config.angle_min * per_radian - 1e-6)
    last = math.floor(spec.front + config.angle_max * per_radian + 1e-6)
    request = ScanRequest(
        first=max(first, spec.first),
        last=min(last, spec.last),
        cluster=config.cluster,
        skip=config.skip,
        intensity=config.intensity,
        multi_echo=config.multi_echo,
        encoding=config.encoding,
    )
    if request.last < request.first or request.values < 2:
        limits = [(step - spec.front) / per_radian for step in (spec.first, spec.last)]
        raise CairnError(
            f"angle_min = {config.angle_min:g} rad, angle_max = {config.angle_max:g} rad and "
            f"cluster = {config.cluster} leave no two rays of a {spec.model}, which measures from "
            f"{limits[0]:.4g} to {limits[1]:.4g} rad"
        )
    return request


def scan_bytes(request: ScanRequest) -> int:
    """Return the length of a scan's reply with one echo for each ray [bytes]."""
    characters = request.values * request.encoding * (2 if request.intensity else 1)
    lines = -(-characters // BLOCK)
    return len(request.command) + 1 + 4 + 6 + characters + 2 * lines + 1


def _optional(ask: Callable[[], T], otherwise: T) -> T:
    """Return a sensor's reply to a command that not every sensor has, and can measure without."""
    try:
        return ask()
    except (LinkLost, Stopped):
        raise
    except DeviceError:
        return otherwise


def _open(config: HokuyoConfig) -> Link:
    if config.host is not None:
        return TcpLink(config.host, config.tcp_port)
    if config.port is None:
        raise DeviceError("neither port nor host is set; set one of them")
    return SerialLink(config.port, config.baud)


def _fallbacks(full: ScanRequest) -> list[ScanRequest]:
    """Return the request, then with fewer and fewer options that not every sensor has."""
    tries = [full]
    if full.multi_echo and full.intensity:
        tries.append(replace(full, intensity=False))
    if full.multi_echo:
        tries.append(replace(full, multi_echo=False))
    if full.intensity or full.encoding == 2:
        tries.append(replace(full, multi_echo=False, intensity=False, encoding=3))
    return tries
