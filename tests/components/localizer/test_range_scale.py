"""A camera whose ranges are all wrong is distinguished from objects that were moved."""

import math

import numpy as np
import pytest

from cairn.components.localizer.landmark_evidence import (
    LandmarkEvaluator,
    SimilarityMode,
)
from cairn.components.localizer.observations import Landmark
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.planar.poses import Pose, wrap
from cairn.schemas.cairn_msgs import ObjectEvidence
from cairn.visual_map.observations import Observation

MAP = {
    key: Landmark(key, x, y, reliability=0.98)
    for key, (x, y) in enumerate([(4.0, 0.0), (3.0, 2.0), (2.0, -3.0), (0.0, 3.0), (-2.0, 1.0)])
}
PATH = [(0.2 * step, 0.1 * step, 0.0) for step in range(8)]


class Robot:
    """Drives along `PATH` and observes all objects from each pose."""

    def __init__(self, mode: SimilarityMode = "lr") -> None:
        self.evaluator = LandmarkEvaluator(mode, 300, np.random.default_rng(0))
        self.random = np.random.default_rng(1)

    def observe(self, object_id: int, at: Pose, factor: float) -> ObjectEvidence:
        """An object at `factor` times its distance on the map."""
        landmark = MAP[object_id]
        dx, dy = landmark.x - at[0], landmark.y - at[1]
        range_m = factor * math.hypot(dx, dy) + self.random.normal(0.0, 0.03)
        bearing = wrap(math.atan2(dy, dx) - at[2] + self.random.normal(0.0, 0.01))
        pose = PoseEstimate(at, np.diag([0.0004, 0.0004, 0.0001]))
        evidence, _ = self.evaluator.compare(
            Observation(object_id, range_m, bearing, 0.03**2, 0.01**2),
            pose,
            pose,
            MAP,
            True,
            True,
            True,
            True,
            lambda poses: np.zeros(poses.shape[1]),
        )
        return evidence

    def observe_all(self, factors: dict[int, float]) -> list[ObjectEvidence]:
        return [self.observe(key, at, factors.get(key, 1.0)) for at in PATH for key in MAP]


@pytest.mark.parametrize("factor", [0.5, 0.75, 0.9, 1.12, 1.4])
@pytest.mark.parametrize("mode", ["lr", "paper"])
def test_wrong_range_scale_causes_no_disagreement_of_an_object(
    factor: float, mode: SimilarityMode
) -> None:
    robot = Robot(mode)

    evidence = robot.observe_all(dict.fromkeys(MAP, factor))

    assert not [one for one in evidence if one.verdict == ObjectEvidence.DISAGREES]
    assert robot.evaluator.ranges.wrong == pytest.approx(factor, abs=0.02)


@pytest.mark.parametrize("factor", [0.7, 1.3])
def test_object_moved_towards_the_robot_is_not_a_range_error(
    factor: float,
) -> None:
    robot = Robot()

    evidence = robot.observe_all({0: factor})

    assert robot.evaluator.ranges.wrong is None
    doubted = [one for one in evidence if one.verdict == ObjectEvidence.DISAGREES]
    assert {one.object_id for one in doubted} == {0}
    assert min(one.similarity for one in doubted) == pytest.approx(0.1)


def test_random_range_errors_are_not_a_wrong_range_scale() -> None:
    robot = Robot()

    evidence = robot.observe_all({})

    assert robot.evaluator.ranges.wrong is None
    assert {one.verdict for one in evidence} == {ObjectEvidence.AGREES}


def test_single_object_cannot_distinguish_its_own_error_from_the_range_scale() -> None:
    robot = Robot()

    alone = [robot.observe(0, at, 0.7) for at in PATH]
    for at in PATH:
        for key in (1, 2, 3):
            robot.observe(key, at, 1.0)
    among_others = [robot.observe(0, at, 0.7) for at in PATH]

    assert {one.verdict for one in alone} == {ObjectEvidence.NOT_CONVERGED}
    assert {one.verdict for one in among_others} == {ObjectEvidence.DISAGREES}


def test_unknown_object_gets_no_position_while_the_range_scale_is_wrong() -> None:
    robot = Robot()
    robot.observe_all(dict.fromkeys(MAP, 0.8))
    here = PoseEstimate((0.0, 0.0, 0.0), 0.0004 * np.eye(3))

    found = robot.evaluator.locate(Observation(9, 2.0, 0.1, 0.001, 0.0001), here, healthy=True)

    assert found.verdict == ObjectEvidence.NOT_CONVERGED
