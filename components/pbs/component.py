"""The driver of Hokuyo's PBS-03JN."""

from __future__ import annotations

import time

from cairn import LATCHED, SECOND, SENSOR, Component, Config, Out, ParameterRejected, every, from_ns
from cairn.components.pbs.config import PbsConfig
from cairn.components.pbs.conversation import Conversation, Measured
from cairn.components.pbs.scan_message import ScanShape
from cairn.driver.device_thread import DeviceFeed
from cairn.driver.diagnostics import ERROR, OK, WARN, diagnostics
from cairn.driver.errors import DeviceError
from cairn.planar.messages import transform_message
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header
from cairn.schemas.tf2_msgs import TFMessage


class PbsScanner(Component):
    """Drives a PBS-03JN: 121 rays, 0.2 to 3 m, ten scans a second.

    Configured, it has been found to answer; active, it is asked for distances. One that is
    unplugged or falls silent is told of, and begun anew with.
    """

    clock_source = "device"
    config: PbsConfig

    scan: Out[LaserScan] = Out(qos=SENSOR)
    tf_static: Out[TFMessage] = Out(qos=LATCHED)
    diagnostics: Out[DiagnosticArray]

    def on_configure(self) -> None:
        """See that the sensor answers.

        One that was there before may come back: then it is waited for, once active.
        """
        self._feed = DeviceFeed(
            self,
            lambda stopping: self._conversation.converse(stopping, self._feed.report_working),
            self._publish,
        )
        self._damaged_before = 0
        self._shape = ScanShape(self.config.resolution, self.config.range_max)
        self._conversation = Conversation(self.config, self._feed.put)
        try:
            self._conversation.probe()
        except DeviceError as error:
            if not self.restarts:
                raise
            self._feed.device_error = str(error)

    def on_activate(self) -> None:
        """Tell where it sits on the robot; begin to measure."""
        header = Header(stamp=from_ns(self.clock.now()), frame_id="base_link")
        mounted = transform_message(header, self.config.frame_id, self.config.mount.pose)
        self.tf_static.publish(TFMessage(transforms=(mounted,)))
        self._feed.start()

    def on_deactivate(self) -> None:
        """End the link."""
        self._feed.stop()

    def on_error(self, error: Exception) -> bool:  # noqa: ARG002 - whatever it was
        """Let go of the sensor; the supervisor decides."""
        if "_feed" in vars(self):  # else it was not even configured
            self._feed.stop()
        return False

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """The sensor measures as it does."""
        raise ParameterRejected(f"{self.name} takes its parameters when it is configured")

    @every(hz=1)
    def report(self) -> None:
        """Tell how the sensor is."""
        hz = self._feed.hz()
        level, text = self._judgment(hz)
        conversation = self._conversation
        values = {
            "port": self.config.port,
            "rate [Hz]": hz,
            "nominal rate [Hz]": self.config.rate,
            "scans": conversation.scans,
            "damaged frames": conversation.damaged,
            "left out": self._feed.dropped,
            "requests without answer": conversation.missed,
            "connections": conversation.connections,
        }
        told = diagnostics(self.clock.now(), self.name, self.config.port, level, text, values)
        self.diagnostics.publish(told)

    def _judgment(self, hz: float) -> tuple[int, str]:
        damaged = self._conversation.damaged - self._damaged_before
        self._damaged_before += damaged
        if self._feed.device_error:
            return ERROR, self._feed.device_error
        if damaged:
            return WARN, f"{damaged} damaged frames: check cable and shielding"
        if abs(hz - self.config.rate) > self.config.rate_tolerance * self.config.rate:
            return WARN, f"{hz:.1f} scans a second, but {self.config.rate:g} are asked for"
        return OK, f"{hz:.1f} scans a second"

    def _publish(self, measured: Measured) -> None:
        age_s = time.monotonic() - measured.began - self.config.time_offset_s
        stamp = self.clock.now() - round(age_s * SECOND)
        header = Header(stamp=from_ns(stamp), frame_id=self.config.frame_id)
        self.scan.publish(self._shape.scan(measured.distances, header))
