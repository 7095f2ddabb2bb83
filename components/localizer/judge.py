"""The verdict on each sighted object: agrees, disagrees, false match, or nothing to be said."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cairn.components.localizer.displacement import Displacements
from cairn.components.localizer.object_likelihood import (
    Landmark,
    Sighting,
    believed,
    object_log_likelihood,
)
from cairn.components.localizer.particles import Estimate
from cairn.components.localizer.range_scale import RangeScale
from cairn.components.localizer.recent import ANOTHER_M, ANOTHER_RAD
from cairn.components.localizer.ring import converge, draw_ring
from cairn.components.localizer.similarity import (
    GATE,
    LEAST,
    NEUTRAL,
    convergence_radius,
    gate_similarity,
    implied_place,
    innovation,
    likelihood_ratio_similarity,
    paper_similarity,
    radius_to_the_letter,
    similarity_to_the_letter,
)
from cairn.planar.poses import Pose, apart, wrap
from cairn.planar.poses import distance as meters_between

Array = NDArray[np.float64]

VETO = 0.35  # [m] an implied place this near another live object may be that object
SAME_PLACE = 0.6  # [m] implied places this near each other speak of one place
CORROBORATED, CORROBORATED_NEAR_ANOTHER = 3, 8  # contradictions from different poses

# How a sighting is compared with the pose. "lr" and "paper" are for robots; "letter" (the paper's
# equation 1 as it stands) and "chi_square" (a hard gate) are what these are measured against.
Mode = Literal["lr", "paper", "letter", "chi_square"]
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
class Judgment:
    """One object's evidence: similarity of equation (1), verdict, and the implied position.

    `corroborated` is False for a disagreement that stands alone.
    """

    sighting: Sighting
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


class Judge:
    """Compares each sighting with the pose that never fused its object.

    Remembers each object's contradictions since it last agreed: a gross error stands alone, an
    object that was moved is contradicted from many places and always implies the same one.
    """

    def __init__(self, mode: Mode, ring_samples: int, random: np.random.Generator) -> None:
        self.mode = mode
        self.ring_samples = ring_samples
        self.random = random
        self._contradictions: dict[int, list[_Contradiction]] = {}
        self._displacements = Displacements()
        self.ranges = RangeScale()

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

    def place(self, sighting: Sighting, pose: Estimate, healthy: bool) -> Judgment:
        """Where an object that the map does not hold stands: no similarity to judge."""
        self.forget(sighting.object_id)
        sure = healthy and self.ranges.wrong is None
        verdict = Verdict.AGREES if sure else Verdict.NOT_CONVERGED
        return _judgment(sighting, pose, NEUTRAL, verdict, 0.0, False)

    def unseen(
        self, pose: Estimate, landmark: Landmark, range_m: float, bearing: float
    ) -> Judgment:
        """A live object that should be in view at `range_m` [m], `bearing` [rad], and is not."""
        expected = Sighting(landmark.object_id, range_m, bearing, 0.0, 0.0)
        return _judgment(expected, pose, NEUTRAL, Verdict.UNSEEN, 0.0, False)

    def compare(
        self,
        sighting: Sighting,
        pose: Estimate,
        by_all: Estimate,
        landmarks: Mapping[int, Landmark],
        vouched: bool,
        likely: bool,
        converged: bool,
        scanned: bool,
        others: Callable[[Array], Array],
    ) -> Judgment:
        """Judge a live object against `pose`, to which it contributed nothing.

        `by_all` is the pose to which it did contribute.
        `vouched`: scans or other objects speak for that pose; `likely`: they rather do than not;
        `scanned`: scans do, so it is exact to centimeters, if it lies that near `by_all`, too.
        `others` is the log-likelihood of poses by all that was seen of late but the object.
        """
        landmark = landmarks[sighting.object_id]
        seen = innovation(pose, sighting, landmark)
        contradicts = seen.nis > GATE
        similarity, distance = likelihood_ratio_similarity(seen), math.sqrt(seen.nis)
        if self.mode == "chi_square":
            similarity = gate_similarity(seen)
        elif self.mode != "lr":
            similarity, distance = self._by_new_samples(sighting, landmark, pose, others)
        if self.mode in ("letter", "chi_square"):
            sure = converged or self.mode == "letter"
            similarity = similarity if sure else NEUTRAL
            verdict = _plainly(similarity)
            return _judgment(sighting, pose, similarity, verdict, distance, contradicts)
        # To speak against an object takes a firmer pose than to speak for it.
        trusted = vouched or (similarity > NEUTRAL and likely)
        corroborated = True
        verdict = Verdict.NOT_CONVERGED
        misled = converged and vouched and self.ranges.may_err(sighting, pose, landmarks)
        if self.ranges.wrong is not None or (misled and similarity < NEUTRAL):
            similarity = NEUTRAL
        if not converged or not trusted or similarity == NEUTRAL:
            similarity = NEUTRAL
        elif (
            vouched
            and scanned
            and not misled
            and meters_between(pose.mean, by_all.mean) <= _EXACT_M
            and self._displacements.shifted(sighting, pose, landmark)
        ):
            near = self._near_another(sighting, pose, landmarks)
            similarity = NEUTRAL if near else LEAST
            verdict = Verdict.FALSE_MATCH if near else Verdict.DISAGREES
        elif similarity > NEUTRAL:
            verdict = Verdict.AGREES
            self._contradictions.pop(sighting.object_id, None)
        elif likelihood_ratio_similarity(innovation(by_all, sighting, landmark)) > NEUTRAL:
            # One sighting of an object that was moved hardly moves the pose by all: both poses
            # contradict it. Where that one has stayed and agrees, `pose` has gone astray.
            similarity = NEUTRAL
        else:
            verdict, corroborated = self._contradicted(sighting, pose, landmarks)
            if verdict is Verdict.FALSE_MATCH:
                similarity = NEUTRAL
        return _judgment(sighting, pose, similarity, verdict, distance, contradicts, corroborated)

    def _contradicted(
        self,
        sighting: Sighting,
        pose: Estimate,
        landmarks: Mapping[int, Landmark],
    ) -> tuple[Verdict, bool]:
        """Return the verdict on a contradiction, and whether others corroborate it."""
        x, y, _ = implied_place(pose, sighting)
        known = self._contradictions.setdefault(sighting.object_id, [])
        if not known or apart(known[-1].seen_from, pose.mean, ANOTHER_M, ANOTHER_RAD):
            known.append(_Contradiction(x, y, pose.mean))
            del known[:-20]
        together = sum(math.hypot(c.x - x, c.y - y) < SAME_PLACE for c in known)
        if together < CORROBORATED_NEAR_ANOTHER and self._near_another(sighting, pose, landmarks):
            return Verdict.FALSE_MATCH, False
        return Verdict.DISAGREES, together >= CORROBORATED

    def _near_another(
        self, sighting: Sighting, pose: Estimate, landmarks: Mapping[int, Landmark]
    ) -> bool:
        """Whether what was seen may be another object that stands where it was seen."""
        x, y, _ = implied_place(pose, sighting)
        here = landmarks[sighting.object_id]
        return any(
            other.live
            and other.object_id != sighting.object_id
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
        sighting: Sighting,
        landmark: Landmark,
        pose: Estimate,
        others: Callable[[Array], Array],
    ) -> tuple[float, float]:
        """By the paper: similarity and distance [m] of new samples drawn around the object."""
        drawn = draw_ring(sighting, landmark, self.ring_samples, self.random)
        # New samples take the object at its word; else the others would draw them off its ring.
        at_its_word = believed(landmark)
        found = converge(
            drawn,
            lambda poses: others(poses) + object_log_likelihood(poses, sighting, at_its_word),
            self.random,
        )
        if found is None:
            return NEUTRAL, 0.0
        turn = wrap(found.mean[2] - pose.mean[2])
        # 1 m/rad: a move along the circle round the robot shows in the heading alone.
        distance = math.hypot(found.mean[0] - pose.mean[0], found.mean[1] - pose.mean[1], turn)
        if self.mode == "letter":
            return similarity_to_the_letter(radius_to_the_letter(pose), distance), distance
        return paper_similarity(convergence_radius(pose), distance), distance


def _plainly(similarity: float) -> Verdict:
    if similarity == NEUTRAL:
        return Verdict.NOT_CONVERGED
    return Verdict.AGREES if similarity > NEUTRAL else Verdict.DISAGREES


def _judgment(
    sighting: Sighting,
    pose: Estimate,
    similarity: float,
    verdict: Verdict,
    distance: float,
    contradicts: bool,
    corroborated: bool = True,
) -> Judgment:
    x, y, covariance = implied_place(pose, sighting)
    return Judgment(
        sighting, similarity, verdict, distance, x, y, covariance, contradicts, corroborated
    )
