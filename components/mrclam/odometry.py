"""The driver that replays the commanded velocities of one robot's recording."""

from __future__ import annotations

import numpy as np

from cairn.bus.qos import LATCHED, RELIABLE
from cairn.clock import SECOND, from_ns
from cairn.component.handlers import every
from cairn.component.ports import Out
from components.mrclam.dataset import Dataset
from components.mrclam.dead_reckoning import DeadReckoning, reckon
from components.mrclam.planar import planar_pose
from components.mrclam.recording import RecordingDriver
from components.mrclam.replay import Records, nanoseconds
from schemas.geometry_msgs import PoseWithCovariance, Twist, TwistWithCovariance, Vector3
from schemas.nav_msgs import Odometry
from schemas.rosgraph_msgs import Clock
from schemas.std_msgs import Header

# How often to tell the time that the replay has reached [ns].
REACHED_EVERY = SECOND // 4


class MrclamOdometry(RecordingDriver):
    """Replays commanded velocities, with the pose that they add up to from the first record."""

    odom: Out[Odometry] = Out(qos=RELIABLE.with_depth(1000))
    reached: Out[Clock] = Out(qos=LATCHED)

    _told = 0

    def on_configure(self) -> None:
        """Read the recording."""
        self._rows = Dataset(self.config.dataset).odometry(self.config.robot)
        self._reckoned: DeadReckoning = reckon(self._rows)
        self._stamps = nanoseconds(self._rows[:, 0])
        self.records = Records(self._stamps)

    @every(hz=100)
    def replay(self) -> None:
        """Publish what is due."""
        self.publish_due(self._publish)
        now = self.clock.now()
        if now - self._told >= REACHED_EVERY:
            # Kept by the bus for a clock that is started anew, to go on from this time.
            self._told = now
            self.reached.publish(Clock(clock=from_ns(now)))

    def _publish(self, index: int) -> None:
        x, y, theta = self._reckoned.poses[index].tolist()
        place_sd, turn_sd = self._reckoned.deviations[index].tolist()
        covariance = np.zeros(36)
        covariance[0] = covariance[7] = place_sd**2
        covariance[35] = turn_sd**2
        _, forward, turn = self._rows[index].tolist()
        self.odom.publish(
            Odometry(
                header=Header(stamp=from_ns(self._stamps[index]), frame_id="odom"),
                child_frame_id="base_link",
                pose=PoseWithCovariance(pose=planar_pose(x, y, theta), covariance=covariance),
                twist=TwistWithCovariance(
                    twist=Twist(linear=Vector3(x=forward), angular=Vector3(z=turn))
                ),
            )
        )
