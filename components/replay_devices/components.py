"""Replay components for odometry, scans, observed objects and true poses; see also `camera`."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence

import numpy as np

from cairn import (
    LATCHED,
    RELIABLE,
    SENSOR,
    Component,
    Out,
    every,
    from_ns,
)
from cairn.components.replay_devices.config import RecordingConfig
from cairn.components.replay_devices.pacing import REACHED_INTERVAL, PacedRecords
from cairn.components.replay_devices.recording import (
    ObservationStream,
    RecordedObservation,
    Recording,
)
from cairn.planar.messages import pose_message, twist_message, with_covariance
from cairn.schemas.cairn_msgs import RecognizedObject, RecognizedObjectArray, VisualMap
from cairn.schemas.geometry_msgs import PoseStamped, TwistWithCovariance
from cairn.schemas.nav_msgs import Odometry
from cairn.schemas.rosgraph_msgs import Clock
from cairn.schemas.sensor_msgs import LaserScan
from cairn.schemas.std_msgs import Header

_TRUTH_INTERVAL = 99_900_000  # [ns]: 10 Hz, with a tolerance for the times of records


class ReplayComponent(Component):
    """What all replay components share: records of a file, published as time passes."""

    # A recording cannot be exchanged during a replay.
    live_parameters = frozenset()
    config: RecordingConfig
    records: PacedRecords

    def select(self, recording: Recording, stamps: Sequence[int]) -> None:
        """Select the records of `stamps` [ns] that are replayed."""
        if self.config.begin_s == 0 and self.config.end_s is None:
            self.records = PacedRecords(stamps)
        else:
            self.records = PacedRecords(stamps, *self.config.part(recording))

    def replay_nothing(self, stream: str) -> None:
        """Log that the recording does not hold the stream of this component."""
        self.log.warning("%s holds no %s: nothing to replay", self.config.recording, stream)
        self.records = PacedRecords(())

    def publish(self, index: int) -> None:
        """Publish the record with an index."""
        raise NotImplementedError

    @every(hz=100)
    def replay(self) -> None:
        """Publish the records that are due."""
        due, skipped = self.records.due(self.clock.now())
        if skipped:
            self.log.warning("skipped records from before the start of this component: %d", skipped)
        for index in due:
            self.publish(index)


class ReplayOdometry(ReplayComponent):
    """Replays odometry: the pose since the start of the recording, and the twist.

    MRCLAM data sets hold commanded velocities instead; their pose is the sum of the commands.
    """

    odom: Out[Odometry] = Out(qos=RELIABLE.with_depth(1000))
    reached: Out[Clock] = Out(qos=LATCHED)

    _last_reached = 0

    def on_configure(self) -> None:
        """Read the recording."""
        recording = self.config.open()
        odometry = recording.odometry()
        if odometry is None:
            self.replay_nothing("odometry")
            return
        self._odometry = odometry
        self.select(recording, odometry.stamps)

    @every(hz=100)
    def replay(self) -> None:
        """Publish the records that are due, and the time."""
        super().replay()
        now = self.clock.now()
        if now - self._last_reached >= REACHED_INTERVAL:
            # Latched for a clock that is restarted, which continues from this time.
            self._last_reached = now
            self.reached.publish(Clock(clock=from_ns(now)))

    def publish(self, index: int) -> None:
        """Publish the record with an index."""
        x, y, theta = self._odometry.poses[index].tolist()
        twist = twist_message(*self._odometry.twists[index].tolist())
        self.odom.publish(
            Odometry(
                header=Header(stamp=from_ns(self._odometry.stamps[index]), frame_id="odom"),
                child_frame_id="base_link",
                pose=with_covariance((x, y, theta), self._odometry.covariances[index]),
                twist=TwistWithCovariance(twist=twist),
            )
        )


class ReplayScanner(ReplayComponent):
    """Replays laser scans, each at the time of its stamp."""

    scan: Out[LaserScan] = Out(qos=SENSOR)

    def on_configure(self) -> None:
        """Read the recording."""
        recording = self.config.open()
        scans = recording.scans()
        if scans is None:
            self.replay_nothing("laser scans")
            return
        self._messages = scans.messages
        self.select(recording, scans.stamps)

    def publish(self, index: int) -> None:
        """Publish a scan."""
        self.scan.publish(self._messages[index])


class ReplayRecognizer(ReplayComponent):
    """Replays the observations of landmarks; an object's id is the landmark's number."""

    objects: Out[RecognizedObjectArray]

    def on_configure(self) -> None:
        """Read the recording."""
        recording = self.config.open()
        self._unknown: dict[int, int] = {}
        observations = recording.observations()
        if observations is None:
            self.replay_nothing("observations of landmarks")
            return
        self._observations: ObservationStream = observations
        self.select(recording, observations.stamps)

    def on_deactivate(self) -> None:
        """Log how many observations had a barcode that the data set does not list."""
        if self._unknown:
            self.log.info("ignored observations of unknown barcodes, by barcode: %s", self._unknown)

    def publish(self, index: int) -> None:
        """Publish the record with an index."""
        if self._observations.messages is not None:
            self.objects.publish(self._observations.messages[index])
            return
        objects = [
            recognized
            for observation in self._observations.frames[index]
            if (recognized := self._object(observation)) is not None
        ]
        if objects:
            header = Header(stamp=from_ns(self._observations.stamps[index]), frame_id="base_link")
            self.objects.publish(RecognizedObjectArray(header=header, objects=tuple(objects)))

    def _object(self, observation: RecordedObservation) -> RecognizedObject | None:
        if observation.object_id is None:
            barcode = observation.code
            if barcode not in self._unknown:
                self.log.warning(
                    "barcode %d is not in Barcodes.dat: its observations are ignored", barcode
                )
            self._unknown[barcode] = self._unknown.get(barcode, 0) + 1
            return None
        covariance = np.array([observation.range_variance, 0.0, 0.0, observation.bearing_variance])
        return RecognizedObject(
            object_id=observation.object_id,
            range=observation.range_m,
            bearing=observation.bearing,
            covariance=covariance,
        )


class ReplayTruth(ReplayComponent):
    """Replays true poses at most 10 times per second, and publishes the surveyed map, if any.

    True poses are motion capture (MRCLAM), the corrected poses of a CARMEN log, or a bag's topic
    that is named for them. They are for evaluation only: navigation and mapping must not read them.
    """

    truth: Out[PoseStamped]
    true_map: Out[VisualMap] = Out(qos=LATCHED)

    _landmark_map: VisualMap | None = None

    def on_configure(self) -> None:
        """Read the recording; keep the poses of the part to replay, thinned to 10 Hz."""
        recording = self.config.open()
        self._landmark_map = recording.landmark_map()
        trajectory = recording.truth()
        if trajectory is None:
            self.replay_nothing("true poses")
            return
        first, last = self.config.part(recording)
        stamps = trajectory.stamps
        kept: list[int] = []
        for k in range(bisect_left(stamps, first), bisect_right(stamps, last)):
            if not kept or stamps[k] - stamps[kept[-1]] >= _TRUTH_INTERVAL:
                kept.append(k)
        self._poses = trajectory.poses[kept]
        self._stamps = [stamps[k] for k in kept]
        self.records = PacedRecords(self._stamps)

    def on_activate(self) -> None:
        """Publish the surveyed landmarks."""
        if self._landmark_map is not None:
            self.true_map.publish(self._landmark_map)

    def publish(self, index: int) -> None:
        """Publish the record with an index."""
        x, y, theta = self._poses[index].tolist()
        header = Header(stamp=from_ns(self._stamps[index]), frame_id="map")
        self.truth.publish(PoseStamped(header=header, pose=pose_message((x, y, theta))))
