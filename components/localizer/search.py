"""Finding the robot anywhere in the map: the pose that explains most of what was seen of late."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from components.localizer.evidence import Evidence
from components.localizer.particles import Estimate, estimate, normalised, systematic_choice
from components.localizer.recent import Support, carry
from components.localizer.ring import draw_ring
from planar.poses import relative

Array = NDArray[np.float64]

# Poses drawn per square metre of free space, and at most.
_PER_M2, _MOST = 70.0, 120_000


@dataclass(frozen=True)
class Found:
    """Samples (3, n) of the best mode, their statistics, its share of the posterior, its support.

    `score` is the log-likelihood of what was seen of late at the mode's mean, `fit` the share of
    the scans that fits there (NaN without scans); `everywhere` holds the samples of all modes.
    """

    poses: Array
    pose: Estimate
    share: float
    support: Support
    score: float
    fit: float
    everywhere: Array


def search(evidence: Evidence, count: int, random: np.random.Generator) -> Found | None:
    """Draw poses wherever the robot may be and keep what explains most.

    `count` on rings around every object seen of late in turn, carried to now by odometry, so that
    one object that was moved cannot hide the truth; with scans and a map, poses all over the free
    space too; then annealed on all that was seen. None if nothing was seen.
    """
    drawn = _on_rings(evidence, count, random)
    if evidence.map is not None and evidence.scanned:
        free = evidence.map.free
        drawn.append(free.draw(min(_MOST, max(count, round(_PER_M2 * free.area))), random))
    if not drawn:
        return None
    poses = np.concatenate(drawn, axis=1)
    if not poses.shape[1]:
        return None
    if evidence.scanned:
        poses = _thinned(poses, evidence.first_look(poses), 4000, 0.12, random)
    size = max(200, count // 10)
    for temper, jitter in ((0.4, 0.10), (0.7, 0.05), (1.0, 0.03)):
        poses = _thinned(poses, temper * evidence.log_likelihood(poses), size, jitter, random)
    return _best_mode(poses, evidence)


def _on_rings(evidence: Evidence, count: int, random: np.random.Generator) -> list[Array]:
    newest = {
        entry.sighting.object_id: entry
        for entry in evidence.sightings.entries
        if entry.sighting.object_id in evidence.landmarks
        and evidence.landmarks[entry.sighting.object_id].live
    }
    rings = []
    for object_id, entry in newest.items():
        landmark = evidence.landmarks[object_id]
        ring = draw_ring(entry.sighting, landmark, count // len(newest), random)
        rings.append(carry(ring, relative(entry.at, evidence.now)))
    return rings


def _thinned(
    poses: Array, log_weights: Array, count: int, jitter: float, random: np.random.Generator
) -> Array:
    poses = poses[:, systematic_choice(normalised(log_weights), count, random)]
    noise = jitter * random.standard_normal((3, count))
    noise[2] *= 0.7
    return poses + noise


def _best_mode(poses: Array, evidence: Evidence) -> Found:
    log_weights = evidence.log_likelihood(poses)
    weights = normalised(log_weights)
    # The densest place, not the single best sample: weight within 0.5 m and 0.5 rad.
    heads = np.argsort(-weights)[:50]
    near = _near(poses, poses[:, heads], 0.5)
    share = near @ weights
    best = int(np.argmax(share))
    members = near[best]
    pose = estimate(poses[:, members], log_weights[members])
    mean = np.asarray(pose.mean)[:, None]
    return Found(
        poses=poses[:, members],
        pose=pose,
        share=float(share[best]),
        support=evidence.support(pose),
        score=float(evidence.log_likelihood(mean)[0]),
        fit=evidence.fit(pose),
        everywhere=poses,
    )


def _near(poses: Array, centres: Array, reach: float) -> NDArray[np.bool_]:
    apart = np.hypot(
        poses[0] - centres[0][:, None],
        poses[1] - centres[1][:, None],
    )
    turn = np.abs(np.angle(np.exp(1j * (poses[2] - centres[2][:, None]))))
    near: NDArray[np.bool_] = (apart < reach) & (turn < reach)
    return near
