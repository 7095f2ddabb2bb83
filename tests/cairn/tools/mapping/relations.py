"""The metric of the Freiburg SLAM benchmark: errors of relative poses that people have checked."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cairn.planar.poses import Pose, compose, inverse, relative


@dataclass(frozen=True)
class RelationErrors:
    """Mean errors: position [m], heading [deg]; and the number of relations."""

    position_m: float
    heading_deg: float
    count: int


def relation_errors(trajectory: Path, relations: Path) -> RelationErrors:
    """Return the errors of a trajectory (TUM format), whose times must be those of the relations.

    Kuemmerle et al. 2009: the mean absolute error of translation, and of rotation, over all
    relations.
    """
    poses: dict[str, Pose] = {}
    for line in trajectory.read_text(encoding="utf-8").splitlines():
        time, x, y, _, _, _, z, w = line.split()
        poses[time] = (float(x), float(y), 2.0 * math.atan2(float(z), float(w)))
    position, heading = [], []
    for line in relations.read_text(encoding="utf-8").splitlines():
        first, second, x, y, _, _, _, theta = line.split()
        true = (float(x), float(y), float(theta))
        error = compose(inverse(true), relative(poses[first], poses[second]))
        position.append(math.hypot(error[0], error[1]))
        heading.append(abs(math.degrees(error[2])))
    return RelationErrors(float(np.mean(position)), float(np.mean(heading)), len(position))
