"""What a recording of any format holds: its streams, as the replay components read them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cairn.components.replay_devices.record_times import TimeQuality
from cairn.errors import RecordingError
from cairn.planar.poses import Pose
from cairn.schemas.cairn_msgs import RecognizedObjectArray, VisualMap
from cairn.schemas.sensor_msgs import CameraInfo, LaserScan

Array = NDArray[np.float64]
Gray = NDArray[np.uint8]


BAD_SHARE = 0.01
"""The share of a log's or topic's records that may be bad: these are left out; with more, it is
refused. Programs that are killed leave one cut-off record, full disks a few."""

FEW_BAD = 3
"""So many bad records may be in any log or topic, however short."""


@dataclass(frozen=True)
class OdometryStream:
    """Wheel odometry at `stamps` [ns] in order.

    `poses` (n, 3): x [m], y [m], theta [rad] in the odometry frame; `covariances` (n, 3, 3) of
    them; `twists` (n, 2): forward [m/s] and turn [rad/s, left positive].
    """

    stamps: Sequence[int]
    poses: Array
    covariances: Array
    twists: Array


@dataclass(frozen=True)
class TimedPoses:
    """Poses of the robot (n, 3: x [m], y [m], theta [rad]) at `stamps` [ns] in order."""

    stamps: Sequence[int]
    poses: Array


@dataclass(frozen=True)
class ScanStream:
    """Laser scans in order of their `stamps` [ns], which are also in their headers.

    `recorded_stamps` [ns] are the same as they stand in the recording: before bursts are spread and
    a scan delay is subtracted.
    """

    stamps: Sequence[int]
    messages: Sequence[LaserScan]
    recorded_stamps: Sequence[int]


@dataclass(frozen=True)
class ScannerMount:
    """Pose of the scanner (x [m], y [m], yaw [rad]) on the robot, in frame `base`.

    A scanner that is `upside_down` (roll pi) sees left and right swapped. `Recording.scans()` has
    the angles of its beams mirrored already, so `pose` holds as if it stood upright. `source` says
    where the recording has the mount.
    """

    pose: Pose
    upside_down: bool
    base: str
    source: str


@dataclass(frozen=True)
class RecordedObservation:
    """An observation of a landmark: range [m], bearing [rad, left positive], variances.

    Variances are in m^2 and rad^2. `code` is the barcode that the camera read; `object_id` is None
    if the recording does not assign it to a landmark.
    """

    code: int
    object_id: int | None
    range_m: float
    bearing: float
    range_variance: float
    bearing_variance: float


@dataclass(frozen=True)
class ObservationStream:
    """The observations at each of `stamps` [ns]; a frame may be empty.

    A recording of Cairn has `messages` instead, as they were published.
    """

    stamps: Sequence[int]
    frames: Sequence[Sequence[RecordedObservation]]
    messages: Sequence[RecognizedObjectArray] | None = None


@dataclass(frozen=True)
class ImageStream:
    """Images of one camera, or of both (`cameras`) of a stereo camera, at `stamps` [ns] in order.

    `load` returns the images (h, w), left first, of the stamp with an index; indices must not
    decrease. It raises `CairnError` if they cannot be read. All have one `size`: width and height
    in pixels. `infos` are the recorded calibrations of the cameras, None if there is none.
    """

    name: str
    stamps: Sequence[int]
    cameras: int
    size: tuple[int, int]
    load: Callable[[int], tuple[Gray, ...]]
    infos: tuple[CameraInfo | None, ...] = ()


@dataclass(frozen=True)
class RecordedTopic:
    """A series of records by the name that the recording uses, and their number.

    `kind` is what it is replayed as: scan, odom, objects, truth, images; None if it is not
    replayed.
    """

    kind: str | None
    topic: str
    type: str
    count: int


class Recording(ABC):
    """A recording; each method reads what it needs and raises `RecordingError`.

    A method returns None for a stream that the recording does not hold, as the methods here do.
    """

    @abstractmethod
    def span(self) -> tuple[int, int]:
        """Return the times [ns] of the first and the last record that a replay publishes."""

    def odometry(self) -> OdometryStream | None:
        """Return the wheel odometry."""
        return None

    def scans(self) -> ScanStream | None:
        """Return the scans of the laser scanner."""
        return None

    def mount(self) -> ScannerMount | None:
        """Return where the scanner is on the robot."""
        return None

    def observations(self) -> ObservationStream | None:
        """Return the observations of landmarks."""
        return None

    def images(self) -> ImageStream | None:
        """Return the images of the cameras."""
        return None

    def truth(self) -> TimedPoses | None:
        """Return the robot's true poses, measured from outside or corrected afterwards."""
        return None

    def landmark_map(self) -> VisualMap | None:
        """Return the surveyed landmarks."""
        return None

    @abstractmethod
    def topics(self) -> Sequence[RecordedTopic]:
        """Return everything that was recorded, replayed or not."""

    @abstractmethod
    def time_quality(self) -> Mapping[str, TimeQuality]:
        """Return how good the recorded times of the streams are, by their kind (`scan`)."""

    def notes(self) -> Sequence[str]:
        """Return what was lost, left out or assumed, as sentences."""
        return ()


def nanoseconds(time_s: Array) -> list[int]:
    """Convert recorded times [s] to [ns], rounded to microseconds, the precision of a double."""
    return [round(t * 1e6) * 1000 for t in time_s.tolist()]


def covariances_of(deviations: Array) -> Array:
    """Return covariances (n, 3, 3) for standard deviations (n, 2): position [m], heading [rad]."""
    covariances = np.zeros((len(deviations), 3, 3))
    covariances[:, 0, 0] = covariances[:, 1, 1] = deviations[:, 0] ** 2
    covariances[:, 2, 2] = deviations[:, 1] ** 2
    return covariances


def damaged_line(path: Path, line: int, fault: str) -> RecordingError:
    """Return the error for a damaged line."""
    return RecordingError(
        f"{path}, line {line}: {fault}. The file is cut off, changed or of another format: "
        "take a fresh copy of the data set."
    )


def poses_at(odometry: OdometryStream, stamps: Sequence[int]) -> NDArray[np.float64]:
    """Return interpolated poses (n, 3) at times [ns]; headings are not wrapped."""
    origin = odometry.stamps[0]
    times = np.array([stamp - origin for stamp in odometry.stamps], dtype=np.float64)
    wanted = np.array([stamp - origin for stamp in stamps], dtype=np.float64)
    x, y, theta = odometry.poses.T
    columns = (x, y, np.unwrap(theta))
    return np.column_stack([np.interp(wanted, times, column) for column in columns])
