"""The driver that replays a recorded laser scanner."""

from __future__ import annotations

from cairn import SENSOR, Out, every
from cairn.components.replay.driver import RecordingDriver
from cairn.components.replay.due import Records
from cairn.schemas.sensor_msgs import LaserScan


class ReplayScanner(RecordingDriver):
    """Replays laser scans, each at the time that it bears."""

    scan: Out[LaserScan] = Out(qos=SENSOR)

    def on_configure(self) -> None:
        """Read the recording."""
        recording = self.config.open()
        scans = recording.scans()
        if scans is None:
            self.lacks("laser scans")
            self.records = Records(())
            return
        self._messages = scans.messages
        self.take(recording, scans.stamps)

    @every(hz=100)
    def replay(self) -> None:
        """Publish what is due."""
        self.publish_due(lambda index: self.scan.publish(self._messages[index]))
