"""Parameters of replay components: which recording, and which part of it."""

from __future__ import annotations

from pydantic import Field

from cairn import SECOND, Config, ReadPath
from cairn.components.replay_devices.open_recording import open_recording
from cairn.components.replay_devices.recording import Recording
from cairn.errors import RecordingError


class BagTopics(Config):
    """Topics of a bag, if it holds several of a kind; else they are found by type."""

    scan: str | None = Field(None, description="Laser scans: sensor_msgs/LaserScan.")
    odom: str | None = Field(None, description="Odometry: nav_msgs/Odometry, or tf.")
    truth: str | None = Field(
        None, description="True poses: PoseStamped, PoseWithCovarianceStamped or Odometry."
    )
    left_image: str | None = Field(
        None,
        description="Images of the left camera, or the only one: Image or CompressedImage.",
    )
    right_image: str | None = Field(
        None, description="Images of the right camera: Image or CompressedImage."
    )


class RecordingConfig(Config):
    """Which recording, and which part of it."""

    recording: ReadPath = Field(
        description="MRCLAM folder, CARMEN log, ROS 1 bag, ROS 2 bag's folder, MCAP file, video, "
        "or folder of images."
    )
    robot: int | None = Field(
        None, ge=1, le=5, description="Robot of an MRCLAM data set, 1 to 5 [1]."
    )
    begin_s: float = Field(
        0.0, ge=0, le=1e7, description="Start of the part to replay, after the first record [s]."
    )
    end_s: float | None = Field(
        None, gt=0, le=1e7, description="End of the part to replay, after the first record [s]."
    )
    topics: BagTopics = Field(BagTopics(), description="Names of a bag's topics.")
    scan_delay_s: float = Field(
        0.0,
        ge=-1,
        le=1,
        description="How much later scans are stamped than odometry of the same moment [s].",
    )
    image_rate_hz: float | None = Field(
        None,
        ge=0.01,
        le=1000,
        description="Images per second of a folder without recorded times, or frames per second of "
        "a video instead of its own rate [Hz].",
    )

    def open(self) -> Recording:
        """Open the recording that these parameters name."""
        topics = {kind: name for kind, name in self.topics if name is not None}
        return open_recording(
            self.recording, self.robot, topics, self.scan_delay_s, self.image_rate_hz
        )

    def part(self, recording: Recording) -> tuple[int, int]:
        """Return the times [ns] between which the recording is replayed."""
        first, last = recording.span()
        begin = first + round(self.begin_s * SECOND)
        end = last if self.end_s is None else min(last, first + round(self.end_s * SECOND))
        if begin > end:
            raise RecordingError(
                f"{self.recording}: there is nothing to replay from begin_s = {self.begin_s:g} s "
                f"to end_s = {self.end_s} s; the recording is {(last - first) / SECOND:.1f} s "
                "long. Use a part that lies within it."
            )
        return begin, end
