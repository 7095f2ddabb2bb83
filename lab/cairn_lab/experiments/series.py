"""The recorded series of a run: the ground truth, each method's estimates, and their errors."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cairn import CairnError
from cairn.planar.poses import Pose, wrap_all

Array = NDArray[np.float64]
Position = tuple[float, float]

# Length of a step of an `ErrorCurve`.
STEP_S = 0.5
# A robot whose estimate is farther from the truth than this [m] is lost.
LOST_M = 1.0
# A kidnapped robot whose estimate is within this distance [m], angle [rad] of the truth is
# relocalized.
RELOCALIZED_M, RELOCALIZED_RAD = 0.5, 0.5


@dataclass(frozen=True)
class ObservedObject:
    """A recognized object: when [s], its id, range [m] and bearing [rad]."""

    stamp: float
    object_id: int
    range_m: float
    bearing: float


@dataclass(frozen=True)
class TrueMove:
    """An object that was moved: when [s], from and to which position [m]."""

    stamp: float
    object_id: int
    old: Position
    new: Position


@dataclass(frozen=True)
class WorldSeries:
    """The ground truth: robot poses (n, 3) at stamps (n,) [s]; object positions since stamps [s].

    `observations` are those of the object recognizer.
    """

    stamps: Array
    poses: Array
    surveys: tuple[tuple[float, Mapping[int, Position]], ...]
    observations: tuple[ObservedObject, ...]
    collisions: tuple[str, ...]

    def positions(self, stamp: float) -> Mapping[int, Position]:
        """Return the true positions of the objects at a time [s]."""
        return next((found for since, found in reversed(self.surveys) if since <= stamp), {})

    @property
    def moves(self) -> tuple[TrueMove, ...]:
        """The moves of objects, in order of time."""
        steps = zip(self.surveys, self.surveys[1:], strict=False)
        return tuple(
            TrueMove(stamp, object_id, before[object_id], after[object_id])
            for (_, before), (stamp, after) in steps
            for object_id in sorted(before.keys() & after.keys())
            if before[object_id] != after[object_id]
        )

    def true_poses(self, stamps: Array) -> Array:
        """Return the true poses (n, 3) at stamps (n,), interpolated between recorded ones."""
        heading = np.unwrap(self.poses[:, 2])
        columns = (self.poses[:, 0], self.poses[:, 1], heading)
        return np.column_stack([np.interp(stamps, self.stamps, column) for column in columns])


@dataclass(frozen=True)
class RecordedLandmark:
    """A landmark of the visual map as it is from a stamp [s] on."""

    stamp: float
    object_id: int
    position: Position
    live: bool
    reliability: float


@dataclass(frozen=True)
class RecordedChange:
    """A change of the visual map; `kind` as in cairn_msgs/VisualMapChange."""

    stamp: float
    object_id: int
    kind: int
    old: Position | None
    new: Position | None
    reason: str


@dataclass(frozen=True)
class RecordedEvidence:
    """The evidence of one observation; `verdict` as in cairn_msgs/ObjectEvidence.

    The observation implies the object position `position` if the robot is at `robot`.
    """

    stamp: float
    object_id: int
    similarity: float
    verdict: int
    distance: float
    position: Position
    range_m: float
    bearing: float
    robot: Pose


@dataclass(frozen=True)
class MethodSeries:
    """One method's estimates: poses (n, 3) at stamps (n,), variances xx, xy, yy, theta (n, 4).

    `particles` (m, 4) are stamps and the variances of the particles: x, y, theta.
    """

    stamps: Array
    poses: Array
    variances: Array
    particles: Array
    landmarks: tuple[RecordedLandmark, ...]
    changes: tuple[RecordedChange, ...]
    evidence: tuple[RecordedEvidence, ...]

    def map_at(self, stamp: float) -> dict[int, RecordedLandmark]:
        """Return the visual map at a time [s]."""
        return {one.object_id: one for one in self.landmarks if one.stamp <= stamp}


def read_world(file: Path) -> WorldSeries:
    """Read the ground truth of a run; `CairnError` if the file cannot be read."""
    poses: list[list[float]] = []
    surveys: list[tuple[float, Mapping[int, Position]]] = []
    observations: list[ObservedObject] = []
    collisions: list[str] = []
    for kind, stamp, values in _lines(file):
        if kind == "pose":
            poses.append([stamp, *values])
        elif kind == "objects":
            surveys.append((stamp, {key: (x, y) for key, x, y in values[0]}))
        elif kind == "observation":
            observations.append(ObservedObject(stamp, *values))
        elif kind == "collision":
            collisions.append(f"{values[0]} at ({values[1]:.2f}, {values[2]:.2f})")
    rows = np.array(poses, np.float64).reshape(-1, 4)
    return WorldSeries(
        rows[:, 0], rows[:, 1:], tuple(surveys), tuple(observations), tuple(collisions)
    )


def read_method(file: Path) -> MethodSeries:
    """Read the estimates of one method in a run; `CairnError` if the file cannot be read."""
    poses: list[list[float]] = []
    particles: list[list[float]] = []
    landmarks: list[RecordedLandmark] = []
    changes: list[RecordedChange] = []
    evidence: list[RecordedEvidence] = []
    for kind, stamp, values in _lines(file):
        if kind == "pose":
            poses.append([stamp, *values])
        elif kind == "particles":
            particles.append([stamp, *values])
        elif kind == "landmark":
            key, x, y, state, reliability = values
            landmarks.append(RecordedLandmark(stamp, key, (x, y), state == 0, reliability))
        elif kind == "change":
            key, change, old, new, reason = values
            changes.append(
                RecordedChange(stamp, key, change, _position(old), _position(new), reason)
            )
        elif kind == "evidence":
            key, similarity, verdict, distance, x, y, range_m, bearing, (rx, ry, rtheta) = values
            evidence.append(
                RecordedEvidence(
                    stamp,
                    key,
                    similarity,
                    verdict,
                    distance,
                    (x, y),
                    range_m,
                    bearing,
                    (rx, ry, rtheta),
                )
            )
    # A pose from an earlier scan may be published after one from odometry.
    rows = np.array(sorted(poses), np.float64).reshape(-1, 8)
    return MethodSeries(
        rows[:, 0],
        rows[:, 1:4],
        rows[:, 4:],
        np.array(sorted(particles), np.float64).reshape(-1, 4),
        tuple(landmarks),
        tuple(changes),
        tuple(evidence),
    )


@dataclass(frozen=True)
class ErrorCurve:
    """Means within each step of `STEP_S`, NaN where no estimate was published.

    `stamps` (n,) are the middles of the steps [s]; all others (n,) in m or rad: errors of the
    estimates, the standard deviations that they state (sigma), and those of the particles (spread).
    """

    stamps: Array
    position_error: Array
    heading_error: Array
    position_sigma: Array
    heading_sigma: Array
    position_spread: Array
    heading_spread: Array

    def between(self, begin: float, end: float) -> ErrorCurve:
        """Return the part within [begin, end) s."""
        inside = (self.stamps >= begin) & (self.stamps < end)
        return ErrorCurve(*(getattr(self, field.name)[inside] for field in fields(self)))

    @property
    def lost_share(self) -> float:
        """Share of the steps in which the robot was lost or had no pose; NaN without steps."""
        if self.stamps.size == 0:
            return float("nan")
        return float(np.mean(~(self.position_error <= LOST_M)))


def error_curve(series: MethodSeries, world: WorldSeries, end_s: float) -> ErrorCurve:
    """Return the errors and standard deviations of a method's estimates from 0 to `end_s`."""
    count = max(1, round(end_s / STEP_S))
    errors = np.abs(_errors(series, world))
    xx, _, yy, heading = np.maximum(series.variances, 0.0).T
    stamps, particles = series.stamps, series.particles
    return ErrorCurve(
        np.asarray((np.arange(count) + 0.5) * STEP_S, np.float64),
        np.sqrt(_mean_by_step(stamps, errors[:, 0] ** 2 + errors[:, 1] ** 2, count)),
        np.sqrt(_mean_by_step(stamps, errors[:, 2] ** 2, count)),
        _mean_by_step(stamps, np.sqrt(xx + yy), count),
        _mean_by_step(stamps, np.sqrt(heading), count),
        _mean_by_step(particles[:, 0], np.sqrt(particles[:, 1] + particles[:, 2]), count),
        _mean_by_step(particles[:, 0], np.sqrt(particles[:, 3]), count),
    )


def relocalization_time(
    series: MethodSeries, world: WorldSeries, kidnapped_at: float
) -> float | None:
    """Return how long [s] after the kidnapping the estimate was near the truth; None: never."""
    errors = np.abs(_errors(series, world))
    near = (np.hypot(errors[:, 0], errors[:, 1]) <= RELOCALIZED_M) & (
        errors[:, 2] <= RELOCALIZED_RAD
    )
    stamps = series.stamps[near & (series.stamps > kidnapped_at)]
    return float(stamps[0] - kidnapped_at) if stamps.size else None


def _mean_by_step(stamps: Array, values: Array, count: int) -> Array:
    """Return means (count,) of the values (n,) whose stamps (n,) are in each step; NaN if none."""
    step = np.floor(stamps / STEP_S).astype(np.int64)
    inside = (step >= 0) & (step < count)
    found = np.bincount(step[inside], minlength=count)
    total = np.bincount(step[inside], weights=values[inside], minlength=count)
    return np.asarray(np.where(found > 0, total / np.maximum(found, 1), np.nan), np.float64)


def _errors(series: MethodSeries, world: WorldSeries) -> Array:
    """Return the error of each estimated pose (n, 3) [m, m, rad]."""
    errors = series.poses - world.true_poses(series.stamps)
    errors[:, 2] = wrap_all(errors[:, 2])
    return np.asarray(errors, np.float64)


def _lines(file: Path) -> Iterator[tuple[str, float, list[Any]]]:
    try:
        with file.open(encoding="utf-8") as stream:
            for line in stream:
                kind, stamp, *values = json.loads(line)
                yield kind, stamp, values
    except (OSError, ValueError) as error:
        raise CairnError(
            f"{file}: this file is not a series of an experiment: {error}; run the experiment again"
        ) from error


def _position(row: list[float] | None) -> Position | None:
    return None if row is None else (row[0], row[1])
