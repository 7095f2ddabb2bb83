"""The evidence for and against each landmark: compares observations with the pose without it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from statistics import median
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.observations import (
    GATE,
    MAP_SIGMA,
    POSE_FLOOR,
    Innovation,
    Landmark,
    Observation,
    as_certain,
    implied_position,
    innovation,
    object_log_likelihood,
)
from cairn.components.localizer.particle_set import (
    PoseEstimate,
    estimate,
    normalized,
    systematic_choice,
)
from cairn.components.localizer.recent_observations import ANOTHER_M, ANOTHER_RAD
from cairn.planar.poses import Pose, apart, wrap, wrap_all
from cairn.planar.poses import distance as meters_between

Array = NDArray[np.float64]

# So many of the newest observations from different poses are averaged: few tell soon of a large shift,
# many of a small one.
_WINDOWS = (6, 10, 20)
# What observations from all poses may have in common by errors of map and pose [m].
_COMMON_M = 0.05
# A shift of less than this [m] is nothing to anybody; one of more is seen from single observations,
# and what lies farther off than that speaks of something else.
_SMALL_M, _LARGE_M = 0.15, 0.8


@dataclass(frozen=True)
class _Implied:
    """Where a observation placed its object [m], its own covariance [m^2], and the robot's pose."""

    place: Array
    noise: Array
    seen_from: Pose


class DisplacementDetector:
    """The places that the newest observations of each object imply.

    A single observation of an object that was moved by a few decimeters agrees with its old place as
    far as its noise goes. The mean of several does not.
    """

    def __init__(self) -> None:
        self._implied: dict[int, deque[_Implied]] = {}

    def forget(self, object_id: int) -> None:
        """Drop what was noted of an object, as its place in the map changed."""
        self._implied.pop(object_id, None)

    def clear(self) -> None:
        """Drop everything, as the robot was somewhere else."""
        self._implied.clear()

    def shifted(self, observation: Observation, pose: PoseEstimate, landmark: Landmark) -> bool:
        """Note a observation from a sure pose; whether the object clearly stands beside its place."""
        known = self._implied.setdefault(observation.object_id, deque(maxlen=_WINDOWS[-1]))
        x, y, whole = implied_position(pose, observation)
        if math.hypot(x - landmark.x, y - landmark.y) > _LARGE_M:
            return False
        exact = PoseEstimate(pose.mean, np.zeros((3, 3)))
        noise = implied_position(exact, observation)[2]
        if not known or apart(known[-1].seen_from, pose.mean, ANOTHER_M, ANOTHER_RAD):
            known.append(_Implied(np.array([x, y]), noise, pose.mean))
        mapped = np.array([[landmark.xx, landmark.xy], [landmark.xy, landmark.yy]])
        common = whole - noise + mapped + (_COMMON_M**2 + MAP_SIGMA**2) * np.eye(2)
        there = np.array([landmark.x, landmark.y])
        windows = [list(known)[-count:] for count in _WINDOWS if count <= len(known)]
        return any(_beside(_agreed(window), there, common) for window in windows)


@dataclass(frozen=True)
class _Agreed:
    """The weighted mean of implied places [m], and its covariance [m^2]."""

    place: Array
    noise: Array


def _beside(agreed: _Agreed | None, there: Array, common: Array) -> bool:
    if agreed is None:
        return False
    off = agreed.place - there
    far = math.hypot(*off) >= _SMALL_M
    return far and float(off @ np.linalg.solve(common + agreed.noise, off)) > GATE


def _agreed(implied: list[_Implied]) -> _Agreed | None:
    """What the implied places agree on, all but one in six; None if they do not."""
    mean = _weighted_mean(implied)
    kept = [one for one in implied if _squared_distance(one, mean) <= GATE]
    return _weighted_mean(kept) if 6 * len(kept) >= 5 * len(implied) else None


def _weighted_mean(implied: list[_Implied]) -> _Agreed:
    information = [np.linalg.inv(one.noise) for one in implied]
    noise = np.linalg.inv(np.sum(information, axis=0))
    weighted = [of_one @ one.place for of_one, one in zip(information, implied, strict=True)]
    return _Agreed(noise @ np.sum(weighted, axis=0), noise)


def _squared_distance(one: _Implied, mean: _Agreed) -> float:
    off = one.place - mean.place
    total = one.noise + mean.noise + _COMMON_M**2 * np.eye(2)
    return float(off @ np.linalg.solve(total, off))


# A observation in the direction of its object [rad], and not by much more or less far, may tell of the
# ranges; another one is a false match, or its object was moved.
_ALONG_RAD = 0.1
_LEAST, _MOST = 0.4, 2.5
# Newest ratios of an object, and objects seen last, that are gone by.
_RATIOS, _OBJECTS = 5, 8
# So many objects tell whether ranges err, if the map has as many.
_ENOUGH = 3
# Ratios nearer to 1 are noise; of all objects together so much is a wrong calibration.
_NOISE, _WRONG = 0.04, 0.06
# Most objects share an error of the camera: theirs lie within this share of it.
_ALIKE = 0.5


class RangeScaleEstimator:
    """Ratios of the ranges at which objects are seen to those at which the map has them.

    A moved object is seen at another range, but for the others the map is right. If they all seem
    to have come nearer by the same share, it is the camera.
    """

    def __init__(self) -> None:
        self._ratios: dict[int, deque[float]] = {}  # seen longest ago first

    def forget(self, object_id: int) -> None:
        """Drop what was noted of an object, as its place in the map changed."""
        self._ratios.pop(object_id, None)

    def clear(self) -> None:
        """Drop everything, as the robot was somewhere else."""
        self._ratios.clear()

    @property
    def wrong(self) -> float | None:
        """The factor by which ranges err, if it is clear that they do."""
        medians = [median(ratios) for ratios in self._ratios.values()]
        if len(medians) < _ENOUGH:
            return None
        factor = median(medians)
        error = abs(factor - 1.0)
        alike = sum(abs(one - factor) <= _ALIKE * error for one in medians)
        return factor if error > _WRONG and alike >= 0.75 * len(medians) else None

    def may_err(
        self, observation: Observation, pose: PoseEstimate, landmarks: Mapping[int, Landmark]
    ) -> bool:
        """Note a observation of a live object from a sure pose; whether it may be the ranges that err
        instead of its place in the map: the others err as well, or too few have been seen to tell.
        """
        landmark = landmarks[observation.object_id]
        dx, dy = landmark.x - pose.mean[0], landmark.y - pose.mean[1]
        off_rad = wrap(observation.bearing + pose.mean[2] - math.atan2(dy, dx))
        ratio = observation.range_m / max(math.hypot(dx, dy), 0.05)
        if abs(off_rad) > _ALONG_RAD or not _LEAST < ratio < _MOST:
            return False
        known = self._ratios.pop(observation.object_id, deque(maxlen=_RATIOS))
        others = [median(ratios) for ratios in self._ratios.values()]
        known.append(ratio)
        self._ratios[observation.object_id] = known
        while len(self._ratios) > _OBJECTS:
            self._ratios.pop(next(iter(self._ratios)))
        if abs(ratio - 1.0) <= _NOISE:
            return False
        live = sum(one.live for one in landmarks.values()) - 1
        if len(others) < min(_ENOUGH, live):
            return True
        if not others:
            return False
        shared = median(others) - 1.0
        own = ratio - 1.0
        return abs(shared) > _NOISE and shared * own > 0.0 and abs(shared) >= _ALIKE * abs(own)


# Equation (2) never comes back from 0 or 1, so neither does a similarity ever reach them.
LEAST, MOST, NEUTRAL = 0.1, 0.9, 0.5
# Density [1/(m rad)] of a observation of an object that stands anywhere in view: 4 m by 60 degrees.
CLUTTER = 1.0 / (4.0 * math.radians(60.0))
ACCEPTED = 9.21  # inside this one (99 %) a gate takes it for granted


def likelihood_ratio_similarity(seen: Innovation) -> float:
    """SimilarityMode "lr": odds of "stands where the map says" against "stands anywhere in view".

    A prediction too vague to beat clutter even when met exactly says nothing: neutral.
    """
    if seen.peak < 4.0 * CLUTTER:
        return NEUTRAL
    return clamp(seen.density / (seen.density + CLUTTER))


def paper_similarity(radius: float, distance: float) -> float:
    """SimilarityMode "paper": equation (1), r / d, 1 inside the bound; clamped. Both in meters."""
    return clamp(min(1.0, radius / max(distance, 1e-6)))


def gate_similarity(seen: Innovation) -> float:
    """SimilarityMode "chi_square": inside 99 % of the prediction it agrees, outside 99.9 % it does not."""
    if seen.nis <= ACCEPTED:
        return MOST
    return LEAST if seen.nis > GATE else NEUTRAL


def paper_rule_similarity(radius: float, distance: float) -> float:
    """SimilarityMode "letter": equation (1) as the paper has it, from 0 to 1; 1 for no distance at all."""
    return 1.0 if distance <= radius else radius / distance


def paper_rule_radius(pose: PoseEstimate) -> float:
    """r of equation (1) [m] as two standard deviations of the cloud, however small it is."""
    longest = float(np.linalg.eigvalsh(pose.covariance[:2, :2])[-1])
    return 2.0 * math.sqrt(max(longest, 0.0))


def clamp(similarity: float) -> float:
    """A similarity within [0.1, 0.9]."""
    return min(MOST, max(LEAST, similarity))


def convergence_radius(pose: PoseEstimate) -> float:
    """r of equation (1) [m]: 95 % of the cloud along its longest axis, at least 0.12 m."""
    longest = float(np.linalg.eigvalsh(pose.covariance[:2, :2])[-1])
    return max(POSE_FLOOR, 2.45 * math.sqrt(max(longest, 0.0)))


CONVERGED = 0.25  # [m] spread under which new samples count as converged


def sample_ring(
    observation: Observation, landmark: Landmark, count: int, random: np.random.Generator
) -> Array:
    """`count` poses (3, count) from which `landmark` would be sighted as it was.

    A ring, not a disc: one observation leaves the direction around the object open (uniform) and
    fixes the distance and, by the bearing, the heading.
    """
    around = random.uniform(-math.pi, math.pi, count)
    reach = observation.range_m + math.sqrt(observation.range_variance) * random.standard_normal(
        count
    )
    reach = np.maximum(reach, 0.05)
    bearing = observation.bearing + math.sqrt(
        observation.bearing_variance
    ) * random.standard_normal(count)
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
) -> PoseEstimate | None:
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


VETO = 0.35  # [m] an implied place this near another live object may be that object
SAME_PLACE = 0.6  # [m] implied places this near each other speak of one place
CORROBORATED, CORROBORATED_NEAR_ANOTHER = 3, 8  # contradictions from different poses

# How a observation is compared with the pose. "lr" and "paper" are for robots; "letter" (the paper's
# equation 1 as it stands) and "chi_square" (a hard gate) are what these are measured against.
SimilarityMode = Literal["lr", "paper", "letter", "chi_square"]
# Where scans tell the place, the poses with and without an object are no farther apart [m].
_EXACT_M = 0.15


class Verdict(IntEnum):
    """As the constants of cairn_msgs/ObjectEvidence."""

    AGREES = 0
    DISAGREES = 1
    FALSE_MATCH = 2
    NOT_CONVERGED = 3
    UNSEEN = 4


@dataclass(frozen=True)
class LandmarkEvidence:
    """One object's evidence: similarity of equation (1), verdict, and the implied position.

    `corroborated` is False for a disagreement that stands alone.
    """

    observation: Observation
    similarity: float
    verdict: Verdict
    distance: float
    x: float
    y: float
    covariance: Array
    contradicts: bool
    corroborated: bool = True


@dataclass(frozen=True)
class _Contradiction:
    x: float
    y: float
    seen_from: Pose


class LandmarkEvaluator:
    """Compares each observation with the pose that never fused its object.

    Remembers each object's contradictions since it last agreed: a gross error stands alone, an
    object that was moved is contradicted from many places and always implies the same one.
    """

    def __init__(
        self, mode: SimilarityMode, ring_samples: int, random: np.random.Generator
    ) -> None:
        self.mode = mode
        self.ring_samples = ring_samples
        self.random = random
        self._contradictions: dict[int, list[_Contradiction]] = {}
        self._displacements = DisplacementDetector()
        self.ranges = RangeScaleEstimator()

    def forget(self, object_id: int) -> None:
        """Drop what was remembered of an object, as its place in the map changed."""
        self._contradictions.pop(object_id, None)
        self._displacements.forget(object_id)
        self.ranges.forget(object_id)

    def clear(self) -> None:
        """Drop what was remembered of all objects, as the robot was somewhere else."""
        self._contradictions.clear()
        self._displacements.clear()
        self.ranges.clear()

    def place(
        self, observation: Observation, pose: PoseEstimate, healthy: bool
    ) -> LandmarkEvidence:
        """Where an object that the map does not hold stands: no similarity to judge."""
        self.forget(observation.object_id)
        sure = healthy and self.ranges.wrong is None
        verdict = Verdict.AGREES if sure else Verdict.NOT_CONVERGED
        return _evidence_of(observation, pose, NEUTRAL, verdict, 0.0, False)

    def unseen(
        self, pose: PoseEstimate, landmark: Landmark, range_m: float, bearing: float
    ) -> LandmarkEvidence:
        """A live object that should be in view at `range_m` [m], `bearing` [rad], and is not."""
        expected = Observation(landmark.object_id, range_m, bearing, 0.0, 0.0)
        return _evidence_of(expected, pose, NEUTRAL, Verdict.UNSEEN, 0.0, False)

    def compare(
        self,
        observation: Observation,
        pose: PoseEstimate,
        by_all: PoseEstimate,
        landmarks: Mapping[int, Landmark],
        vouched: bool,
        likely: bool,
        converged: bool,
        scanned: bool,
        others: Callable[[Array], Array],
    ) -> LandmarkEvidence:
        """LandmarkEvaluator a live object against `pose`, to which it contributed nothing.

        `by_all` is the pose to which it did contribute.
        `vouched`: scans or other objects speak for that pose; `likely`: they rather do than not;
        `scanned`: scans do, so it is exact to centimeters, if it lies that near `by_all`, too.
        `others` is the log-likelihood of poses by all that was seen of late but the object.
        """
        landmark = landmarks[observation.object_id]
        seen = innovation(pose, observation, landmark)
        contradicts = seen.nis > GATE
        similarity, distance = likelihood_ratio_similarity(seen), math.sqrt(seen.nis)
        if self.mode == "chi_square":
            similarity = gate_similarity(seen)
        elif self.mode != "lr":
            similarity, distance = self._by_new_samples(observation, landmark, pose, others)
        if self.mode in ("letter", "chi_square"):
            sure = converged or self.mode == "letter"
            similarity = similarity if sure else NEUTRAL
            verdict = _plainly(similarity)
            return _evidence_of(observation, pose, similarity, verdict, distance, contradicts)
        # To speak against an object takes a firmer pose than to speak for it.
        trusted = vouched or (similarity > NEUTRAL and likely)
        corroborated = True
        verdict = Verdict.NOT_CONVERGED
        misled = converged and vouched and self.ranges.may_err(observation, pose, landmarks)
        if self.ranges.wrong is not None or (misled and similarity < NEUTRAL):
            similarity = NEUTRAL
        if not converged or not trusted or similarity == NEUTRAL:
            similarity = NEUTRAL
        elif (
            vouched
            and scanned
            and not misled
            and meters_between(pose.mean, by_all.mean) <= _EXACT_M
            and self._displacements.shifted(observation, pose, landmark)
        ):
            near = self._near_another(observation, pose, landmarks)
            similarity = NEUTRAL if near else LEAST
            verdict = Verdict.FALSE_MATCH if near else Verdict.DISAGREES
        elif similarity > NEUTRAL:
            verdict = Verdict.AGREES
            self._contradictions.pop(observation.object_id, None)
        elif likelihood_ratio_similarity(innovation(by_all, observation, landmark)) > NEUTRAL:
            # One observation of an object that was moved hardly moves the pose by all: both poses
            # contradict it. Where that one has stayed and agrees, `pose` has gone astray.
            similarity = NEUTRAL
        else:
            verdict, corroborated = self._contradicted(observation, pose, landmarks)
            if verdict is Verdict.FALSE_MATCH:
                similarity = NEUTRAL
        return _evidence_of(
            observation, pose, similarity, verdict, distance, contradicts, corroborated
        )

    def _contradicted(
        self,
        observation: Observation,
        pose: PoseEstimate,
        landmarks: Mapping[int, Landmark],
    ) -> tuple[Verdict, bool]:
        """Return the verdict on a contradiction, and whether others corroborate it."""
        x, y, _ = implied_position(pose, observation)
        known = self._contradictions.setdefault(observation.object_id, [])
        if not known or apart(known[-1].seen_from, pose.mean, ANOTHER_M, ANOTHER_RAD):
            known.append(_Contradiction(x, y, pose.mean))
            del known[:-20]
        together = sum(math.hypot(c.x - x, c.y - y) < SAME_PLACE for c in known)
        if together < CORROBORATED_NEAR_ANOTHER and self._near_another(
            observation, pose, landmarks
        ):
            return Verdict.FALSE_MATCH, False
        return Verdict.DISAGREES, together >= CORROBORATED

    def _near_another(
        self, observation: Observation, pose: PoseEstimate, landmarks: Mapping[int, Landmark]
    ) -> bool:
        """Whether what was seen may be another object that stands where it was seen."""
        x, y, _ = implied_position(pose, observation)
        here = landmarks[observation.object_id]
        return any(
            other.live
            and other.object_id != observation.object_id
            and math.hypot(other.x - x, other.y - y) < VETO
            and not self._stands_at(other.object_id, here)
            for other in landmarks.values()
        )

    def _stands_at(self, object_id: int, place: Landmark) -> bool:
        """Whether an object was seen where another one stood: the two have changed places."""
        return any(
            math.hypot(seen.x - place.x, seen.y - place.y) < VETO
            for seen in self._contradictions.get(object_id, ())
        )

    def _by_new_samples(
        self,
        observation: Observation,
        landmark: Landmark,
        pose: PoseEstimate,
        others: Callable[[Array], Array],
    ) -> tuple[float, float]:
        """By the paper: similarity and distance [m] of new samples drawn around the object."""
        drawn = sample_ring(observation, landmark, self.ring_samples, self.random)
        # New samples take the object at its word; else the others would draw them off its ring.
        at_its_word = as_certain(landmark)
        found = converge(
            drawn,
            lambda poses: others(poses) + object_log_likelihood(poses, observation, at_its_word),
            self.random,
        )
        if found is None:
            return NEUTRAL, 0.0
        turn = wrap(found.mean[2] - pose.mean[2])
        # 1 m/rad: a move along the circle round the robot shows in the heading alone.
        distance = math.hypot(found.mean[0] - pose.mean[0], found.mean[1] - pose.mean[1], turn)
        if self.mode == "letter":
            return paper_rule_similarity(paper_rule_radius(pose), distance), distance
        return paper_similarity(convergence_radius(pose), distance), distance


def _plainly(similarity: float) -> Verdict:
    if similarity == NEUTRAL:
        return Verdict.NOT_CONVERGED
    return Verdict.AGREES if similarity > NEUTRAL else Verdict.DISAGREES


def _evidence_of(
    observation: Observation,
    pose: PoseEstimate,
    similarity: float,
    verdict: Verdict,
    distance: float,
    contradicts: bool,
    corroborated: bool = True,
) -> LandmarkEvidence:
    x, y, covariance = implied_position(pose, observation)
    return LandmarkEvidence(
        observation, similarity, verdict, distance, x, y, covariance, contradicts, corroborated
    )
