"""Evidence for and against each landmark: compares its observations with the pose without it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import median
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.observations import (
    GATE,
    MAP_SIGMA,
    NEAREST_M,
    POSE_FLOOR,
    Innovation,
    Landmark,
    as_certain,
    implied_position,
    innovation,
    object_log_likelihood,
)
from cairn.components.localizer.particle_set import ParticleSet, PoseEstimate
from cairn.components.localizer.pose_differences import PLACE_M, is_another
from cairn.planar.motion_model import MotionModel
from cairn.planar.poses import Pose, wrap, wrap_all
from cairn.planar.poses import distance as meters_between
from cairn.schemas.cairn_msgs import ObjectEvidence
from cairn.visual_map.landmarks import EvidenceVerdict
from cairn.visual_map.observations import Observation

Array = NDArray[np.float64]

# Where no other reason is given, the constants of this module were chosen by hand;
# `lab/constants.yaml` has the effect of half and double.

# An implied position this near another live object [m] may be that object. In simulation this veto
# removed all false removals at 1 % and at 5 % of false matches.
VETO = 0.35
# Implied positions this near each other [m] support one position: the errors of two observations.
# Half and double change nothing in four runs of MRCLAM with two landmarks displaced, nor do two
# instead of three below (`python -m cairn_lab.benchmarks.localization_mrclam`).
SAME_POSITION = 0.6
# So many contradictions from different poses corroborate each other; so many near another object,
# which may be what was observed.
CORROBORATED, CORROBORATED_NEAR_ANOTHER = 3, 8

# How an observation is compared with the pose.
SimilarityMode = Literal["lr", "paper"]
# Where scans fix the position, the poses with and without an object differ by no more than this
# [m]: a cell of the map and the noise of two particle sets.
_EXACT_M = 0.15
# So many contradictions of each object are remembered: more than corroboration needs.
_MOST_CONTRADICTIONS = 20


@dataclass(frozen=True)
class _Contradiction:
    x: float
    y: float
    seen_from: Pose


class LandmarkEvaluator:
    """Compares each observation with the pose of the filter that never fused its object.

    It remembers each object's contradictions since it last agreed: a gross error stands alone,
    while an object that was moved is contradicted from many poses and always implies the same
    position.
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
        """Forget an object whose position in the map changed."""
        self._contradictions.pop(object_id, None)
        self._displacements.forget(object_id)
        self.ranges.forget(object_id)

    def clear(self) -> None:
        """Forget all objects, as the robot was somewhere else."""
        self._contradictions.clear()
        self._displacements.clear()
        self.ranges.clear()

    def locate(self, observation: Observation, pose: PoseEstimate, healthy: bool) -> ObjectEvidence:
        """Return where an object stands that the map does not hold: there is no similarity."""
        self.forget(observation.object_id)
        sure = healthy and self.ranges.wrong is None
        verdict = EvidenceVerdict.AGREES if sure else EvidenceVerdict.NOT_CONVERGED
        return evidence_of(observation, pose, NEUTRAL, verdict, 0.0)

    def unseen(
        self, pose: PoseEstimate, landmark: Landmark, range_m: float, bearing: float
    ) -> ObjectEvidence:
        """Return the evidence of a live object that should be in view at a range [m] and bearing
        [rad], but was not recognized.
        """
        expected = Observation(landmark.object_id, range_m, bearing, 0.0, 0.0)
        return evidence_of(expected, pose, NEUTRAL, EvidenceVerdict.UNSEEN, 0.0)

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
    ) -> tuple[ObjectEvidence, bool]:
        """Compare an observation of a live object with `pose`, to which the object contributed
        nothing.

        Args:
            observation: Of a live object of `landmarks`.
            pose: The pose without the object.
            by_all: The pose to which the object did contribute.
            landmarks: The objects of the map.
            vouched: Whether scans or other objects support `pose`.
            likely: Whether they support it rather than not.
            converged: Whether `pose` is certain enough.
            scanned: Whether scans support it: then it is exact to centimeters, if near `by_all`.
            others: Log-likelihood (n,) of poses (3, n) by all recent measurements but the object's.

        Returns:
            The evidence, and whether the observation contradicts `pose`: it lies outside the
            99.9 % gate of the prediction.
        """
        landmark = landmarks[observation.object_id]
        difference = innovation(pose, observation, landmark)
        contradicts = difference.nis > GATE
        similarity, distance = likelihood_ratio_similarity(difference), math.sqrt(difference.nis)
        if self.mode == "paper":
            apart_m = self.distance_to_new_samples(observation, landmark, pose, others)
            similarity, distance = NEUTRAL, apart_m or 0.0
            if apart_m is not None:
                similarity = paper_similarity(convergence_radius(pose), apart_m)
        # Evidence against an object requires a more reliable pose than evidence for it.
        trusted = vouched or (similarity > NEUTRAL and likely)
        corroborated = True
        verdict = EvidenceVerdict.NOT_CONVERGED
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
            verdict = EvidenceVerdict.FALSE_MATCH if near else EvidenceVerdict.DISAGREES
        elif similarity > NEUTRAL:
            verdict = EvidenceVerdict.AGREES
            self._contradictions.pop(observation.object_id, None)
        elif likelihood_ratio_similarity(innovation(by_all, observation, landmark)) > NEUTRAL:
            # One observation of an object that was moved hardly changes the pose by all objects:
            # both poses contradict it. If that pose has not moved and agrees, `pose` has gone
            # astray.
            similarity = NEUTRAL
        else:
            verdict, corroborated = self._contradicted(observation, pose, landmarks)
            if verdict is EvidenceVerdict.FALSE_MATCH:
                similarity = NEUTRAL
        evidence = evidence_of(observation, pose, similarity, verdict, distance, corroborated)
        return evidence, contradicts

    def _contradicted(
        self,
        observation: Observation,
        pose: PoseEstimate,
        landmarks: Mapping[int, Landmark],
    ) -> tuple[EvidenceVerdict, bool]:
        """Return the verdict on a contradiction, and whether others corroborate it."""
        x, y, _ = implied_position(pose, observation)
        known = self._contradictions.setdefault(observation.object_id, [])
        if not known or is_another(known[-1].seen_from, pose.mean):
            known.append(_Contradiction(x, y, pose.mean))
            del known[:-_MOST_CONTRADICTIONS]
        together = sum(math.hypot(c.x - x, c.y - y) < SAME_POSITION for c in known)
        if together < CORROBORATED_NEAR_ANOTHER and self._near_another(
            observation, pose, landmarks
        ):
            return EvidenceVerdict.FALSE_MATCH, False
        return EvidenceVerdict.DISAGREES, together >= CORROBORATED

    def _near_another(
        self, observation: Observation, pose: PoseEstimate, landmarks: Mapping[int, Landmark]
    ) -> bool:
        """Whether the observed object may be another one that stands at the implied position."""
        x, y, _ = implied_position(pose, observation)
        here = landmarks[observation.object_id]
        return any(
            other.live
            and other.object_id != observation.object_id
            and math.hypot(other.x - x, other.y - y) < VETO
            and not self._stands_at(other.object_id, here)
            for other in landmarks.values()
        )

    def _stands_at(self, object_id: int, position: Landmark) -> bool:
        """Whether an object was observed at the position of another one: the two were exchanged."""
        return any(
            math.hypot(one.x - position.x, one.y - position.y) < VETO
            for one in self._contradictions.get(object_id, ())
        )

    def distance_to_new_samples(
        self,
        observation: Observation,
        landmark: Landmark,
        pose: PoseEstimate,
        others: Callable[[Array], Array],
    ) -> float | None:
        """Return how far [m] from `pose` new samples converge that are drawn around the object.

        This is the distance of the paper's equation (1); None if they do not converge.
        """
        drawn = sample_ring(observation, landmark, self.ring_samples, self.random)
        # New samples assume that the object stands in its position; otherwise the other
        # measurements would draw them off its ring.
        certain = as_certain(landmark)
        found = converge(
            drawn,
            lambda poses: others(poses) + object_log_likelihood(poses, observation, certain),
            self.random,
        )
        if found is None:
            return None
        turn = wrap(found.mean[2] - pose.mean[2])
        # 1 m/rad: a move along the circle around the object appears in the heading only.
        return math.hypot(found.mean[0] - pose.mean[0], found.mean[1] - pose.mean[1], turn)


def evidence_of(
    observation: Observation,
    pose: PoseEstimate,
    similarity: float,
    verdict: EvidenceVerdict,
    distance: float,
    corroborated: bool = True,
) -> ObjectEvidence:
    """Return the message of evidence about an observed object."""
    x, y, covariance = implied_position(pose, observation)
    return ObjectEvidence(
        object_id=observation.object_id,
        similarity=similarity,
        verdict=int(verdict),
        distance=distance,
        x=x,
        y=y,
        covariance=0.5 * (covariance + covariance.T).ravel(),
        range=observation.range_m,
        bearing=observation.bearing,
        corroborated=corroborated,
    )


# Equation (2) never returns from 0 or 1, so a similarity never reaches them. The paper shows 0.5 ->
# 0.9 after one evaluation (figures 7 and 10): its similarities were at most 0.9.
LEAST, MOST, NEUTRAL = 0.1, 0.9, 0.5
# Density [1/(m rad)] of an observation of an object that stands anywhere in view: 4 m by 60
# degrees.
CLUTTER = 1.0 / (4.0 * math.radians(60.0))
# A prediction must exceed clutter by this factor at its peak: its similarity is then up to 0.8.
_CLEAR = 4.0


def likelihood_ratio_similarity(difference: Innovation) -> float:
    """Mode "lr": the odds of "stands where the map says" against "stands anywhere in view".

    A prediction too vague to exceed clutter even for an exact match is neutral.
    """
    if difference.peak < _CLEAR * CLUTTER:
        return NEUTRAL
    return clamp(difference.density / (difference.density + CLUTTER))


def paper_similarity(radius: float, distance: float) -> float:
    """Mode "paper": equation (1), r / d, 1 inside the bound; clamped. Both in meters."""
    return clamp(min(1.0, radius / max(distance, 1e-6)))


def clamp(similarity: float) -> float:
    """Return a similarity within [0.1, 0.9]."""
    return min(MOST, max(LEAST, similarity))


def convergence_radius(pose: PoseEstimate) -> float:
    """Return r of equation (1) [m]: 95 % of the particles along their longest axis, at least
    0.12 m.
    """
    longest = float(np.linalg.eigvalsh(pose.covariance[:2, :2])[-1])
    return max(POSE_FLOOR, _RADIUS_95 * math.sqrt(max(longest, 0.0)))


# So many deviations hold 95 % of a normal distribution in two dimensions: sqrt(-2 ln 0.05).
_RADIUS_95 = 2.45


def sample_ring(
    observation: Observation, landmark: Landmark, count: int, random: np.random.Generator
) -> Array:
    """Return `count` poses (3, count) from which `landmark` would be observed as it was.

    The poses form a ring, not a disc: one observation leaves the direction around the object open
    (uniform), and fixes the distance and, by the bearing, the heading.
    """
    around = random.uniform(-math.pi, math.pi, count)
    reach = observation.range_m + math.sqrt(observation.range_variance) * random.standard_normal(
        count
    )
    reach = np.maximum(reach, NEAREST_M)
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
) -> PoseEstimate | None:
    """Let new samples converge by annealing within one image; return None if they do not.

    Samples that end wider than a place give no evidence: the mean of two positions is not one of
    them.
    """
    found = ParticleSet(poses.shape[1], poses.shape[1], MotionModel(), random)
    found.set_particles(poses)
    found.fuse(log_likelihood)
    pose = found.estimate()
    return pose if pose.spread < 0.5 * PLACE_M else None


# So many of the newest observations from different poses are averaged: few detect a large shift
# soon, many detect a small one.
_WINDOWS = (6, 10, 20)
# What observations from all poses have in common through errors of map and pose [m].
_COMMON_M = 0.05
# A shift smaller than this [m] matters to no reader of the map; a larger one shows in single
# observations, and an implied position beyond that is of another object.
_SMALL_M, _LARGE_M = 0.15, 0.8


@dataclass(frozen=True)
class _Implied:
    """The position [m] that an observation implies, its own covariance [m^2], and the robot's
    pose.
    """

    position: Array
    noise: Array
    seen_from: Pose


class DisplacementDetector:
    """Detects objects a little beside their mapped positions, which only many observations show.

    A single observation of an object that was moved by a few decimeters agrees with its old
    position within its noise. The mean of several does not.
    """

    def __init__(self) -> None:
        self._implied: dict[int, deque[_Implied]] = {}

    def forget(self, object_id: int) -> None:
        """Forget an object whose position in the map changed."""
        self._implied.pop(object_id, None)

    def clear(self) -> None:
        """Forget everything, as the robot was somewhere else."""
        self._implied.clear()

    def shifted(self, observation: Observation, pose: PoseEstimate, landmark: Landmark) -> bool:
        """Add an observation from a reliable pose; return whether the object clearly stands
        beside its position.
        """
        known = self._implied.setdefault(observation.object_id, deque(maxlen=_WINDOWS[-1]))
        x, y, whole = implied_position(pose, observation)
        if math.hypot(x - landmark.x, y - landmark.y) > _LARGE_M:
            return False
        exact = PoseEstimate(pose.mean, np.zeros((3, 3)))
        noise = implied_position(exact, observation)[2]
        if not known or is_another(known[-1].seen_from, pose.mean):
            known.append(_Implied(np.array([x, y]), noise, pose.mean))
        mapped = np.array([[landmark.xx, landmark.xy], [landmark.xy, landmark.yy]])
        common = whole - noise + mapped + (_COMMON_M**2 + MAP_SIGMA**2) * np.eye(2)
        mapped_position = np.array([landmark.x, landmark.y])
        windows = [list(known)[-count:] for count in _WINDOWS if count <= len(known)]
        return any(_beside(_agreed(window), mapped_position, common) for window in windows)


@dataclass(frozen=True)
class _Agreed:
    """The weighted mean of implied positions [m], and its covariance [m^2]."""

    position: Array
    noise: Array


def _beside(agreed: _Agreed | None, there: Array, common: Array) -> bool:
    if agreed is None:
        return False
    off = agreed.position - there
    far = math.hypot(*off) >= _SMALL_M
    return far and float(off @ np.linalg.solve(common + agreed.noise, off)) > GATE


def _agreed(implied: list[_Implied]) -> _Agreed | None:
    """Return the mean that five in six of the implied positions agree on; None if they do not.

    Of the smallest window, six, one may be a false match.
    """
    mean = _weighted_mean(implied)
    kept = [one for one in implied if _squared_distance(one, mean) <= GATE]
    return _weighted_mean(kept) if 6 * len(kept) >= 5 * len(implied) else None


def _weighted_mean(implied: list[_Implied]) -> _Agreed:
    information = [np.linalg.inv(one.noise) for one in implied]
    noise = np.linalg.inv(np.sum(information, axis=0))
    weighted = [of_one @ one.position for of_one, one in zip(information, implied, strict=True)]
    return _Agreed(noise @ np.sum(weighted, axis=0), noise)


def _squared_distance(one: _Implied, mean: _Agreed) -> float:
    off = one.position - mean.position
    total = one.noise + mean.noise + _COMMON_M**2 * np.eye(2)
    return float(off @ np.linalg.solve(total, off))


# An observation in the direction of its object [rad], within these ratios of ranges, may be used
# for the range scale; others are false matches, or their object was moved.
_ALONG_RAD = 0.1
_LEAST, _MOST = 0.4, 2.5
# Newest ratios kept of each object, and objects observed last.
_RATIOS, _OBJECTS = 5, 8
# So many objects are needed to know whether ranges err, if the map has as many.
_ENOUGH = 3
# Ratios nearer to 1 than this are noise; a common one of all objects beyond the second is a wrong
# calibration.
_NOISE, _WRONG = 0.04, 0.06
# Most objects share an error of the camera: this share of them has ratios within that share of it.
_MOST_OF_THEM, _ALIKE = 0.75, 0.5


class RangeScaleEstimator:
    """Detects that the ranges of all objects err by one factor, as with a wrongly calibrated
    camera.

    It keeps the ratios of observed ranges to those of the map. A moved object is observed at
    another range, but for the others the map is right. If they all seem to be nearer by the same
    factor, the camera is wrong.
    """

    def __init__(self) -> None:
        self._ratios: dict[int, deque[float]] = {}  # in the order of the last observation

    def forget(self, object_id: int) -> None:
        """Forget an object whose position in the map changed."""
        self._ratios.pop(object_id, None)

    def clear(self) -> None:
        """Forget everything, as the robot was somewhere else."""
        self._ratios.clear()

    @property
    def wrong(self) -> float | None:
        """The factor by which all ranges err, if it is clear that they do."""
        medians = [median(ratios) for ratios in self._ratios.values()]
        if len(medians) < _ENOUGH:
            return None
        factor = median(medians)
        error = abs(factor - 1.0)
        alike = sum(abs(one - factor) <= _ALIKE * error for one in medians)
        return factor if error > _WRONG and alike >= _MOST_OF_THEM * len(medians) else None

    def may_err(
        self, observation: Observation, pose: PoseEstimate, landmarks: Mapping[int, Landmark]
    ) -> bool:
        """Add an observation of a live object from a reliable pose; return whether its range may
        be wrong instead of the object's position: the others err as well, or too few were
        observed.
        """
        landmark = landmarks[observation.object_id]
        dx, dy = landmark.x - pose.mean[0], landmark.y - pose.mean[1]
        off_rad = wrap(observation.bearing + pose.mean[2] - math.atan2(dy, dx))
        ratio = observation.range_m / max(math.hypot(dx, dy), NEAREST_M)
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
