"""The driver that replays the motion-capture truth of one robot's recording."""

from __future__ import annotations

from cairn.bus.qos import LATCHED
from cairn.clock import from_ns
from cairn.component.handlers import every
from cairn.component.ports import Out
from components.mrclam.dataset import Dataset
from components.mrclam.landmarks import read_landmarks
from components.mrclam.planar import planar_pose
from components.mrclam.recording import RecordingDriver
from components.mrclam.replay import Records, nanoseconds
from schemas.cairn_msgs import VisualMap
from schemas.geometry_msgs import PoseStamped
from schemas.std_msgs import Header


class MrclamTruth(RecordingDriver):
    """Replays the motion-capture pose at most 10 times a second, and tells the surveyed map.

    For evaluation only: nothing that steers or maps may read it.
    """

    truth: Out[PoseStamped]
    true_map: Out[VisualMap] = Out(qos=LATCHED)

    def on_configure(self) -> None:
        """Read the recording; keep what lies in its time, thinned to 10 Hz."""
        dataset = Dataset(self.config.dataset)
        first, last = dataset.span(self.config.robot)
        rows = dataset.truth(self.config.robot)
        rows = rows[(rows[:, 0] >= first) & (rows[:, 0] <= last)]
        kept = [0] if len(rows) else []
        for k in range(1, len(rows)):
            if rows[k, 0] - rows[kept[-1], 0] >= 0.0999:
                kept.append(k)
        self._rows = rows[kept]
        self._stamps = nanoseconds(self._rows[:, 0])
        self.records = Records(self._stamps)

    def on_activate(self) -> None:
        """Tell where the landmarks stand."""
        self.true_map.publish(read_landmarks(self.config.dataset))

    @every(hz=100)
    def replay(self) -> None:
        """Publish what is due."""
        self.publish_due(self._publish)

    def _publish(self, index: int) -> None:
        _, x, y, theta = self._rows[index].tolist()
        header = Header(stamp=from_ns(self._stamps[index]), frame_id="map")
        self.truth.publish(PoseStamped(header=header, pose=planar_pose(x, y, theta)))
