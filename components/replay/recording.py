"""What a recording of any format holds, as the drivers see it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cairn import CairnError
from cairn.schemas.cairn_msgs import VisualMap
from cairn.schemas.sensor_msgs import LaserScan

Array = NDArray[np.float64]
Gray = NDArray[np.uint8]


class RecordingError(CairnError):
    """A recording that is missing, damaged or of another format."""


@dataclass(frozen=True)
class Odometry:
    """What the wheels told, at `stamps` [ns] in order.

    `poses` (n, 3): x [m], y [m], theta [rad] in the odometry frame; `covariances` (n, 3, 3) of
    them; `twists` (n, 2): forward [m/s] and turn [rad/s, left positive].
    """

    stamps: Sequence[int]
    poses: Array
    covariances: Array
    twists: Array


@dataclass(frozen=True)
class Trajectory:
    """Poses of the robot (n, 3: x [m], y [m], theta [rad]) at `stamps` [ns] in order."""

    stamps: Sequence[int]
    poses: Array


@dataclass(frozen=True)
class Scans:
    """Laser scans in order of their `stamps` [ns], which their headers bear too."""

    stamps: Sequence[int]
    messages: Sequence[LaserScan]


@dataclass(frozen=True)
class Sighting:
    """A landmark seen: range [m], bearing [rad, left positive], variances [m^2, rad^2].

    `code` is what the camera read. `object_id` is None if the recording does not say whose it is.
    """

    code: int
    object_id: int | None
    range_m: float
    bearing: float
    range_variance: float
    bearing_variance: float


@dataclass(frozen=True)
class Sightings:
    """The landmarks seen at each of `stamps` [ns]; a frame may be empty."""

    stamps: Sequence[int]
    frames: Sequence[Sequence[Sighting]]


@dataclass(frozen=True)
class Images:
    """What one camera, or the two (`cameras`) of a stereo camera, took at `stamps` [ns] in order.

    `load` gives the images (h, w), left first, of the stamp with an index; indices must not go
    back. It raises `CairnError` if they cannot be read. All are of one `size`: width, height [px].
    """

    name: str
    stamps: Sequence[int]
    cameras: int
    size: tuple[int, int]
    load: Callable[[int], tuple[Gray, ...]]


@dataclass(frozen=True)
class Source:
    """A series of records as the recording names it, and how many there are.

    `kind` is what it is replayed as: scan, odom, objects, truth, images; None if it
    is not replayed.
    """

    kind: str | None
    topic: str
    type: str
    count: int


class Recording(Protocol):
    """A recording; each method reads what it needs and raises `RecordingError`.

    None stands for what the recording does not hold.
    """

    def span(self) -> tuple[int, int]:
        """Times [ns] of the first and the last record that a replay publishes."""

    def odometry(self) -> Odometry | None:
        """What the wheels told."""

    def scans(self) -> Scans | None:
        """What the laser scanner measured."""

    def sightings(self) -> Sightings | None:
        """What the camera saw."""

    def images(self) -> Images | None:
        """What the cameras took."""

    def truth(self) -> Trajectory | None:
        """Where the robot was, as measured from outside or corrected afterwards."""

    def surveyed(self) -> VisualMap | None:
        """Where the landmarks stand."""

    def sources(self) -> Sequence[Source]:
        """What was recorded, that which is not replayed too."""

    def notes(self) -> Sequence[str]:
        """What of the recording was lost, left out or had to be assumed: sentences."""


def nanoseconds(time_s: Array) -> list[int]:
    """Recorded times [s] as whole nanoseconds; microseconds are what a double holds of them."""
    return [round(t * 1e6) * 1000 for t in time_s.tolist()]


def from_deviations(deviations: Array) -> Array:
    """Covariances (n, 3, 3) from standard deviations (n, 2) of the place [m] and the turn [rad]."""
    covariances = np.zeros((len(deviations), 3, 3))
    covariances[:, 0, 0] = covariances[:, 1, 1] = deviations[:, 0] ** 2
    covariances[:, 2, 2] = deviations[:, 1] ** 2
    return covariances
