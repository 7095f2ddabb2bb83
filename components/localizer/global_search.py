"""The global search: finds the robot anywhere in the map by what it measured recently."""

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
from cairn.components.localizer.scan_fit import RecentScans
from cairn.planar.poses import Pose, relative, wrap_all

Array = NDArray[np.float64]

# Where no other reason is given, the constants of this module were chosen by hand. Half and double
# of `_LOOSE`, `_PER_M2` and `_MODES` locate as many robots as the present values: 20 and 19 of 20
# from unknown starts on fr101 and fr079 (benchmark `localization_logs`); others were not compared.

# A global search counts less of a scan: things that no map holds (people, furniture that was moved)
# fit some position or other by chance. From unknown starts on fr101 and fr079 (benchmark
# `localization_logs`) 20 and 19 of 20 were located, after 3 and 2 s; with half 20 and 20 after 6
# and 3 s, with double 20 and 19 after 3 and 1 s.
SEARCH_SHARE = 0.4
# What errs for one scan (a gap in the map, a crowd, a door) errs for the next ones as well: only
# every so many meters of the way scans count as much again as the first one. A scanner sees about
# as far indoors before walls hide the rest.
MOMENT, CORRELATED_M = 0.3, 1.7
# Positions differ by at least this: 0.5 m and 0.7 rad each; a map without a grid reaches so far
# around its objects [m].
_PLACES_PER_M2, _AROUND_OBJECTS_M = 2.0 * math.pi / (0.5 * 0.5 * 0.7), 4.0
# So many scans are compared loosely: of more, a pose that is a little off explains nothing.
_LOOSE = 4


@dataclass(frozen=True)
class RecentMeasurements:
    """All recent observations and scans, relative to the dead-reckoned pose `now`.

    `map` is None without a grid map; the share `scan_share` of a scan's log-likelihood counts.
    """

    observations: RecentObservations
    scans: RecentScans
    landmarks: Mapping[int, Landmark]
    map: ScanMap | None
    scan_share: float
    now: Pose
    moved_s: float

    @property
    def places(self) -> float:
        """About how many positions there are at which the robot may be: at least 1."""
        if self.map is not None:
            area = self.map.free.area
        else:
            marks = np.array([(one.x, one.y) for one in self.landmarks.values()]).reshape(-1, 2)
            area = float(np.prod(np.ptp(marks, axis=0) + _AROUND_OBJECTS_M)) if len(marks) else 0.0
        return max(1.0, area * _PLACES_PER_M2)

    def scan_worth(self, poses: Array) -> Array:
        """Return what the recent scans say for poses (3, n) in a comparison of positions: (n,).

        Their errors are correlated: it is the mean over the scans, and more only by the way
        between them.
        """
        if self.map is None or not len(self.scans):
            return np.zeros(poses.shape[1])
        field = self.map.field

        def each(poses: Array, points: Array) -> Array:
            hidden = [field.through_walls((x, y, t), points) for x, y, t in poses.T.tolist()]
            result: Array = field.log_likelihood(poses, points) + hidden
            return result

        total = self.scans.log_likelihood(poses, self.now, each, None)
        worth = self.scan_share * MOMENT * (1.0 + self.scans.way_m / CORRELATED_M) / len(self.scans)
        result: Array = worth * total
        return result

    def object_worth(self, poses: Array) -> Array:
        """Return what the recent observations say for poses (3, n): (n,).

        Where fewer than half of the objects agree, they may all have been moved, and one of them
        agrees by chance: if there are scans, these decide.
        """
        total = self.observations.log_likelihood(
            poses, self.now, self.moved_s, self.landmarks, worth=1.0
        )
        if self.scanned:
            total = np.maximum(total, 0.5 * self.observations.log_stray(self.landmarks))
        return total

    @property
    def scanned(self) -> bool:
        """Whether there are scans and a map to compare them with."""
        return self.map is not None and len(self.scans) > 0

    def log_likelihood(self, poses: Array, left_out: int | None = None) -> Array:
        """Return the log-likelihood (n,) of everything but object `left_out` if the robot were
        at `poses`.
        """
        total = self.observations.log_likelihood(
            poses, self.now, self.moved_s, self.landmarks, left_out
        )
        if self.map is not None:
            total += self.scan_share * self.scans.log_likelihood(
                poses, self.now, self.map.field.log_likelihood, None
            )
        return total

    def loose(self, poses: Array, newest: int = _LOOSE) -> Array:
        """Return the same of the `newest` scans with wide beams, so that poses nearby explain
        them: (n,).
        """
        total = self.observations.log_likelihood(poses, self.now, self.moved_s, self.landmarks)
        if self.map is not None:
            total += self.scan_share * self.scans.log_likelihood(
                poses, self.now, self.map.wide.log_likelihood, newest
            )
        return total

    def fit(self, pose: PoseEstimate) -> float:
        """Return the share of the scans' beams that the map explains from a pose; NaN without
        scans.
        """
        if self.map is None:
            return math.nan
        return self.scans.fit(pose.mean, self.now, self.map.field)

    def support(self, pose: PoseEstimate, left_out: int | None = None) -> PoseSupport:
        """Return how many positions of objects agree with a pose, and how many contradict it."""
        return self.observations.support(pose, self.now, self.moved_s, self.landmarks, left_out)


# Poses drawn per square meter of free space, and at most: one per 6 cm x 6 cm; the wide beams of
# the first look (0.35 m) bridge the gaps between headings.
_PER_M2, _MOST = 300.0, 200_000
# Share of the log-likelihood that counts and noise [m] in each round of annealing, and the noise of
# the heading relative to that [rad/m]: a beam of 1.4 m moves as far by either.
_ANNEALING, _TURN_NOISE = ((0.4, 0.10), (0.7, 0.05), (1.0, 0.03)), 0.7
# Before that, the poses are thinned twice: by the first look, and by this share of the
# log-likelihood of several scans; to so many, with so much noise [m].
_FIRST_LOOK, _FIRST_NOISE = 20_000, 0.10
_LOOSE_SHARE, _LOOSELY, _LOOSE_NOISE = 0.5, 5000, 0.08
# Without scans, one in so many poses is kept, but at least so many.
_ONE_IN, _LEAST_KEPT = 10, 200
# So many of the best particles are examined as centers of a mode, and poses within this distance
# [m], [rad] of one another are of the same mode: 0.5 m as a robot is wide.
_CENTERS, _MODE_WIDTH = 50, 0.5
# So many modes of a search are examined again by the next one.
_KEPT = 16
# Modes that are examined, poses drawn at each, and how far around it [m, m, rad].
_MODES, _PER_MODE, _AROUND = 36, 120, np.array([[0.2], [0.2], [0.15]])


@dataclass(frozen=True)
class GlobalSearchResult:
    """Particles (3, n) of the best mode, their statistics, its share of the posterior, its support.

    `score` is the log-likelihood of the recent measurements at the mode's mean, `fit` the share of
    the scans that fits there (NaN without scans); `everywhere` holds the particles of all modes,
    `modes` (3, m) the best pose of each, best first, if they were separated.
    """

    poses: Array
    pose: PoseEstimate
    share: float
    support: PoseSupport
    score: float
    fit: float
    everywhere: Array
    modes: Array | None = None


def search(
    recent: RecentMeasurements,
    count: int,
    random: np.random.Generator,
    known: Array | None = None,
) -> GlobalSearchResult | None:
    """Draw poses wherever the robot may be, and keep those that explain most.

    Args:
        recent: What the robot measured recently.
        count: Poses drawn on rings around the recently observed objects, each object in turn and
            carried to now by odometry, so that one moved object cannot hide the true pose.
        random: The source of random numbers.
        known: Modes (3, m) [m, m, rad] of earlier searches, where the search starts as well.

    Returns:
        The best mode; None if nothing was measured. With scans and a map, poses are also drawn all
        over the free space.
    """
    drawn = _on_rings(recent, count, random)
    if recent.map is not None and recent.scanned:
        free = recent.map.free
        drawn.append(free.draw(min(_MOST, max(count, round(_PER_M2 * free.area))), random))
    if not drawn:
        return None
    poses = np.concatenate(drawn, axis=1)
    del drawn  # as large as `poses`
    if not poses.shape[1]:
        return None
    if recent.scanned:
        poses = _thinned(poses, recent.loose(poses, newest=1), _FIRST_LOOK, _FIRST_NOISE, random)
        loose = _LOOSE_SHARE * recent.loose(poses)
        poses = _thinned(poses, loose, _LOOSELY, _LOOSE_NOISE, random)
        before = [] if known is None else _apart(known, _KEPT)
        new = _apart(poses[:, np.argsort(-recent.loose(poses))], _MODES - len(before))
        return _best_of(_modes(before + new, recent, random), recent)
    size = max(_LEAST_KEPT, count // _ONE_IN)
    for temper, jitter in _ANNEALING:
        poses = _thinned(poses, temper * recent.log_likelihood(poses), size, jitter, random)
    return _best_mode(poses, recent)


def _modes(
    heads: list[Array], recent: RecentMeasurements, random: np.random.Generator
) -> list[Array]:
    """Return particles (3, n) around each of some poses, annealed separately.

    Annealed together, modes that look alike would be lost one after the other by chance, and the
    last one would seem to be the only one.
    """
    modes = [head + _AROUND * random.standard_normal((3, _PER_MODE)) for head in heads]
    for temper, jitter in _ANNEALING:
        fits = np.split(temper * recent.log_likelihood(np.hstack(modes)), len(modes))
        modes = [
            _thinned(mode, fit, _PER_MODE, jitter, random)
            for mode, fit in zip(modes, fits, strict=True)
        ]
    return modes


def _apart(poses: Array, count: int) -> list[Array]:
    """Return the first poses (3, 1) of (3, n), each far from those before it, at most `count`."""
    left = poses
    heads: list[Array] = []
    while left.shape[1] and len(heads) < count:
        heads.append(left[:, :1])
        left = left[:, ~_near(left, left[:, :1], _MODE_WIDTH)[0]]
    return heads


def _on_rings(recent: RecentMeasurements, count: int, random: np.random.Generator) -> list[Array]:
    newest = {
        entry.observation.object_id: entry for entry in recent.observations.usable(recent.landmarks)
    }
    rings = []
    for object_id, entry in newest.items():
        landmark = recent.landmarks[object_id]
        ring = sample_ring(entry.observation, landmark, count // len(newest), random)
        rings.append(carry(ring, relative(entry.at, recent.now)))
    return rings


def _thinned(
    poses: Array, log_weights: Array, count: int, jitter: float, random: np.random.Generator
) -> Array:
    poses = poses[:, systematic_choice(normalized(log_weights), count, random)]
    noisy = random.standard_normal((3, count))
    noisy *= jitter
    noisy[2] *= _TURN_NOISE
    noisy += poses
    return noisy


def _best_mode(poses: Array, recent: RecentMeasurements) -> GlobalSearchResult:
    """Return the densest mode, not the single best particle: the weight within 0.5 m and 0.5
    rad.
    """
    log_weights = recent.log_likelihood(poses)
    weights = normalized(log_weights)
    heads = np.argsort(-weights)[:_CENTERS]
    near = _near(poses, poses[:, heads], _MODE_WIDTH)
    share = near @ weights
    best = int(np.argmax(share))
    return _found(poses, log_weights, near[best], float(share[best]), recent)


def _best_of(modes: list[Array], recent: RecentMeasurements) -> GlobalSearchResult:
    """Return the mode that explains most; its share compares it with the best pose of each other
    mode.
    """
    poses = np.hstack(modes)
    log_weights = recent.log_likelihood(poses)
    best = int(np.argmax(log_weights))
    near = _near(poses, poses[:, best : best + 1], _MODE_WIDTH)[0]
    elsewhere = np.where(near, -np.inf, log_weights).reshape(len(modes), -1).max(axis=1)
    others = float(np.exp(elsewhere - log_weights[best]).sum())
    tops = log_weights.reshape(len(modes), -1).argmax(axis=1) + np.arange(len(modes)) * _PER_MODE
    tops = tops[np.argsort(-log_weights[tops])]
    found = _found(poses, log_weights, near, 1.0 / (1.0 + others), recent)
    return replace(found, modes=poses[:, tops])


def _found(
    poses: Array,
    log_weights: Array,
    members: NDArray[np.bool_],
    share: float,
    recent: RecentMeasurements,
) -> GlobalSearchResult:
    pose = estimate(poses[:, members], log_weights[members])
    mean = np.asarray(pose.mean)[:, None]
    return GlobalSearchResult(
        poses=poses[:, members],
        pose=pose,
        share=share,
        support=recent.support(pose),
        score=float(recent.log_likelihood(mean)[0]),
        fit=recent.fit(pose),
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
