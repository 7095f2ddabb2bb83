"""The driver of a range scanner that speaks ROS 2 over the bus."""

from __future__ import annotations

from cairn import (
    SECOND,
    SENSOR,
    Component,
    In,
    Out,
    every,
    from_ns,
    on,
)
from cairn.components.ros2_devices.config import Ros2ScannerConfig
from cairn.components.ros2_devices.scan import scan_message, why_unusable
from cairn.driver.diagnostics import OK
from cairn.driver.ros2_source import Ros2Source, SourceLimits
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header


class Ros2Scanner(Component):
    """Publishes the checked scans of a scanner that a ROS 2 node drives.

    The deployment names the node's topic: `topics: {source_scan: /scan}`.

    Ranges are as in REP 117; 0 counts as NaN. The driver rejects scans

    - of another frame than `source_frame`; no frame means this one;
    - without ranges, with more than 10,000, or over far more than a full turn, as of angles in
      degrees;
    - whose sweep takes more than 1 s: correct `time_increment`;
    - older than `age_s` or from the future: synchronize the clocks, or set `stamp_on_arrival: true`
      for a node without a clock;
    - that arrive twice or out of order: a second node publishes the topic.
    """

    live_parameters = frozenset()
    config: Ros2ScannerConfig

    source_scan: In[LaserScan] = In(qos=SENSOR)
    scan: Out[LaserScan] = Out(qos=SENSOR)
    diagnostics: Out[DiagnosticArray]

    def on_activate(self) -> None:
        """Wait for scans."""
        config = self.config
        limits = SourceLimits(config.rate, config.timeout_s, config.age_s, config.stamp_on_arrival)
        topic = self.source_scan.topic
        self._source = Ros2Source(self, topic, "the scan", "no scan is published", limits)

    @on("source_scan")
    def on_source_scan(self, message: LaserScan) -> None:
        """Publish a scan of the node if it is usable."""
        source, config = self._source, self.config
        stamp = source.stamp_of(message.header.stamp)
        reason = (
            why_unusable(message, self.source_scan.topic, config.source_frame)
            or source.why_untimely(stamp)
            or source.why_out_of_order(stamp)
        )
        if reason is not None:
            source.reject(reason)
            return
        if not message.header.frame_id:
            source.note_once(f"they name no frame, and are taken as of {config.source_frame}")
        source.accept(stamp)
        stamp += round(config.time_offset_s * SECOND)
        header = Header(stamp=from_ns(stamp), frame_id=config.frame_id)
        self.scan.publish(scan_message(message, header, upside_down=config.upside_down))

    @every(hz=1)
    def publish_health(self) -> None:
        """Publish how the node's scans arrive."""
        self.diagnostics.publish(self._source.report((OK, "scans arrive"), {}))
