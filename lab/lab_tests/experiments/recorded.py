"""Series as observers would record them, made up for tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cairn.planar.poses import Pose
from cairn_lab.experiments.series import (
    MethodSeries,
    ObservedObject,
    Position,
    RecordedChange,
    RecordedEvidence,
    RecordedLandmark,
    WorldSeries,
)

ORIGIN: Pose = (0.0, 0.0, 0.0)
END_S = 20.0


def world_series(
    *surveys: tuple[float, Mapping[int, Position]],
    observations: Sequence[ObservedObject] = (),
    poses: Sequence[Pose] = (),
) -> WorldSeries:
    """The robot stands at the origin for 20 s, or moves along `poses` at even times."""
    rows = np.array(poses or [ORIGIN] * 201, np.float64)
    stamps = np.linspace(0.0, END_S, len(rows))
    return WorldSeries(stamps, rows, surveys, tuple(observations), ())


def method_series(
    *,
    off: float = 0.0,
    landmarks: Sequence[RecordedLandmark] = (),
    changes: Sequence[RecordedChange] = (),
    evidence: Sequence[RecordedEvidence] = (),
    until: float = END_S,
) -> MethodSeries:
    """Estimates `off` [m] from the origin ten times a second, with sigmas of 3 and 4 cm."""
    stamps = np.arange(0.0, until, 0.1)
    poses = np.zeros((len(stamps), 3))
    poses[:, 0] = off
    variances = np.tile([0.0009, 0.0, 0.0016, 0.0001], (len(stamps), 1))
    particles = np.column_stack((stamps, np.tile([0.0004, 0.0, 0.0001], (len(stamps), 1))))
    return MethodSeries(
        stamps, poses, variances, particles, tuple(landmarks), tuple(changes), tuple(evidence)
    )


def removal(stamp: float, object_id: int, old: Position) -> RecordedChange:
    """A landmark was removed from the map."""
    return RecordedChange(stamp, object_id, 1, old, None, "it was contradicted")


def registration(stamp: float, object_id: int, new: Position) -> RecordedChange:
    """A landmark was registered."""
    return RecordedChange(stamp, object_id, 2, None, new, "it was observed there")
