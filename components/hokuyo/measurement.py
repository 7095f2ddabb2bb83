"""Measures with a sensor, on a thread of its own, as long as it is told to."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from cairn.components.hokuyo.config import HokuyoConfig
from cairn.components.hokuyo.device_facts import Measuring
from cairn.components.hokuyo.dialogue import NoAnswer, Stopped
from cairn.components.hokuyo.requests import ScanRequest
from cairn.components.hokuyo.scan_data import ScanData
from cairn.components.hokuyo.scip2 import Scip2
from cairn.components.hokuyo.sensor import Sensor, connect
from cairn.components.hokuyo.stream import Defect, ScanStream
from cairn.driver.errors import DeviceError, LinkLost

_LISTEN_S = 0.1
_TURNS = 2  # a scan may be one late
_DAMAGED = 10  # so many times longer than silence, damage alone is borne
# So often a sensor that does not answer is asked at the speed at which it answered before: trying
# all speeds takes long, and one that starts, or a computer that is busy, needs some time.
_FAITHFUL = 5


@dataclass(frozen=True)
class Measured:
    """A scan, what was asked for, and when its first ray was measured [ns, monotonic clock]."""

    data: ScanData
    request: ScanRequest
    sensor: Sensor
    first_ray: int


class Measurement:
    """Has a sensor measure: connects it, begins the stream, watches it, begins anew.

    `converse` is for a `DeviceThread`. Other threads may read the attributes, and set `config`.
    """

    def __init__(self, config: HokuyoConfig, on_scan: Callable[[Measured], None]) -> None:
        self.config = config
        self.stream = ScanStream()
        self.sensor: Sensor | None = None
        self.request: ScanRequest | None = None
        self.measuring: Measuring | None = None
        """How the sensor that was connected last measures."""
        self.restarts = 0
        """How often a silent sensor was told to begin anew."""
        self.connections = 0
        self._on_scan = on_scan
        self._known_speed: int | None = None
        self._unanswered = 0

    def connect(self, stopping: threading.Event | None = None) -> Sensor:
        """Connect the sensor; raises `DeviceError`, `Stopped` soon after `stopping` is set."""
        known = self._known_speed if self._unanswered < _FAITHFUL else None
        try:
            sensor = connect(self.config, () if known is None else (known,), stopping)
        except LinkLost:  # which tells nothing of its speed
            raise
        except DeviceError:
            self._unanswered += 1
            raise
        self._known_speed, self._unanswered = sensor.baud, 0
        self.connections += 1
        self.sensor, self.measuring = sensor, sensor.measuring
        return sensor

    def disconnect(self) -> None:
        """Let go of the sensor, and tell it to rest, should it hear that."""
        sensor, self.sensor, self.request = self.sensor, None, None
        if sensor is not None:
            with suppress(DeviceError):  # it is gone
                sensor.dialogue.send("QT")
            sensor.link.close()

    def converse(self, stopping: threading.Event, well: Callable[[str], None]) -> None:
        """Have it measure until `stopping`; its laser is off then, and it stays connected.

        Raises `DeviceError` if the sensor fails, also if it cannot be told to rest.
        """
        try:
            with suppress(Stopped):
                sensor = self.sensor or self.connect(stopping)
                sensor.dialogue.stopping = stopping
                sensor.synchronize(read_clock=self.config.calibrate_time)
                self._measure(sensor, stopping, well)
            self._rest()
        except BaseException:
            self.disconnect()
            raise

    def _rest(self) -> None:
        self.request = None
        if self.sensor is None:
            return
        self.sensor.dialogue.stopping = None  # this question is asked to stop
        try:
            self.sensor.protocol.stop()
        except NoAnswer as error:
            raise DeviceError(
                f"{self.sensor.link.name}: the sensor does not answer, so its laser may still be on"
            ) from error

    def _measure(
        self, sensor: Sensor, stopping: threading.Event, well: Callable[[str], None]
    ) -> None:
        anew = False
        while not stopping.is_set():
            config = self.config
            request = self.request = sensor.begin(config)
            came = self._follow(sensor, request, config, stopping, well)
            if self.config is config and not stopping.is_set():
                if anew and not came:
                    raise DeviceError(
                        f"{sensor.link.name}: no scan for {config.silence_s:g} s, though the "
                        f"sensor was told to begin anew{self._damage()}"
                    )
                anew = True
                self.restarts += 1
            if isinstance(sensor.protocol, Scip2) and not stopping.is_set():
                sensor.protocol.stop()

    def _follow(
        self,
        sensor: Sensor,
        request: ScanRequest,
        config: HokuyoConfig,
        stopping: threading.Event,
        well: Callable[[str], None],
    ) -> bool:
        """Take scans until something changes, or none comes; whether any came.

        A sensor of which anything comes is alive: to begin anew with it would mend nothing, and
        cost more scans. Only if that goes on for long it may be something else than the line.
        """
        scip2 = isinstance(sensor.protocol, Scip2)
        came = False
        line_s = sensor.line_s(request)
        silence_s = config.silence_s + _TURNS * max(
            line_s, sensor.measuring.turn_s * (request.skip + 1)
        )
        heard = good = time.monotonic()
        bytes_received = sensor.dialogue.heard
        while self.config is config and not stopping.is_set():
            for arrival in sensor.protocol.arrivals(_LISTEN_S):
                try:
                    data = self.stream.take(arrival.reply, request, scip2=scip2)
                except Defect as defect:
                    raise DeviceError(
                        f"{sensor.link.name}: the sensor says that it has a defect (status "
                        f"{defect.code}); see its manual"
                    ) from defect
                if data is None:
                    continue
                good = time.monotonic()
                if not came:
                    came = True
                    which = f"{sensor.measuring.model} {sensor.serial_number}".rstrip()
                    well(f"{sensor.link.name}: {which} measures again")
                first = sensor.stamping.first_ray(data.time_ms, arrival.at, request, line_s)
                self._on_scan(Measured(data, request, sensor, first))
            now = time.monotonic()
            if sensor.dialogue.heard != bytes_received:  # a scan may take long on a slow line
                heard, bytes_received = now, sensor.dialogue.heard
            if now - heard > silence_s or now - good > _DAMAGED * silence_s:
                break
        return came

    def _damage(self) -> str:
        last = self.stream.last_damage
        return f"; of {self.stream.damaged} damaged replies the last one: {last}" if last else ""
