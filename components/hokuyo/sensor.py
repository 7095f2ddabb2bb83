"""A sensor that is connected: what it is, and how to begin what is asked of it."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TypeVar

from cairn import CairnError
from cairn.components.hokuyo.config import HokuyoConfig
from cairn.components.hokuyo.device_facts import Measuring
from cairn.components.hokuyo.dialogue import Dialogue, Stopped
from cairn.components.hokuyo.greeting import SPEEDS, greet
from cairn.components.hokuyo.requests import ScanRequest
from cairn.components.hokuyo.scip1 import Scip1
from cairn.components.hokuyo.scip2 import Refused, Scip2
from cairn.components.hokuyo.stamping import Stamping
from cairn.driver.errors import DeviceError, LinkLost
from cairn.driver.link import Link, SerialLink, TcpLink

T = TypeVar("T")

_BITS_PER_BYTE = 10  # start, eight of data, stop


@dataclass
class Sensor:
    """A sensor at the end of a line, its laser off, ready to be asked for scans."""

    link: Link
    dialogue: Dialogue
    protocol: Scip1 | Scip2
    baud: int
    version: Mapping[str, str]
    state: Mapping[str, str]
    """As it said when it was connected: asked while they stream, some sensors fall silent."""
    stamping: Stamping

    @property
    def measuring(self) -> Measuring:
        """How it measures."""
        return self.protocol.measuring

    @property
    def serial_number(self) -> str:
        """What tells it from others; empty if it does not say."""
        return self.version.get("SERI", "")

    def synchronize(self, *, read_clock: bool) -> None:
        """Find out anew how its clock goes; with `read_clock` by reading it, 0.1 s.

        For each time that it begins to measure: while it rests its clock drifts unseen.
        """
        self.stamping = Stamping(self.measuring)
        if read_clock and isinstance(self.protocol, Scip2):
            self.stamping.calibrate(_if_known(self.protocol.read_clock, []))

    def begin(self, config: HokuyoConfig) -> ScanRequest:
        """Have it send scans as the parameters say, without what it cannot: what it sends.

        Raises `DeviceError` if it does not begin at all.
        """
        try:
            wanted = request_of(config, self.measuring)
        except CairnError as error:
            raise DeviceError(f"{self.link.name}: {error}") from error
        if isinstance(self.protocol, Scip1):
            plain = replace(wanted, intensity=False, multi_echo=False, skip=0, encoding=2)
            self.protocol.start(plain)
            return plain
        for request in _lesser(wanted):
            try:
                self.protocol.start(request)
            except Refused as refused:
                last = refused
            else:
                return request
        raise last

    def line_s(self, request: ScanRequest) -> float:
        """Least time that the line takes for a scan [s]."""
        return scan_bytes(request) * _BITS_PER_BYTE / self.baud if self.link.paced else 0.0


def connect(
    config: HokuyoConfig, speeds: Sequence[int] = (), stopping: threading.Event | None = None
) -> Sensor:
    """Open the line and find out about the sensor at its end, at one of these speeds.

    Without `speeds` at all that sensors have, the configured one first, which it has in the end.
    Raises `DeviceError`, and `Stopped` soon after `stopping` is set.
    """
    link = _opened(config)
    try:
        dialogue = Dialogue(link, stopping)
        others = tuple(speed for speed in SPEEDS if speed != config.baud)
        bauds = speeds or ((config.baud, *others) if config.host is None else (config.baud,))
        greeting = greet(dialogue, bauds)
        if not greeting.scip2:
            first = Scip1(dialogue)
            stamping = Stamping(first.measuring)
            return Sensor(link, dialogue, first, greeting.baud, first.version(), {}, stamping)
        protocol, baud = Scip2(dialogue), greeting.baud
        if baud != config.baud and config.host is None:
            with suppress(Refused):  # then it keeps the one that it has
                protocol.set_speed(config.baud)
                baud = config.baud
        nothing: Mapping[str, str] = {}
        version = _if_known(protocol.version, nothing)
        state = _if_known(protocol.state, nothing)
        stamping = Stamping(protocol.measuring)
        return Sensor(link, dialogue, protocol, baud, version, state, stamping)
    except BaseException:
        link.close()
        raise


def request_of(config: HokuyoConfig, measuring: Measuring) -> ScanRequest:
    """The request for what the parameters ask for, of a sensor that measures so.

    Raises `CairnError` if not two rays lie between the angles.
    """
    per_radian = measuring.turn_steps / (2.0 * math.pi)
    first = math.ceil(measuring.front + config.angle_min * per_radian - 1e-6)
    last = math.floor(measuring.front + config.angle_max * per_radian + 1e-6)
    request = ScanRequest(
        first=max(first, measuring.first),
        last=min(last, measuring.last),
        cluster=config.cluster,
        skip=config.skip,
        intensity=config.intensity,
        multi_echo=config.multi_echo,
        encoding=config.encoding,
    )
    if request.last < request.first or request.values < 2:
        sees = [(step - measuring.front) / per_radian for step in (measuring.first, measuring.last)]
        raise CairnError(
            f"angle_min = {config.angle_min:g} rad, angle_max = {config.angle_max:g} rad and "
            f"cluster = {config.cluster} leave no two rays of a {measuring.model}, which sees from "
            f"{sees[0]:.4g} to {sees[1]:.4g} rad"
        )
    return request


def scan_bytes(request: ScanRequest) -> int:
    """The length of a scan's reply with one echo for each ray [bytes]."""
    characters = request.values * request.encoding * (2 if request.intensity else 1)
    lines = -(-characters // 64)
    return len(request.command) + 1 + 4 + 6 + characters + 2 * lines + 1


def _if_known(ask: Callable[[], T], otherwise: T) -> T:
    """What a sensor answers to what not every sensor knows, and measures without."""
    try:
        return ask()
    except (LinkLost, Stopped):
        raise
    except DeviceError:
        return otherwise


def _opened(config: HokuyoConfig) -> Link:
    if config.host is not None:
        return TcpLink(config.host, config.tcp_port)
    if config.port is None:
        raise DeviceError("neither port nor host is given")
    return SerialLink(config.port, config.baud)


def _lesser(wanted: ScanRequest) -> list[ScanRequest]:
    """What was asked for, then with less and less of what not every sensor has."""
    tries = [wanted]
    if wanted.multi_echo and wanted.intensity:
        tries.append(replace(wanted, intensity=False))
    if wanted.multi_echo:
        tries.append(replace(wanted, multi_echo=False))
    if wanted.intensity or wanted.encoding == 2:
        tries.append(replace(wanted, multi_echo=False, intensity=False, encoding=3))
    return tries
