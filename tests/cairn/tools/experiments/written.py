"""Runs as they would have been written down, made up for tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cairn.planar.poses import Pose
from cairn.tools.experiments.series import (
    Change,
    Evidence,
    Mapped,
    PairSeries,
    Place,
    Sighting,
    WorldSeries,
)

HERE: Pose = (0.0, 0.0, 0.0)
END_S = 20.0


def world(
    *surveys: tuple[float, Mapping[int, Place]],
    sightings: Sequence[Sighting] = (),
    poses: Sequence[Pose] = (),
) -> WorldSeries:
    """The robot stands at the origin for 20 s, or goes along `poses` at even times."""
    rows = np.array(poses or [HERE] * 201, np.float64)
    stamps = np.linspace(0.0, END_S, len(rows))
    return WorldSeries(stamps, rows, surveys, tuple(sightings), ())


def pair(
    *,
    off: float = 0.0,
    mapped: Sequence[Mapped] = (),
    changes: Sequence[Change] = (),
    evidence: Sequence[Evidence] = (),
    until: float = END_S,
) -> PairSeries:
    """Told to be `off` [m] from the origin ten times a second, with deviations of 3, 4 cm."""
    stamps = np.arange(0.0, until, 0.1)
    poses = np.zeros((len(stamps), 3))
    poses[:, 0] = off
    variances = np.tile([0.0009, 0.0, 0.0016, 0.0001], (len(stamps), 1))
    clouds = np.column_stack((stamps, np.tile([0.0004, 0.0, 0.0001], (len(stamps), 1))))
    return PairSeries(
        stamps, poses, variances, clouds, tuple(mapped), tuple(changes), tuple(evidence)
    )


def removed(stamp: float, object_id: int, old: Place) -> Change:
    """An object was removed from the map."""
    return Change(stamp, object_id, 1, old, None, "it was contradicted")


def registered(stamp: float, object_id: int, new: Place) -> Change:
    """An object was registered."""
    return Change(stamp, object_id, 2, None, new, "it was seen there")
