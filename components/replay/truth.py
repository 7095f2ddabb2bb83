"""The driver that replays where a recorded robot truly was."""

from __future__ import annotations

from bisect import bisect_left, bisect_right

from cairn import LATCHED, Out, every, from_ns
from cairn.components.replay.driver import RecordingDriver
from cairn.components.replay.due import Records
from cairn.planar.messages import pose_message
from cairn.schemas.cairn_msgs import VisualMap
from cairn.schemas.geometry_msgs import PoseStamped
from cairn.schemas.std_msgs import Header

# The least time between two poses [ns]: 10 Hz, and some freedom for how records fall.
_APART = 99_900_000


class ReplayTruth(RecordingDriver):
    """Replays true poses at most 10 times a second, and tells the surveyed map if there is one.

    True are motion capture (MRCLAM), a CARMEN log's corrected poses, or a bag's topic named so.
    For evaluation only: nothing that steers or maps may read it.
    """

    truth: Out[PoseStamped]
    true_map: Out[VisualMap] = Out(qos=LATCHED)

    _surveyed: VisualMap | None = None

    def on_configure(self) -> None:
        """Read the recording; keep what lies in its time, thinned to 10 Hz."""
        recording = self.config.open()
        self._surveyed = recording.surveyed()
        trajectory = recording.truth()
        if trajectory is None:
            self.lacks("true poses")
            self.records = Records(())
            return
        first, last = self.config.part(recording)
        stamps = trajectory.stamps
        kept: list[int] = []
        for k in range(bisect_left(stamps, first), bisect_right(stamps, last)):
            if not kept or stamps[k] - stamps[kept[-1]] >= _APART:
                kept.append(k)
        self._poses = trajectory.poses[kept]
        self._stamps = [stamps[k] for k in kept]
        self.records = Records(self._stamps)

    def on_activate(self) -> None:
        """Tell where the landmarks stand."""
        if self._surveyed is not None:
            self.true_map.publish(self._surveyed)

    @every(hz=100)
    def replay(self) -> None:
        """Publish what is due."""
        self.publish_due(self._publish)

    def _publish(self, index: int) -> None:
        x, y, theta = self._poses[index].tolist()
        header = Header(stamp=from_ns(self._stamps[index]), frame_id="map")
        self.truth.publish(PoseStamped(header=header, pose=pose_message((x, y, theta))))
