"""Finding the robot anywhere in the map: the pose that most distinct objects agree on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from components.localizer.object_likelihood import Landmark
from components.localizer.particles import Estimate, estimate, normalised, systematic_choice
from components.localizer.recent import Pose, RecentSightings, Support, carry, relative
from components.localizer.ring import draw_ring

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Found:
    """Samples (3, n) of the best mode, their statistics, its share of the posterior, its support.

    `score` is the log-likelihood of the recent sightings at the mode's mean; `everywhere` holds
    the samples of all modes.
    """

    poses: Array
    pose: Estimate
    share: float
    support: Support
    score: float
    everywhere: Array


def search(
    recent: RecentSightings,
    now: Pose,
    moved_s: float,
    landmarks: Mapping[int, Landmark],
    count: int,
    random: np.random.Generator,
) -> Found | None:
    """Draw `count` poses on the rings of the objects seen of late and keep what explains most.

    Rings around every object in turn, carried to now by odometry, so that one object that was
    moved cannot hide the truth; then annealed on all recent sightings. None without a sighting
    of a mapped object.
    """
    newest = {
        entry.sighting.object_id: entry
        for entry in recent.entries
        if entry.sighting.object_id in landmarks and landmarks[entry.sighting.object_id].live
    }
    if not newest:
        return None
    rings = []
    for object_id, entry in newest.items():
        drawn = draw_ring(entry.sighting, landmarks[object_id], count // len(newest), random)
        rings.append(carry(drawn, relative(entry.at, now)))
    poses = np.concatenate(rings, axis=1)

    size = max(200, count // 10)
    for temper, jitter in ((0.4, 0.10), (0.7, 0.05), (1.0, 0.03)):
        weights = normalised(temper * recent.log_likelihood(poses, now, moved_s, landmarks))
        poses = poses[:, systematic_choice(weights, size, random)]
        noise = jitter * random.standard_normal((3, size))
        noise[2] *= 0.7
        poses = poses + noise
    return _best_mode(poses, recent, now, moved_s, landmarks)


def _best_mode(
    poses: Array,
    recent: RecentSightings,
    now: Pose,
    moved_s: float,
    landmarks: Mapping[int, Landmark],
) -> Found:
    log_weights = recent.log_likelihood(poses, now, moved_s, landmarks)
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
        support=recent.support(pose, now, moved_s, landmarks),
        score=float(recent.log_likelihood(mean, now, moved_s, landmarks)[0]),
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
