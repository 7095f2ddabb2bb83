"""The driver: ports, parameters, life cycle, and the loop on the device thread."""

import math
import threading
import time
from typing import ClassVar, Literal

import numpy as np
from cairn import (
    SECOND,
    SENSOR,
    Component,
    Config,
    Out,
    ParameterRejected,
    SensorFrame,
    every,
    from_ns,
)
from cairn.driver.device_clock import DeviceClock
from cairn.driver.device_names import SerialPort
from cairn.driver.device_thread import DeviceFeed
from cairn.driver.diagnostics import ERROR, OK, WARN, diagnostics
from cairn.driver.errors import DeviceError
from cairn.driver.serial_and_tcp import SerialLink
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from pydantic import Field

from lantern_driver import protocol
from lantern_driver.protocol import DamagedLine, Lines, Turn

_POLL_S = 0.1
_SILENCE_S = 1.0  # a Lantern that is silent for longer does not measure
_STEP = math.pi / (protocol.BEAMS - 1)


class LanternConfig(Config):
    """Parameters of the driver."""

    port: SerialPort = Field(
        description="Serial port: /dev/serial/by-id/..., or usb:VENDOR:PRODUCT[:SERIAL]."
    )
    frame_id: SensorFrame = Field("laser", description="Frame of the scans.")
    farthest: float = Field(
        8.0, ge=0.1, le=8.0, description="Farther ranges count as nothing hit [m]."
    )


class LanternScanner(Component):
    """Measures ranges with a Lantern on a serial line."""

    clock_source: ClassVar[Literal["device"]] = "device"
    config: LanternConfig

    scan: Out[LaserScan] = Out(qos=SENSOR)
    diagnostics: Out[DiagnosticArray]

    def on_configure(self) -> None:
        """Check that the line is there; raises `LinkLost`, with its name, if not."""
        self._damaged = 0
        self._feed = DeviceFeed(self, self._serve, self._publish)
        SerialLink(self.config.port, protocol.BAUD).close()

    def on_activate(self) -> None:
        """Start measuring."""
        self._feed.start()

    def on_deactivate(self) -> None:
        """Stop measuring, and close the line."""
        self._feed.stop()

    def on_error(self, error: Exception) -> bool:
        """Stop measuring, and close the line; the supervisor decides what follows."""
        self._feed.stop()
        return False

    def on_parameters(self, new: Config) -> None:
        """Accept another reach at once, but no other line or frame."""
        assert isinstance(new, LanternConfig)
        if (new.port, new.frame_id) != (self.config.port, self.config.frame_id):
            raise ParameterRejected(
                f"{self.name}: port and frame_id are fixed while it runs; restart it"
            )

    @every(hz=1)
    def report(self) -> None:
        """Publish the device's health."""
        hz = self._feed.hz()
        level, text = OK, f"{hz:.1f} scans per second"
        if self._feed.device_error:
            level, text = ERROR, self._feed.device_error
        elif abs(hz - protocol.RATE_HZ) > 0.1 * protocol.RATE_HZ:
            level = WARN
        values = {
            "rate [Hz]": hz,
            "damaged lines": self._damaged,
            "dropped scans": self._feed.dropped,
        }
        now, port = self.clock.now(), self.config.port
        self.diagnostics.publish(diagnostics(now, self.name, port, level, text, values))

    def _serve(self, stopping: threading.Event) -> None:
        """Measure until `stopping`, on the device thread; pass turns to the component."""
        link = SerialLink(self.config.port, protocol.BAUD)
        clock = DeviceClock(protocol.CLOCK_HZ, protocol.CLOCK_BITS)
        lines = Lines()
        try:
            link.discard()
            link.write(protocol.START)
            received = time.monotonic()
            while not stopping.is_set():
                data, now = link.read(_POLL_S), time.monotonic()
                for line in lines.feed(data):
                    try:
                        turn = protocol.read_turn(line)
                    except DamagedLine:
                        self._damaged += 1
                        continue
                    received = now
                    self._feed.report_working(f"{link.name}: the Lantern measures")
                    ended = clock.seconds(turn.ended_ms)
                    began = ended + clock.offset(ended, now) - protocol.SWEEP_S
                    self._feed.put((turn, began))
                if now - received > _SILENCE_S:
                    raise DeviceError(f"{link.name}: no turn for {_SILENCE_S:g} s; check its power")
            link.write(protocol.STOP)
        finally:
            link.close()

    def _publish(self, measured: tuple[Turn, float]) -> None:
        """Publish a turn, with the time when its first beam was measured [s, monotonic clock]."""
        turn, began = measured
        age_ns = round((time.monotonic() - began) * SECOND)
        self.scan.publish(
            LaserScan(
                header=Header(
                    stamp=from_ns(self.clock.now() - age_ns), frame_id=self.config.frame_id
                ),
                # It turns clockwise, and so do the angles.
                angle_min=math.pi / 2,
                angle_max=-math.pi / 2,
                angle_increment=-_STEP,
                time_increment=protocol.SWEEP_S / (protocol.BEAMS - 1),
                scan_time=1.0 / protocol.RATE_HZ,
                range_min=protocol.NEAREST_MM / 1000,
                range_max=self.config.farthest,
                ranges=_ranges(turn, self.config.farthest),
            )
        )


def _ranges(turn: Turn, farthest: float) -> np.ndarray:
    """Return ranges [m]; infinite where nothing was hit within the reach (REP 117)."""
    meters = np.array(turn.millimeters, np.float32) / np.float32(1000.0)
    meters[(meters == 0.0) | (meters > farthest)] = np.inf
    return meters
