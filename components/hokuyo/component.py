"""The driver of range scanners that speak Hokuyo's SCIP."""

from __future__ import annotations

import time

from cairn import (
    LATCHED,
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
from cairn.components.hokuyo import health
from cairn.components.hokuyo.config import LIVE, HokuyoConfig
from cairn.components.hokuyo.measurement import Measured, Measurement
from cairn.components.hokuyo.scan_message import ScanShape
from cairn.components.hokuyo.sensor import request_of
from cairn.driver.device_thread import DeviceFeed
from cairn.driver.diagnostics import diagnostics
from cairn.driver.errors import DeviceError
from cairn.planar.messages import transform_message
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.sensor_msgs import LaserScan, MultiEchoLaserScan
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage


class HokuyoScanner(Component):
    """Drives a range scanner that speaks SCIP 1.1, 2.0, 2.1 or 2.2: URG, UHG, UTM, UST and others.

    Configured, the sensor is connected and its laser off; active, it measures. A sensor that is
    unplugged, falls silent or sends what cannot be is told of, and begun anew with.
    """

    clock_source = "device"
    config: HokuyoConfig

    scan: Out[LaserScan] = Out(qos=SENSOR)
    multi_echo_scan: Out[MultiEchoLaserScan] = Out(qos=SENSOR)
    tf_static: Out[TFMessage] = Out(qos=LATCHED)
    diagnostics: Out[DiagnosticArray]

    def on_configure(self) -> None:
        """Connect the sensor, and find out what it is.

        One that was there before may come back: then it is waited for, once active.
        """
        self._feed = DeviceFeed(
            self,
            lambda stopping: self._measurement.converse(stopping, self._feed.report_working),
            self._publish,
        )
        self._health = health.Health()
        self._measurement = Measurement(self.config, self._feed.put)
        try:
            sensor = self._measurement.connect()
        except DeviceError as error:
            if not self.restarts:
                raise
            self._feed.device_error = str(error)
            return
        try:
            request_of(self.config, sensor.measuring)
        except CairnError:
            self._measurement.disconnect()
            raise
        self.log.info(
            "%s: %s, %s, firmware %s, serial number %s",
            sensor.link.name,
            sensor.measuring.model,
            sensor.version.get("PROT", "SCIP 1.1"),
            sensor.version.get("FIRM", "unknown"),
            sensor.serial_number or "unknown",
        )

    def on_activate(self) -> None:
        """Tell where it sits on the robot; begin to measure."""
        header = Header(stamp=from_ns(self.clock.now()), frame_id="base_link")
        mounted = transform_message(header, self.config.frame_id, self.config.mount.pose)
        self.tf_static.publish(TFMessage(transforms=(mounted,)))
        self._feed.start()

    def on_deactivate(self) -> None:
        """Have it rest, its laser off."""
        self._feed.stop()

    def on_cleanup(self) -> None:
        """Let go of it."""
        self._measurement.disconnect()

    def on_error(self, error: Exception) -> bool:  # noqa: ARG002 - whatever it was
        """Switch the laser off and let go of the sensor; the supervisor decides."""
        if "_measurement" in vars(self):  # else it was not even configured
            try:
                self._feed.stop()
            finally:
                self._measurement.disconnect()
        return False

    def on_parameters(self, new: Config) -> None:
        """What is measured may change while it runs; where the sensor is may not."""
        assert isinstance(new, HokuyoConfig)
        for name in HokuyoConfig.model_fields:
            if name not in LIVE and getattr(new, name) != getattr(self.config, name):
                raise ParameterRejected(
                    f"the driver takes {name} when it is configured; {', '.join(LIVE)} may be "
                    "changed while it runs"
                )
        measuring = self._measurement.measuring
        if measuring is not None:
            try:
                request_of(new, measuring)
            except CairnError as error:
                raise ParameterRejected(str(error)) from error
        self._measurement.config = new
        self._feed.rate.restart()

    @every(hz=1)
    def report(self) -> None:
        """Tell how the sensor is."""
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
                health.values(measurement, hz) | {"left out": feed.dropped},
            )
        )

    def _publish(self, measured: Measured) -> None:
        # Whoever sets the system's clock sets the stamps with it, at once.
        stamp = measured.first_ray + self.clock.now() - time.monotonic_ns()
        stamp += round(self.config.time_offset_s * SECOND)
        header = Header(stamp=from_ns(stamp), frame_id=self.config.frame_id)
        shape = ScanShape(measured.sensor.measuring, measured.request, self.config.range_max)
        self.scan.publish(shape.scan(measured.data, header, self.config.echo))
        if measured.request.multi_echo and self.multi_echo_scan.has_subscribers:
            self.multi_echo_scan.publish(shape.multi_echo_scan(measured.data, header))
