"""What observers wrote down of a run, read again: what was true, and what each pair told."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cairn import CairnError
from cairn.planar.poses import Pose

Array = NDArray[np.float64]
Place = tuple[float, float]


@dataclass(frozen=True)
class Sighting:
    """What the recognizer told: of which object, when [s], range [m] and bearing [rad]."""

    stamp: float
    object_id: int
    range_m: float
    bearing: float


@dataclass(frozen=True)
class Move:
    """An object that was put elsewhere: when [s], from where to where [m]."""

    stamp: float
    object_id: int
    old: Place
    new: Place


@dataclass(frozen=True)
class WorldSeries:
    """What was true: robot poses (n, 3) at stamps (n,) [s]; the objects' places since stamps."""

    stamps: Array
    poses: Array
    surveys: tuple[tuple[float, Mapping[int, Place]], ...]
    sightings: tuple[Sighting, ...]
    collisions: tuple[str, ...]

    def places(self, stamp: float) -> Mapping[int, Place]:
        """Where the objects truly stood."""
        return next((places for since, places in reversed(self.surveys) if since <= stamp), {})

    @property
    def moves(self) -> tuple[Move, ...]:
        """Which objects were put elsewhere, in order of time."""
        steps = zip(self.surveys, self.surveys[1:], strict=False)
        return tuple(
            Move(stamp, object_id, before[object_id], after[object_id])
            for (_, before), (stamp, after) in steps
            for object_id in sorted(before.keys() & after.keys())
            if before[object_id] != after[object_id]
        )

    def truth(self, stamps: Array) -> Array:
        """True poses (n, 3) at stamps (n,), between those told in proportion."""
        heading = np.unwrap(self.poses[:, 2])
        columns = (self.poses[:, 0], self.poses[:, 1], heading)
        return np.column_stack([np.interp(stamps, self.stamps, column) for column in columns])


@dataclass(frozen=True)
class Mapped:
    """An object of the visual map as it is from a stamp [s] on."""

    stamp: float
    object_id: int
    place: Place
    live: bool
    reliability: float


@dataclass(frozen=True)
class Change:
    """A change of the visual map; `kind` as in cairn_msgs/VisualMapChange."""

    stamp: float
    object_id: int
    kind: int
    old: Place | None
    new: Place | None
    reason: str


@dataclass(frozen=True)
class Evidence:
    """What one sighting says of an object; `verdict` as in cairn_msgs/ObjectEvidence.

    `place` is where it puts the object if the robot is at `robot`.
    """

    stamp: float
    object_id: int
    similarity: float
    verdict: int
    distance: float
    place: Place
    range_m: float
    bearing: float
    robot: Pose


@dataclass(frozen=True)
class PairSeries:
    """What one pair told: poses (n, 3) at stamps (n,) with variances xx, xy, yy, theta (n, 4).

    `clouds` (m, 4) are stamps and variances of its samples: x, y, theta.
    """

    stamps: Array
    poses: Array
    variances: Array
    clouds: Array
    mapped: tuple[Mapped, ...]
    changes: tuple[Change, ...]
    evidence: tuple[Evidence, ...]

    def map_at(self, stamp: float) -> dict[int, Mapped]:
        """The visual map at a time."""
        return {one.object_id: one for one in self.mapped if one.stamp <= stamp}


def read_world(file: Path) -> WorldSeries:
    """What was true in a run; `CairnError` if the file cannot be read."""
    poses: list[list[float]] = []
    surveys: list[tuple[float, Mapping[int, Place]]] = []
    sightings: list[Sighting] = []
    collisions: list[str] = []
    for what, stamp, values in _lines(file):
        if what == "pose":
            poses.append([stamp, *values])
        elif what == "places":
            surveys.append((stamp, {key: (x, y) for key, x, y in values[0]}))
        elif what == "sighting":
            sightings.append(Sighting(stamp, *values))
        elif what == "collision":
            collisions.append(f"{values[0]} at ({values[1]:.2f}, {values[2]:.2f})")
    rows = np.array(poses, np.float64).reshape(-1, 4)
    return WorldSeries(rows[:, 0], rows[:, 1:], tuple(surveys), tuple(sightings), tuple(collisions))


def read_pair(file: Path) -> PairSeries:
    """What a pair told in a run; `CairnError` if the file cannot be read."""
    poses: list[list[float]] = []
    clouds: list[list[float]] = []
    mapped: list[Mapped] = []
    changes: list[Change] = []
    evidence: list[Evidence] = []
    for what, stamp, values in _lines(file):
        if what == "pose":
            poses.append([stamp, *values])
        elif what == "cloud":
            clouds.append([stamp, *values])
        elif what == "object":
            key, x, y, state, reliability = values
            mapped.append(Mapped(stamp, key, (x, y), state == 0, reliability))
        elif what == "change":
            key, kind, old, new, reason = values
            changes.append(Change(stamp, key, kind, _place(old), _place(new), reason))
        elif what == "evidence":
            key, similarity, verdict, distance, x, y, range_m, bearing, robot = values
            evidence.append(
                Evidence(
                    stamp,
                    key,
                    similarity,
                    verdict,
                    distance,
                    (x, y),
                    range_m,
                    bearing,
                    (robot[0], robot[1], robot[2]),
                )
            )
    # A pose of an earlier scan may be told after one of odometry.
    rows = np.array(sorted(poses), np.float64).reshape(-1, 8)
    return PairSeries(
        rows[:, 0],
        rows[:, 1:4],
        rows[:, 4:],
        np.array(sorted(clouds), np.float64).reshape(-1, 4),
        tuple(mapped),
        tuple(changes),
        tuple(evidence),
    )


def _lines(file: Path) -> Iterator[tuple[str, float, list[Any]]]:
    try:
        with file.open(encoding="utf-8") as stream:
            for text in stream:
                what, stamp, *values = json.loads(text)
                yield what, stamp, values
    except (OSError, ValueError) as error:
        raise CairnError(f"{file}: not a series of an experiment: {error}; run it again") from error


def _place(row: list[float] | None) -> Place | None:
    return None if row is None else (row[0], row[1])
