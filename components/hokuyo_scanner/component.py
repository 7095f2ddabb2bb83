"""The driver of range scanners that speak Hokuyo's SCIP."""

from __future__ import annotations

from cairn import (
    SECOND,
    SENSOR,
    CairnError,
    Component,
    Config,
    Out,
    ParameterRejected,
    every,
    from_ns,
)
from cairn.components.hokuyo_scanner.config import LIVE, HokuyoConfig
from cairn.components.hokuyo_scanner.health import HealthMonitor, health_values
from cairn.components.hokuyo_scanner.messages import ScanMessages
from cairn.components.hokuyo_scanner.sensor import Measurement, StampedScan, request_of
from cairn.driver.device_clock import ahead_of_monotonic
from cairn.driver.device_thread import DeviceFeed
from cairn.driver.diagnostics import diagnostics
from cairn.driver.errors import DeviceError
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.sensor_msgs import LaserScan, MultiEchoLaserScan
from cairn.schemas.std_msgs import Header


class HokuyoScanner(Component):
    """Drives a range scanner that speaks SCIP 1.1, 2.0, 2.1 or 2.2: URG, UHG, UTM, UST and others.

    Configured, the sensor is connected and its laser off; active, it measures. If the sensor is
    unplugged, falls silent or sends impossible replies, the driver reports that and opens it again.

    Angles: 0 is ahead, they increase to the left (REP 103).

    Ranges follow REP 117. Beyond the sensor's limit or `range_max`: `+inf`. Values below the
    sensor's minimum are error codes: on UTM and UST, 1 becomes `+inf` (nothing hit) and 2 becomes
    `-inf` (too near); others become NaN. With `short_distances`, 4095 mm means "at least" and
    becomes `+inf`.

    The stamp is the time of the first ray in the message, in system time; ray i was measured `i *
    time_increment` later. `calibrate_time` measures the sensor's computing time at each start
    (command TM, 0.1 s, laser off). For a sensor without TM, set `time_offset_s`. A SCIP 1.1 sensor
    has no clock: its stamps are accurate to about one turn.

    A change of parameters restarts the stream. If a sensor lacks `intensity`, `multi_echo` or
    `short_distances`, the driver continues without it. `diagnostics` reports that, damage, silence,
    and a rate that differs by more than `rate_tolerance`. SCIP checksums have six bits: they miss
    one of 64 lines with several wrong bytes. SCIP 1.1 has none.
    """

    live_parameters = frozenset(LIVE)
    clock_source = "device"
    config: HokuyoConfig

    scan: Out[LaserScan] = Out(qos=SENSOR)
    multi_echo_scan: Out[MultiEchoLaserScan] = Out(qos=SENSOR)
    diagnostics: Out[DiagnosticArray]

    def on_configure(self) -> None:
        """Connect and identify the sensor.

        After a restart a missing sensor is not a failure, because it may come back: the active
        driver waits for it.
        """
        self._feed = DeviceFeed(
            self,
            lambda stopping: self._measurement.run(stopping, self._feed.report_working),
            self._publish,
        )
        self._health = HealthMonitor()
        self._measurement = Measurement(self.config, self._feed.put)
        try:
            sensor = self._measurement.connect()
        except DeviceError as error:
            if not self.restarts:
                raise
            self._feed.device_error = str(error)
            return
        try:
            request_of(self.config, sensor.spec)
        except CairnError:
            self._measurement.disconnect()
            raise
        self.log.info(
            "%s: %s, %s, firmware %s, serial number %s",
            sensor.link.name,
            sensor.spec.model,
            sensor.version.get("PROT", "SCIP 1.1"),
            sensor.version.get("FIRM", "unknown"),
            sensor.serial_number or "unknown",
        )

    def on_activate(self) -> None:
        """Start measuring."""
        self._feed.start()

    def on_deactivate(self) -> None:
        """Stop measuring; the laser is off then."""
        self._feed.stop()

    def on_cleanup(self) -> None:
        """Disconnect the sensor."""
        self._measurement.disconnect()

    def on_error(self, _: Exception) -> bool:
        """Switch the laser off and disconnect the sensor; the supervisor decides what follows."""
        if "_measurement" in vars(self):  # otherwise it was not even configured
            try:
                self._feed.stop()
            finally:
                self._measurement.disconnect()
        return False

    def on_parameters(self, new: Config) -> None:
        """Measure as the new parameters say; reject what the sensor cannot do."""
        assert isinstance(new, HokuyoConfig)
        spec = self._measurement.spec
        if spec is not None:
            try:
                request_of(new, spec)
            except CairnError as error:
                raise ParameterRejected(str(error)) from error
        self._measurement.config = new
        self._feed.rate.restart()

    @every(hz=1)
    def report(self) -> None:
        """Publish the sensor's health."""
        measurement = self._measurement
        feed, hz = self._feed, self._feed.hz()
        level, text = self._health.judge(measurement, feed, self.config.rate_tolerance)
        sensor = measurement.sensor
        self.diagnostics.publish(
            diagnostics(
                self.clock.now(),
                self.name,
                "" if sensor is None else sensor.serial_number,
                level,
                text,
                health_values(measurement, hz) | {"dropped scans": feed.dropped},
            )
        )

    def _publish(self, scan: StampedScan) -> None:
        # A change of the system's clock changes the stamps at once.
        stamp = scan.first_ray + ahead_of_monotonic(self.clock.now)
        stamp += round(self.config.time_offset_s * SECOND)
        header = Header(stamp=from_ns(stamp), frame_id=self.config.frame_id)
        messages = ScanMessages(scan.sensor.spec, scan.request, self.config.range_max)
        self.scan.publish(messages.scan(scan.data, header, self.config.echo))
        if scan.request.multi_echo and self.multi_echo_scan.has_subscribers:
            self.multi_echo_scan.publish(messages.multi_echo_scan(scan.data, header))
