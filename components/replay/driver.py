"""What the drivers of a recording share: records from a file, published as time passes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pydantic import Field

from cairn import SECOND, Component, Config, ParameterRejected, ReadPath
from cairn.components.replay.due import Records
from cairn.components.replay.formats import open_recording
from cairn.components.replay.recording import Recording, RecordingError


class Topics(Config):
    """Names of a bag's topics, where it holds several of a kind; else they are found by type."""

    scan: str | None = Field(None, description="Laser scans: sensor_msgs/LaserScan.")
    odom: str | None = Field(None, description="Odometry: nav_msgs/Odometry, or tf.")
    truth: str | None = Field(
        None, description="True poses: PoseStamped, PoseWithCovarianceStamped or Odometry."
    )
    left_image: str | None = Field(
        None, description="Images of the left camera, or the only one: Image or CompressedImage."
    )
    right_image: str | None = Field(None, description="Images of the right camera, the same.")


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
        0.0, ge=0, le=1e7, description="Where to begin, counted from the first record [s]."
    )
    end_s: float | None = Field(
        None, gt=0, le=1e7, description="Where to end, counted from the first record [s]."
    )
    topics: Topics = Field(Topics(), description="Names of a bag's topics.")
    scan_delay_s: float = Field(
        0.0,
        ge=-1,
        le=1,
        description="How much later than its odometry the recording stamped its scans [s].",
    )

    image_rate_hz: float | None = Field(
        None,
        ge=0.01,
        le=1000,
        description="Images per second of a folder whose files do not tell their times, or frames "
        "per second of a video in place of its own [Hz].",
    )

    def open(self) -> Recording:
        """The recording that these parameters name."""
        topics = {kind: name for kind, name in self.topics if name is not None}
        return open_recording(
            self.recording, self.robot, topics, self.scan_delay_s, self.image_rate_hz
        )

    def part(self, recording: Recording) -> tuple[int, int]:
        """Times [ns] between which the recording is to be replayed."""
        first, last = recording.span()
        begin = first + round(self.begin_s * SECOND)
        end = last if self.end_s is None else min(last, first + round(self.end_s * SECOND))
        if begin > end:
            raise RecordingError(
                f"{self.recording}: nothing is left to replay from begin_s = {self.begin_s:g} s "
                f"to end_s = {self.end_s} s; the recording is {(last - first) / SECOND:.1f} s "
                "long. Give a part that lies within it."
            )
        return begin, end


class RecordingDriver(Component):
    """What the drivers share: records taken from a file, published as time passes."""

    config: RecordingConfig
    records: Records

    def take(self, recording: Recording, stamps: Sequence[int]) -> None:
        """Choose those records of `stamps` [ns] that are to be replayed."""
        if self.config.begin_s == 0 and self.config.end_s is None:
            self.records = Records(stamps)
        else:
            self.records = Records(stamps, *self.config.part(recording))

    def lacks(self, what: str) -> None:
        """Say that the recording does not hold what this driver is there for."""
        self.log.warning("%s holds no %s: nothing to replay", self.config.recording, what)

    def on_parameters(self, new: Config) -> None:  # noqa: ARG002 - none can be changed
        """A recording cannot be exchanged under a replay."""
        raise ParameterRejected("a driver takes its recording when it is configured")

    def publish_due(self, publish: Callable[[int], None]) -> None:
        """Have `publish` called with the index of each record whose time has come."""
        due, skipped = self.records.due(self.clock.now())
        if skipped:
            self.log.warning("%d records had passed when this driver began: skipped", skipped)
        for index in due:
            publish(index)
