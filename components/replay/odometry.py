"""The driver that replays what a recorded robot's wheels told."""

from __future__ import annotations

from cairn import LATCHED, RELIABLE, SECOND, Out, every, from_ns
from cairn.components.replay.driver import RecordingDriver
from cairn.components.replay.due import Records
from cairn.planar.messages import with_covariance
from cairn.schemas.geometry_msgs import Twist, TwistWithCovariance, Vector3
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.std_msgs import Header

# How often to tell the time that the replay has reached [ns].
REACHED_EVERY = SECOND // 4


class ReplayOdometry(RecordingDriver):
    """Replays odometry: the pose that it adds up to from the recording's beginning, and the twist.

    MRCLAM data sets hold commanded velocities instead; their pose is what the commands add up to.
    """

    odom: Out[Odometry] = Out(qos=RELIABLE.with_depth(1000))
    reached: Out[Clock] = Out(qos=LATCHED)

    _told = 0

    def on_configure(self) -> None:
        """Read the recording."""
        recording = self.config.open()
        odometry = recording.odometry()
        if odometry is None:
            self.lacks("odometry")
            self.records = Records(())
            return
        self._odometry = odometry
        self.take(recording, odometry.stamps)

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
        x, y, theta = self._odometry.poses[index].tolist()
        forward, turn = self._odometry.twists[index].tolist()
        self.odom.publish(
            Odometry(
                header=Header(stamp=from_ns(self._odometry.stamps[index]), frame_id="odom"),
                child_frame_id="base_link",
                pose=with_covariance((x, y, theta), self._odometry.covariances[index]),
                twist=TwistWithCovariance(
                    twist=Twist(linear=Vector3(x=forward), angular=Vector3(z=turn))
                ),
            )
        )
