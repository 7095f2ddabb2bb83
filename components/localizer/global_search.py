"""The global search: finds the robot anywhere in the map by what it observed recently."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.landmark_evidence import sample_ring
from cairn.components.localizer.likelihood_field import ScanMap
from cairn.components.localizer.observations import Landmark
from cairn.components.localizer.particle_set import (
    PoseEstimate,
    carry,
    estimate,
    normalized,
    systematic_choice,
)
from cairn.components.localizer.recent_observations import PoseSupport, RecentObservations
from cairn.components.localizer.scans import RecentScans
from cairn.planar.poses import Pose, relative, wrap_all

Array = NDArray[np.float64]

_LOOSE = 4  # of more scans a pose that is a little off explains nothing


@dataclass(frozen=True)
class RecentMeasurements:
    """Recent observations and scans, seen from the dead-reckoned pose `now`.

    `map` is None without a grid map; a scan counts `scan_share` of its log-likelihood.
    """

    observations: RecentObservations
    scans: RecentScans
    landmarks: Mapping[int, Landmark]
    map: ScanMap | None
    scan_share: float
    now: Pose
    moved_s: float

    @property
    def scanned(self) -> bool:
        """Whether there are scans to go by."""
        return self.map is not None and len(self.scans) > 0

    def log_likelihood(self, poses: Array, left_out: int | None = None) -> Array:
        """Log-likelihood (n,) of everything but object `left_out`, were the robot at `poses`."""
        total = self.observations.log_likelihood(
            poses, self.now, self.moved_s, self.landmarks, left_out
        )
        if self.map is not None:
            total += self.scan_share * self.scans.log_likelihood(
                poses, self.now, self.map.field.log_likelihood, None
            )
        return total

    def loose(self, poses: Array) -> Array:
        """The same of the newest scans, taken loosely, so that poses nearby explain them: (n,)."""
        return self._loosely(poses, _LOOSE)

    def first_look(self, poses: Array) -> Array:
        """The same of the observations and the newest scan alone: (n,)."""
        return self._loosely(poses, 1)

    def fit(self, pose: PoseEstimate) -> float:
        """Share of the scans' beams that the map explains from a pose; NaN without scans."""
        if self.map is None:
            return math.nan
        return self.scans.fit(pose.mean, self.now, self.map.field)

    def support(self, pose: PoseEstimate, left_out: int | None = None) -> PoseSupport:
        """How many places of objects agree with a pose, and how many contradict it."""
        return self.observations.support(pose, self.now, self.moved_s, self.landmarks, left_out)

    def _loosely(self, poses: Array, newest: int) -> Array:
        total = self.observations.log_likelihood(poses, self.now, self.moved_s, self.landmarks)
        if self.map is not None:
            total += self.scan_share * self.scans.log_likelihood(
                poses, self.now, self.map.wide.log_likelihood, newest
            )
        return total


# Poses drawn per square meter of free space, and at most.
_PER_M2, _MOST = 300.0, 200_000
# Share of the log-likelihood and jitter [m] (and 0.7 of it [rad]) of each round of annealing.
_ANNEALING = ((0.4, 0.10), (0.7, 0.05), (1.0, 0.03))
_KEPT = 16  # places of a look that the next one looks at again
# Places that are looked at closer, poses drawn at each, and how far around it [m, m, rad].
_MODES, _PER_MODE, _AROUND = 36, 120, np.array([[0.2], [0.2], [0.15]])


@dataclass(frozen=True)
class GlobalSearchResult:
    """Samples (3, n) of the best mode, their statistics, its share of the posterior, its support.

    `score` is the log-likelihood of what was seen of late at the mode's mean, `fit` the share of
    the scans that fits there (NaN without scans); `everywhere` holds the samples of all modes,
    `places` (3, m) the best pose of each, best first, where they were told apart.
    """

    poses: Array
    pose: PoseEstimate
    share: float
    support: PoseSupport
    score: float
    fit: float
    everywhere: Array
    places: Array | None = None


def search(
    evidence: RecentMeasurements,
    count: int,
    random: np.random.Generator,
    known: Array | None = None,
) -> GlobalSearchResult | None:
    """Draw poses wherever the robot may be and keep what explains most.

    `count` on rings around every object seen of late in turn, carried to now by odometry, so that
    one object that was moved cannot hide the truth; with scans and a map, poses all over the free
    space too, and at places `known` (3, m) [m, m, rad] from looks before. None if nothing was
    seen.
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
        poses = _thinned(poses, evidence.first_look(poses), 20_000, 0.10, random)
        poses = _thinned(poses, 0.5 * evidence.loose(poses), 5000, 0.08, random)
        before = [] if known is None else _apart(known, _KEPT)
        new = _apart(poses[:, np.argsort(-evidence.loose(poses))], _MODES - len(before))
        return _best_of(_modes(before + new, evidence, random), evidence)
    size = max(200, count // 10)
    for temper, jitter in _ANNEALING:
        poses = _thinned(poses, temper * evidence.log_likelihood(poses), size, jitter, random)
    return _best_mode(poses, evidence)


def _modes(
    heads: list[Array], evidence: RecentMeasurements, random: np.random.Generator
) -> list[Array]:
    """Samples (3, n) around each of some places, every one annealed by itself.

    Annealed together, places that look alike would be lost one after the other by chance, and the
    last one would seem to be the only one.
    """
    modes = [head + _AROUND * random.standard_normal((3, _PER_MODE)) for head in heads]
    for temper, jitter in _ANNEALING:
        fits = np.split(temper * evidence.log_likelihood(np.hstack(modes)), len(modes))
        modes = [
            _thinned(mode, fit, _PER_MODE, jitter, random)
            for mode, fit in zip(modes, fits, strict=True)
        ]
    return modes


def _apart(poses: Array, count: int) -> list[Array]:
    """The first poses (3, 1) of (3, n), each far from those before it, at most `count`."""
    left = poses
    heads: list[Array] = []
    while left.shape[1] and len(heads) < count:
        heads.append(left[:, :1])
        left = left[:, ~_near(left, left[:, :1], 0.5)[0]]
    return heads


def _on_rings(evidence: RecentMeasurements, count: int, random: np.random.Generator) -> list[Array]:
    newest = {
        entry.observation.object_id: entry
        for entry in evidence.observations.entries
        if entry.observation.object_id in evidence.landmarks
        and evidence.landmarks[entry.observation.object_id].live
    }
    rings = []
    for object_id, entry in newest.items():
        landmark = evidence.landmarks[object_id]
        ring = sample_ring(entry.observation, landmark, count // len(newest), random)
        rings.append(carry(ring, relative(entry.at, evidence.now)))
    return rings


def _thinned(
    poses: Array, log_weights: Array, count: int, jitter: float, random: np.random.Generator
) -> Array:
    poses = poses[:, systematic_choice(normalized(log_weights), count, random)]
    noise = jitter * random.standard_normal((3, count))
    noise[2] *= 0.7
    return poses + noise


def _best_mode(poses: Array, evidence: RecentMeasurements) -> GlobalSearchResult:
    """The densest place, not the single best sample: weight within 0.5 m and 0.5 rad."""
    log_weights = evidence.log_likelihood(poses)
    weights = normalized(log_weights)
    heads = np.argsort(-weights)[:50]
    near = _near(poses, poses[:, heads], 0.5)
    share = near @ weights
    best = int(np.argmax(share))
    return _found(poses, log_weights, near[best], float(share[best]), evidence)


def _best_of(modes: list[Array], evidence: RecentMeasurements) -> GlobalSearchResult:
    """The mode that explains most; its share by what each of the others explains at best."""
    poses = np.hstack(modes)
    log_weights = evidence.log_likelihood(poses)
    best = int(np.argmax(log_weights))
    near = _near(poses, poses[:, best : best + 1], 0.5)[0]
    elsewhere = np.where(near, -np.inf, log_weights).reshape(len(modes), -1).max(axis=1)
    others = float(np.exp(elsewhere - log_weights[best]).sum())
    tops = log_weights.reshape(len(modes), -1).argmax(axis=1) + np.arange(len(modes)) * _PER_MODE
    tops = tops[np.argsort(-log_weights[tops])]
    found = _found(poses, log_weights, near, 1.0 / (1.0 + others), evidence)
    return replace(found, places=poses[:, tops])


def _found(
    poses: Array,
    log_weights: Array,
    members: NDArray[np.bool_],
    share: float,
    evidence: RecentMeasurements,
) -> GlobalSearchResult:
    pose = estimate(poses[:, members], log_weights[members])
    mean = np.asarray(pose.mean)[:, None]
    return GlobalSearchResult(
        poses=poses[:, members],
        pose=pose,
        share=share,
        support=evidence.support(pose),
        score=float(evidence.log_likelihood(mean)[0]),
        fit=evidence.fit(pose),
        everywhere=poses,
    )


def _near(poses: Array, centers: Array, reach: float) -> NDArray[np.bool_]:
    apart = np.hypot(
        poses[0] - centers[0][:, None],
        poses[1] - centers[1][:, None],
    )
    turn = np.abs(wrap_all(poses[2] - centers[2][:, None]))
    near: NDArray[np.bool_] = (apart < reach) & (turn < reach)
    return near
