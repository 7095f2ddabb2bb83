"""The global search: finds the robot anywhere in the map by what it measured recently."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

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
    tempered_update,
)
from cairn.components.localizer.pose_differences import LEVER_M, place_bin
from cairn.components.localizer.recent_observations import PoseSupport, RecentObservations
from cairn.components.localizer.scan_fit import RecentScans
from cairn.planar.poses import Pose, relative, wrap_all

Array = NDArray[np.float64]

# A global search counts less of a scan: things that no map holds (people, furniture that was moved)
# fit some position or other by chance. From unknown starts on fr101 and fr079 (benchmark
# `localization_logs`) 20 and 19 of 20 were located, after 3 and 2 s; with half 20 and 20 after 6
# and 3 s, with double 20 and 19 after 3 and 1 s.
SEARCH_SHARE = 0.4
# What errs for one scan (a gap in the map, a crowd, a door) errs for the next ones as well: only
# every so many meters of the way scans count as much again as the first one. A scanner sees about
# as far indoors before walls hide the rest.
MOMENT, CORRELATED_M = 0.3, 1.7
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
            around = self.observations.farthest_m
            area = float(np.prod(np.ptp(marks, axis=0) + 2.0 * around)) if len(marks) else 0.0
        return max(1.0, area * 2.0 * math.pi / float(np.prod(2.0 * place_bin())))

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
# So many places are examined, with so many poses at each.
MODES, PARTICLES = 36, 100


@dataclass(frozen=True)
class GlobalSearchResult:
    """Particles (3, n) of each mode, best first, and those of all of them.

    `pose` is that of the best mode, with its share of the posterior and its support by objects.
    """

    modes: list[Array]
    pose: PoseEstimate
    share: float
    support: PoseSupport
    everywhere: Array


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
    poses = np.concatenate(drawn, axis=1) if drawn else np.empty((3, 0))
    del drawn  # as large as `poses`
    if not poses.shape[1]:
        return None
    chosen = systematic_choice(normalized(recent.loose(poses, newest=1)), count, random)
    # As far as the drawn poses are apart.
    apart_m = 1.0 / math.sqrt(_PER_M2)
    apart = np.array([[apart_m], [apart_m], [apart_m / LEVER_M]])
    poses = poses[:, chosen] + apart * random.standard_normal((3, count))
    poses = poses[:, np.argsort(-recent.loose(poses))]
    if known is not None:
        poses = np.hstack([known, poses])
    return _best_of(_modes(poses, recent, random), recent, random)


def _modes(poses: Array, recent: RecentMeasurements, random: np.random.Generator) -> list[Array]:
    """Return particles (3, n) at each of the first places of some poses (3, m).

    Annealed together, places that look alike would be lost one after the other by chance, and the
    last one would seem to be the only one.
    """
    heads = poses[:, _apart(poses)]
    noise = random.standard_normal((3, heads.shape[1], PARTICLES))
    modes = heads[:, :, None] + place_bin()[:, None, None] * noise

    def likelihood(poses: Array, _: NDArray[np.intp]) -> Array:
        return recent.log_likelihood(poses.reshape(3, -1)).reshape(poses.shape[1:])

    log_weights = np.zeros(modes.shape[1:])
    tempered_update(modes, log_weights, likelihood, random)
    return [
        mode[:, systematic_choice(weights, PARTICLES, random)]
        for mode, weights in zip(np.moveaxis(modes, 1, 0), normalized(log_weights), strict=True)
    ]


def _apart(poses: Array) -> list[int]:
    """Return which of some poses (3, n) are the first ones of a place."""
    left = np.arange(poses.shape[1])
    heads: list[int] = []
    while left.size and len(heads) < MODES:
        heads.append(int(left[0]))
        left = left[~_near(poses[:, left], poses[:, heads[-1]])]
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


def _best_of(
    modes: list[Array], recent: RecentMeasurements, random: np.random.Generator
) -> GlobalSearchResult:
    """Return the modes, with the share of the one that explains most: its best pose is compared
    with that of each other mode.
    """
    poses = np.hstack(modes)
    log_weights = recent.log_likelihood(poses)
    everywhere = poses[:, systematic_choice(normalized(log_weights), poses.shape[1], random)]
    tops = log_weights.reshape(len(modes), -1).argmax(axis=1) + PARTICLES * np.arange(len(modes))
    order = np.argsort(-log_weights[tops])
    # Modes next to each other may have ended at one place.
    distinct = order[_apart(poses[:, tops[order]])]
    odds = log_weights[tops[distinct]]
    pose = estimate(modes[distinct[0]], np.zeros(PARTICLES))
    return GlobalSearchResult(
        modes=[modes[k] for k in distinct],
        pose=pose,
        share=1.0 / float(np.exp(odds - odds[0]).sum()),
        support=recent.support(pose),
        everywhere=everywhere,
    )


def _near(poses: Array, center: Array) -> NDArray[np.bool_]:
    """Return which poses (3, n) belong to the place of a center (3,): (n,)."""
    reach = 2.0 * place_bin()
    apart = np.hypot(poses[0] - center[0], poses[1] - center[1])
    near: NDArray[np.bool_] = (apart < reach[0]) & (
        np.abs(wrap_all(poses[2] - center[2])) < reach[2]
    )
    return near
