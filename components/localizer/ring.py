"""The paper's new samples NR: poses on a ring around a recognized object, and their convergence."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.object_likelihood import Landmark, Sighting
from cairn.components.localizer.particles import Estimate, estimate, normalized, systematic_choice
from cairn.planar.poses import wrap_all

Array = NDArray[np.float64]

CONVERGED = 0.25  # [m] spread under which new samples count as converged


def draw_ring(
    sighting: Sighting, landmark: Landmark, count: int, random: np.random.Generator
) -> Array:
    """`count` poses (3, count) from which `landmark` would be sighted as it was.

    A ring, not a disc: one sighting leaves the direction around the object open (uniform) and
    fixes the distance and, by the bearing, the heading.
    """
    around = random.uniform(-math.pi, math.pi, count)
    reach = sighting.range_m + math.sqrt(sighting.range_variance) * random.standard_normal(count)
    reach = np.maximum(reach, 0.05)
    bearing = sighting.bearing + math.sqrt(sighting.bearing_variance) * random.standard_normal(
        count
    )
    poses = np.empty((3, count))
    poses[0] = landmark.x + reach * np.cos(around)
    poses[1] = landmark.y + reach * np.sin(around)
    poses[2] = wrap_all(around + math.pi - bearing)
    return poses


def converge(
    poses: Array,
    log_likelihood: Callable[[Array], Array],
    random: np.random.Generator,
    rounds: int = 8,
) -> Estimate | None:
    """Let new samples converge by annealing within one frame; None if they do not.

    Each of `rounds` rounds weighs by the log-likelihood at growing temper, resamples and jitters
    by a shrinking step (8 cm, 5 degrees at first). Samples that end wider than 0.25 m give no
    evidence: a mean between two places is no place.
    """
    count = poses.shape[1]
    for k in range(rounds):
        temper = min(1.0, 0.25 * (k + 1))
        weights = normalized(temper * log_likelihood(poses))
        poses = poses[:, systematic_choice(weights, count, random)]
        jitter = 0.5**k * random.standard_normal((3, count))
        poses = poses + jitter * np.array([[0.08], [0.08], [math.radians(5.0)]])
    found = estimate(poses, np.zeros(count))
    return found if found.spread < CONVERGED else None
