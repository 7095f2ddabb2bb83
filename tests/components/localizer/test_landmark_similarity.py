"""Equation (1) in all modes: clamped, never NaN, neutral where nothing is known."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.components.localizer.landmark_evidence import (
    LEAST,
    convergence_radius,
    likelihood_ratio_similarity,
    paper_similarity,
    sample_ring,
)
from cairn.components.localizer.observations import (
    Landmark,
    as_certain,
    implied_position,
    innovation,
    object_log_likelihood,
)
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.visual_map.observations import Observation

number = st.floats(-20.0, 20.0)


def pose(x: float = 0.0, y: float = 0.0, theta: float = 0.0, sd: float = 0.05) -> PoseEstimate:
    return PoseEstimate((x, y, theta), np.diag([sd**2, sd**2, (0.5 * sd) ** 2]))


def observed(range_m: float, bearing: float = 0.0) -> Observation:
    return Observation(1, range_m, bearing, 0.1**2, 0.02**2)


@given(number, number, st.floats(-4, 4), st.floats(0.05, 15.0), st.floats(-4, 4), number, number)
def test_similarity_is_always_a_number_within_its_bounds(
    x: float, y: float, theta: float, reach: float, bearing: float, mx: float, my: float
) -> None:
    found = innovation(pose(x, y, theta), observed(reach, bearing), Landmark(1, mx, my))

    assert 0.1 <= likelihood_ratio_similarity(found) <= 0.9


def test_object_in_place_agrees_and_moved_object_disagrees() -> None:
    landmark = Landmark(1, 2.0, 0.0)

    assert likelihood_ratio_similarity(innovation(pose(), observed(2.0), landmark)) == 0.9
    assert likelihood_ratio_similarity(innovation(pose(), observed(3.0), landmark)) == 0.1
    assert likelihood_ratio_similarity(innovation(pose(), observed(2.0, 0.7), landmark)) == 0.1


def test_uncertain_pose_is_neutral() -> None:
    lost = pose(sd=3.0)

    assert (
        likelihood_ratio_similarity(innovation(lost, observed(3.0), Landmark(1, 2.0, 0.0))) == 0.5
    )


@pytest.mark.parametrize(
    ("radius", "distance", "similarity"),
    [(0.2, 0.1, 0.9), (0.2, 0.4, 0.5), (0.2, 0.8, 0.25), (0.2, 5.0, 0.1), (0.2, 0.0, 0.9)],
)
def test_paper_similarity_is_radius_over_distance_clamped(
    radius: float, distance: float, similarity: float
) -> None:
    assert paper_similarity(radius, distance) == pytest.approx(similarity)


def test_convergence_radius_has_a_floor() -> None:
    assert convergence_radius(pose(sd=0.001)) == pytest.approx(0.12)
    assert convergence_radius(pose(sd=0.2)) == pytest.approx(0.49)


def test_implied_position_follows_range_and_bearing() -> None:
    x, y, covariance = implied_position(pose(1.0, 2.0, math.pi / 2), observed(3.0, math.pi / 2))

    assert (x, y) == pytest.approx((-2.0, 2.0))
    assert covariance[0, 0] > 0.1**2
    assert np.all(np.linalg.eigvalsh(covariance) > 0)


@given(number, number, st.floats(0.3, 8.0), st.floats(-1.0, 1.0), st.integers(0, 1000))
def test_new_samples_agree_with_the_observation(
    mx: float, my: float, reach: float, bearing: float, seed: int
) -> None:
    landmark = Landmark(1, mx, my, reliability=0.98)
    observation = observed(reach, bearing)

    ring = sample_ring(observation, landmark, 300, np.random.default_rng(seed))

    fit = object_log_likelihood(ring, observation, landmark)
    assert np.mean(fit > -4.6) > 0.95
    around = np.arctan2(ring[1] - my, ring[0] - mx)
    assert np.hypot(np.cos(around).mean(), np.sin(around).mean()) < 0.25


@given(number, number, st.floats(-10, 10), st.floats(0.02, 0.98))
def test_no_observation_excludes_a_pose(x: float, y: float, theta: float, trust: float) -> None:
    landmark = Landmark(1, 0.0, 0.0, reliability=trust)
    poses = np.array([[x], [y], [theta]])

    fit = object_log_likelihood(poses, observed(2.0), landmark)[0]

    assert math.log(1 - trust) - 4.6 - 1e-9 <= fit <= 1e-9


def test_far_displacement_is_a_contradiction() -> None:
    sure = PoseEstimate((0.0, 0.0, 0.0), np.diag([1e-4, 1e-4, 1e-6]))
    seen = Observation(1, 2.0, 0.0, 1e-4, 1e-5)

    found = innovation(sure, seen, Landmark(1, -7.0, 5.0))

    assert found.nis > 1500.0
    assert likelihood_ratio_similarity(found) == LEAST


def test_only_a_certain_object_excludes_poses() -> None:
    far = np.array([[10.0], [10.0], [0.0]])
    landmark = Landmark(1, 2.0, 0.0, reliability=0.9)

    uncertain = object_log_likelihood(far, observed(2.0), landmark)
    certain = object_log_likelihood(far, observed(2.0), as_certain(landmark))

    assert uncertain[0] > -8.0
    assert certain[0] < -100.0
