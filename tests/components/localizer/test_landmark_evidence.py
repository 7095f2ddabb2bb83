"""The evidence for landmarks: single contradictions wait, consistent ones are corroborated."""

import math

import numpy as np
import pytest

from cairn.components.localizer.landmark_evidence import (
    LandmarkEvaluator,
    SimilarityMode,
)
from cairn.components.localizer.observations import Landmark
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.planar.poses import wrap
from cairn.schemas.cairn_msgs import ObjectEvidence
from cairn.visual_map.observations import Observation

A, B = Landmark(1, 3.0, 1.0, reliability=0.9), Landmark(2, 3.0, -1.0, reliability=0.9)
MAP = {1: A, 2: B}


def evidence_of(
    evaluator: LandmarkEvaluator,
    object_id: int,
    step: int,
    at: tuple[float, float],
    sd: float = 0.05,
    by_all: PoseEstimate | None = None,
) -> ObjectEvidence:
    """`object_id` is seen at a place from the pose that is `step` times 0.2 m along the way, which
    is also that by all objects if no other is given.
    """
    pose = PoseEstimate((0.2 * step, 0.0, 0.0), np.diag([0.001, 0.001, 0.0002]))
    dx, dy = at[0] - pose.mean[0], at[1]
    observation = Observation(
        object_id, math.hypot(dx, dy), wrap(math.atan2(dy, dx)), sd**2, 0.0004
    )
    evidence, _ = evaluator.compare(
        observation,
        pose,
        by_all or pose,
        MAP,
        True,
        True,
        True,
        True,
        lambda poses: np.zeros(poses.shape[1]),
    )
    return evidence


def evaluator_of(mode: SimilarityMode = "lr") -> LandmarkEvaluator:
    return LandmarkEvaluator(mode, 300, np.random.default_rng(0))


def test_single_contradiction_is_not_corroborated() -> None:
    found = evidence_of(evaluator_of(), 1, 0, (4.0, 2.0))

    assert found.verdict == ObjectEvidence.DISAGREES
    assert not found.corroborated


def test_clear_forgets_contradictions() -> None:
    evaluator = evaluator_of()
    wrongly = [evidence_of(evaluator, 1, step, (A.x, A.y + 0.4)).verdict for step in range(10)]
    assert wrongly[-1] == ObjectEvidence.DISAGREES

    evaluator.clear()

    rightly = [evidence_of(evaluator, 1, step, (A.x, A.y)).verdict for step in range(10)]
    assert ObjectEvidence.DISAGREES not in rightly


def test_three_consistent_contradictions_corroborate_each_other() -> None:
    evaluator = evaluator_of()

    found = [evidence_of(evaluator, 1, step, (4.0, 2.0)) for step in range(4)]

    assert [one.similarity for one in found] == [0.1] * 4
    assert [one.corroborated for one in found] == [False, False, True, True]


def test_agreement_clears_earlier_contradictions() -> None:
    evaluator = evaluator_of()
    wrong, right = (4.0, 2.0), (A.x, A.y)

    found = [
        evidence_of(evaluator, 1, step, at)
        for step, at in enumerate([wrong, wrong, right, wrong, wrong])
    ]

    assert found[2].verdict == ObjectEvidence.AGREES
    assert not any(one.corroborated for one in found if one.verdict == ObjectEvidence.DISAGREES)


def test_object_is_not_doubted_while_the_full_pose_agrees() -> None:
    evaluator = evaluator_of()
    # The robot is truly 1 m to the right of where the poses without the object have strayed to.
    verdicts = [
        evidence_of(
            evaluator,
            1,
            step,
            (3.0, 2.0),
            by_all=PoseEstimate((0.2 * step, -1.0, 0.0), np.diag([0.001, 0.001, 0.0002])),
        ).verdict
        for step in range(5)
    ]

    assert verdicts == [ObjectEvidence.NOT_CONVERGED] * 5


def test_observation_at_another_object_is_a_false_match() -> None:
    evaluator = evaluator_of()

    verdicts = [evidence_of(evaluator, 1, step, (3.0, -1.0)).verdict for step in range(8)]

    assert verdicts[:7] == [ObjectEvidence.FALSE_MATCH] * 7
    assert verdicts[7] == ObjectEvidence.DISAGREES


def test_two_objects_observed_at_each_others_positions_were_exchanged() -> None:
    evaluator = evaluator_of()
    verdicts = []
    for step in range(5):
        first = evidence_of(evaluator, 1, step, (3.0, -1.0))
        second = evidence_of(evaluator, 2, step, (3.0, 1.0))
        verdicts.append((first.verdict, second.verdict))

    assert verdicts[0][0] == ObjectEvidence.FALSE_MATCH
    assert verdicts[4] == (ObjectEvidence.DISAGREES, ObjectEvidence.DISAGREES)
    assert evidence_of(evaluator, 1, 6, (3.0, -1.0)).similarity == pytest.approx(0.1)


@pytest.mark.parametrize("seed", range(5))
def test_small_displacement_is_detected_by_many_observations(seed: int) -> None:
    """Each observation by itself agrees: it is as noisy as the move is wide."""
    random = np.random.default_rng(seed)
    evaluator = evaluator_of()

    verdicts = []
    for step in range(18):
        dx, dy = 0.1 * random.standard_normal(2)
        verdicts.append(evidence_of(evaluator, 1, step, (3.33 + dx, 1.0 + dy), sd=0.15).verdict)

    assert ObjectEvidence.AGREES in verdicts[:6]
    assert verdicts[6:].count(ObjectEvidence.DISAGREES) >= 3


def test_false_matches_do_not_displace_an_object() -> None:
    evaluator = evaluator_of()
    for step in range(4):
        evidence_of(evaluator, 1, step, (1.5 + step, 2.5), sd=0.15)

    verdicts = {
        evidence_of(evaluator, 1, step, (3.1 if step % 2 else 2.95, 1.0), sd=0.15).verdict
        for step in range(4, 12)
    }

    assert verdicts == {ObjectEvidence.AGREES}


@pytest.mark.parametrize("seed", range(5))
def test_static_object_always_agrees(seed: int) -> None:
    random = np.random.default_rng(seed)
    evaluator = evaluator_of()

    verdicts = set()
    for step in range(40):
        dx, dy = 0.08 * random.standard_normal(2)
        verdicts.add(evidence_of(evaluator, 1, step % 10, (3.05 + dx, 1.0 + dy), sd=0.15).verdict)

    assert verdicts == {ObjectEvidence.AGREES}
