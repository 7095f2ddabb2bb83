"""Tests of the rules for comparison: they follow their papers, weaknesses included."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.components.localizer.observations import Landmark, innovation
from cairn.components.map_builder.landmark_map import LandmarkMap
from cairn.schemas.cairn_msgs import ObjectEvidence
from cairn.visual_map.landmarks import ChangeKind, EvidenceVerdict, LandmarkEvidence, LandmarkState
from cairn_lab.experiments.comparison import (
    Comparison,
    ComparisonEvaluator,
    gate_similarity,
    paper_rule_radius,
    paper_rule_similarity,
)
from cairn_lab.experiments.paper_rule import equation_2, judge_by_paper
from cairn_lab.experiments.persistence_filter import PersistenceFilter
from tests.components.localizer.test_landmark_evidence import evidence_of
from tests.components.localizer.test_landmark_similarity import observed, pose
from tests.components.map_builder.evidence import HERE, THERE, observation, surveyed

PROBABILITIES = st.floats(0.0, 1.0)


@given(PROBABILITIES, PROBABILITIES)
def test_equation_2_returns_a_probability(reliability: float, similarity: float) -> None:
    assert 0.0 <= equation_2(reliability, similarity) <= 1.0


def test_equation_2_matches_the_paper() -> None:
    assert equation_2(0.5, 0.9) == pytest.approx(0.9)
    assert equation_2(0.9, 0.9) == pytest.approx(0.81 / 0.82)
    assert equation_2(0.9, 0.1) == pytest.approx(0.5)


def test_paper_rule_never_removes_an_object_after_full_agreement() -> None:
    visual_map = LandmarkMap([surveyed()], rule=judge_by_paper)

    visual_map.apply([observation(1.0, 0)], 0.0)
    for step in range(1, 30):
        visual_map.apply([observation(0.05, step, THERE)], 0.0)

    assert visual_map.landmarks[7].reliability == 1.0


def test_paper_rule_moves_a_new_object_after_one_bad_observation() -> None:
    visual_map = LandmarkMap([surveyed()], rule=judge_by_paper)

    first = visual_map.apply([observation(0.05, 0, THERE)], 0.0).changes
    second = visual_map.apply([observation(0.05, 0, THERE)], 0.0).changes

    assert [change.kind for change in (*first, *second)] == [
        ChangeKind.REMOVED,
        ChangeKind.REGISTERED,
    ]
    assert visual_map.landmarks[7].position == THERE


def test_detected_feature_persists_and_belief_decays_without_observations() -> None:
    persistence = PersistenceFilter(lifetime_s=600.0)
    known = surveyed()
    for step in range(6):
        known, _ = persistence(known, observation(0.9, step), float(step))
    believed = known.reliability

    later, _ = persistence(known, observation(0.9, 9), 605.0)

    assert believed > 0.99
    assert later.reliability < believed


def test_missed_feature_is_removed_and_registered_where_it_is_seen() -> None:
    visual_map = LandmarkMap([surveyed()], rule=PersistenceFilter())
    for step in range(4):
        visual_map.apply([observation(0.9, step)], float(step))

    kinds = []
    for step in range(4, 16):
        away = LandmarkEvidence(
            7, 0.1, EvidenceVerdict.DISAGREES, 9.0, THERE, (0.2 * step, 0.0, 0.0), healthy=True
        )
        kinds += [change.kind for change in visual_map.apply([away], float(step)).changes]

    assert kinds == [ChangeKind.REMOVED, ChangeKind.REGISTERED]
    assert visual_map.landmarks[7].state is LandmarkState.LIVE


def test_recursion_equals_the_persistence_filter_with_exponential_prior() -> None:
    """The paper's sums: p(x_t | y) = p(y | t) S(t) / p(y), S the survival prior."""
    missed, false, lifetime = 0.3, 0.02, 50.0
    persistence = PersistenceFilter(missed, false, lifetime)
    observed = [(1.0, True), (4.0, False), (9.0, True), (15.0, False), (16.0, False)]

    known = surveyed()
    persistence(known, observation(0.9, -1), 0.0)  # the clock begins
    belief = 0.5
    last = 0.0
    for at_s, detected in observed:
        belief = persistence._updated(belief, detected, at_s - last)
        last = at_s

    def likelihood(gone_at: float) -> float:
        product = 1.0
        for at_s, detected in observed:
            there = at_s <= gone_at
            chance = (
                (1 - missed if there else false) if detected else (missed if there else 1 - false)
            )
            product *= chance
        return product

    # Before the first observation it stood with probability 0.5; it then vanishes at an exponential
    # time.
    times = [0.0, *(at_s for at_s, _ in observed)]
    gone = 0.5 * likelihood(-1.0)
    for begin, end in itertools.pairwise(times):
        mass = math.exp(-begin / lifetime) - math.exp(-end / lifetime)
        gone += 0.5 * mass * likelihood(0.5 * (begin + end))
    stands = 0.5 * math.exp(-times[-1] / lifetime) * likelihood(math.inf)

    assert belief == pytest.approx(stands / (stands + gone))


def test_comparison_rules_register_new_objects() -> None:
    for rule in (judge_by_paper, PersistenceFilter()):
        visual_map = LandmarkMap([], rule=rule)
        for step in range(6):
            visual_map.apply([observation(0.9, step, HERE)], 0.0)

        assert visual_map.landmarks[7].state is LandmarkState.LIVE


def test_paper_rule_similarity_is_not_bounded() -> None:
    assert paper_rule_similarity(0.2, 0.1) == 1.0
    assert paper_rule_similarity(0.2, 0.0) == 1.0
    assert paper_rule_similarity(0.2, 4.0) == pytest.approx(0.05)
    assert paper_rule_similarity(0.0, 1.0) == 0.0
    assert paper_rule_radius(pose(sd=0.001)) == pytest.approx(0.002)


def test_gate_decides_by_one_observation() -> None:
    landmark = Landmark(1, 2.0, 0.0)

    assert gate_similarity(innovation(pose(), observed(2.1), landmark)) == 0.9
    assert gate_similarity(innovation(pose(), observed(3.0), landmark)) == 0.1


def evaluator_of(comparison: Comparison) -> ComparisonEvaluator:
    return ComparisonEvaluator(comparison, 300, np.random.default_rng(0))


def test_gate_and_paper_rule_need_no_corroboration() -> None:
    assert (
        evidence_of(evaluator_of("chi_square"), 1, 0, (4.0, 2.0)).verdict
        == ObjectEvidence.DISAGREES
    )
    assert evidence_of(evaluator_of("chi_square"), 1, 0, (4.0, 2.0)).similarity == pytest.approx(
        0.1
    )
    assert (
        evidence_of(evaluator_of("chi_square"), 1, 0, (3.0, 1.0)).verdict == ObjectEvidence.AGREES
    )
    # Without anything else seen, samples on a ring do not converge: no evidence.
    assert (
        evidence_of(evaluator_of("paper_rule"), 1, 0, (4.0, 2.0)).verdict
        == ObjectEvidence.NOT_CONVERGED
    )
