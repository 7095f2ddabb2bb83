"""Localizer and map builder by the methods with which Cairn's are compared."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cairn.components.localizer.component import Localizer
from cairn.components.localizer.config import LocalizerConfig
from cairn.components.localizer.landmark_evidence import (
    LEAST,
    MOST,
    NEUTRAL,
    LandmarkEvaluator,
    evidence_of,
)
from cairn.components.localizer.observations import GATE, Innovation, Landmark, innovation
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.components.map_builder.component import MapBuilder
from cairn.components.map_builder.config import MapBuilderConfig
from cairn.components.map_builder.landmark_verdicts import Rule
from cairn.schemas.cairn_msgs import ObjectEvidence
from cairn.visual_map.landmarks import EvidenceVerdict
from cairn.visual_map.observations import Observation
from cairn_lab.experiments.paper_rule import judge_by_paper
from cairn_lab.experiments.persistence_filter import PersistenceFilter

Array = NDArray[np.float64]

Comparison = Literal["paper_rule", "chi_square"]
"""How an observation is compared with the pose: by equation (1) literally, or by a hard gate."""

# Inside this NIS, the 99 % quantile of chi-square with 2 degrees of freedom (-2 ln 0.01), the gate
# accepts an observation.
_ACCEPTED = 9.21


class ComparisonMapBuilderConfig(MapBuilderConfig):
    """Parameters of a map builder with another rule."""

    rule: Literal["paper_rule", "persistence"] = Field(
        description="How evidence changes the map: by the paper's literal rule (paper_rule), or by "
        "a persistence filter (persistence)."
    )


class ComparisonMapBuilder(MapBuilder):
    """A map builder that judges landmarks by another rule than Cairn's."""

    config: ComparisonMapBuilderConfig

    def rule(self) -> Rule:
        """Return how evidence changes the landmarks."""
        return judge_by_paper if self.config.rule == "paper_rule" else PersistenceFilter()


class ComparisonLocalizerConfig(LocalizerConfig):
    """Parameters of a localizer with another similarity."""

    comparison: Comparison = Field(
        description="Similarity by the paper's literal rule, or by a chi-square gate."
    )


class ComparisonLocalizer(Localizer):
    """A localizer that compares observations with the pose in another way than Cairn's."""

    config: ComparisonLocalizerConfig

    def evaluator(self) -> LandmarkEvaluator:
        """Return what compares observations of objects with the pose."""
        config = self.config
        return ComparisonEvaluator(config.comparison, config.ring_samples, self.random)


class ComparisonEvaluator(LandmarkEvaluator):
    """Judges each observation alone, by a similarity that is compared with Cairn's."""

    def __init__(
        self, comparison: Comparison, ring_samples: int, random: np.random.Generator
    ) -> None:
        super().__init__("paper", ring_samples, random)
        self.comparison = comparison

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
        """Return the evidence, and whether the observation contradicts the pose."""
        del vouched, likely, scanned
        landmark = landmarks[observation.object_id]
        if self.comparison == "paper_rule":
            pose = by_all
        difference = innovation(pose, observation, landmark)
        similarity, distance = NEUTRAL, math.sqrt(difference.nis)
        if self.comparison == "chi_square":
            similarity = gate_similarity(difference) if converged else NEUTRAL
        else:
            apart_m = self.distance_to_new_samples(observation, landmark, pose, others)
            distance = apart_m or 0.0
            if apart_m is not None:
                similarity = paper_rule_similarity(paper_rule_radius(pose), apart_m)
        verdict = EvidenceVerdict.NOT_CONVERGED
        if similarity != NEUTRAL:
            agrees = similarity > NEUTRAL
            verdict = EvidenceVerdict.AGREES if agrees else EvidenceVerdict.DISAGREES
        evidence = evidence_of(observation, pose, similarity, verdict, distance)
        return evidence, difference.nis > GATE


def gate_similarity(difference: Innovation) -> float:
    """Agree inside the 99 % gate of the prediction, disagree outside 99.9 %."""
    if difference.nis <= _ACCEPTED:
        return MOST
    return LEAST if difference.nis > GATE else NEUTRAL


def paper_rule_similarity(radius: float, distance: float) -> float:
    """Return equation (1) literally, from 0 to 1; 1 at distance 0."""
    return 1.0 if distance <= radius else radius / distance


def paper_rule_radius(pose: PoseEstimate) -> float:
    """Return r of equation (1) [m] as two standard deviations of the particles, however small."""
    longest = float(np.linalg.eigvalsh(pose.covariance[:2, :2])[-1])
    return 2.0 * math.sqrt(max(longest, 0.0))
