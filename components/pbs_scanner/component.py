"""The driver of Hokuyo's PBS-03JN."""

from __future__ import annotations

from cairn import SECOND, SENSOR, Component, Out, every, from_ns
from cairn.components.pbs_scanner.config import PbsConfig
from cairn.components.pbs_scanner.messages import PbsMessages
from cairn.components.pbs_scanner.sensor import PbsMeasurement, TimedDistances
from cairn.driver.device_clock import ahead_of_monotonic
from cairn.driver.device_thread import DeviceFeed
from cairn.driver.diagnostics import ERROR, OK, WARN, diagnostics
from cairn.driver.errors import DeviceError
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header


class PbsScanner(Component):
    """Drives a PBS-03JN: 121 rays, 0.2 to 3 m, ten scans per second.

    Configured, the sensor has replied once; active, it measures. If it is unplugged or falls
    silent, the driver reports that and opens it again.

    After eight unanswered requests the driver reports an error and opens the port again.

    Ranges: below 0.2 m `-inf`, beyond `range_max` `+inf`, 0 is NaN. Rays run from right to left;
    the 61st points ahead. Sellers state a step of 1.8 degrees (the default); Player's driver uses
    360/204 degrees: `resolution: 0.0308`.

    Answers contain no time. The driver assumes that the first ray is 0.15 s older than the request.
    The error is at most 0.05 s plus the sensor's computing time; `time_offset_s` corrects a known
    one.

    Hokuyo has not published the protocol. The driver follows what Player's and Synapticon's drivers
    agree on.
    """

    live_parameters = frozenset()
    clock_source = "device"
    config: PbsConfig

    scan: Out[LaserScan] = Out(qos=SENSOR)
    diagnostics: Out[DiagnosticArray]

    def on_configure(self) -> None:
        """Check that the sensor replies.

        After a restart a missing sensor is not a failure, as it may come back: the active driver
        waits for it.
        """
        self._feed = DeviceFeed(
            self,
            lambda stopping: self._measurement.run(stopping, self._feed.report_working),
            self._publish,
        )
        self._damaged_before = 0
        self._messages = PbsMessages(self.config.resolution, self.config.range_max)
        self._measurement = PbsMeasurement(self.config, self._feed.put)
        try:
            self._measurement.probe()
        except DeviceError as error:
            if not self.restarts:
                raise
            self._feed.device_error = str(error)

    def on_activate(self) -> None:
        """Start measuring."""
        self._feed.start()

    def on_deactivate(self) -> None:
        """Stop measuring and end the link."""
        self._feed.stop()

    def on_error(self, _: Exception) -> bool:
        """Close the line; the supervisor decides what follows."""
        if "_feed" in vars(self):  # otherwise it was not even configured
            self._feed.stop()
        return False

    @every(hz=1)
    def report(self) -> None:
        """Publish the sensor's health."""
        hz = self._feed.hz()
        level, text = self._judge(hz)
        measurement = self._measurement
        values = {
            "port": self.config.port,
            "rate [Hz]": hz,
            "nominal rate [Hz]": self.config.rate,
            "scans": measurement.scans,
            "damaged frames": measurement.damaged,
            "dropped scans": self._feed.dropped,
            "requests without reply": measurement.missed,
            "connections": measurement.connections,
        }
        message = diagnostics(self.clock.now(), self.name, self.config.port, level, text, values)
        self.diagnostics.publish(message)

    def _judge(self, hz: float) -> tuple[int, str]:
        damaged = self._measurement.damaged - self._damaged_before
        self._damaged_before += damaged
        if self._feed.device_error:
            return ERROR, self._feed.device_error
        if damaged:
            return WARN, f"{damaged} damaged frames; check cable and shielding"
        if abs(hz - self.config.rate) > self.config.rate_tolerance * self.config.rate:
            return WARN, f"{hz:.1f} scans per second instead of {self.config.rate:g}"
        return OK, f"{hz:.1f} scans per second"

    def _publish(self, scan: TimedDistances) -> None:
        stamp = round((scan.began + self.config.time_offset_s) * SECOND)
        stamp += ahead_of_monotonic(self.clock.now)
        header = Header(stamp=from_ns(stamp), frame_id=self.config.frame_id)
        self.scan.publish(self._messages.scan(scan.distances, header))
