"""The cloud of poses: its size, its moments, and how it is drawn anew."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cairn.components.localizer.odometry import MotionModel, OdometryStep
from cairn.components.localizer.particle_set import (
    ParticleSet,
    estimate,
    kld_count,
    resample,
    systematic_choice,
)

MODEL = MotionModel(0.0, 0.0, 0.02, 0.04, 0.03)
Array = NDArray[np.float64]


def cloud(least: int = 400, most: int = 5000, seed: int = 0) -> ParticleSet:
    return ParticleSet(least, most, MODEL, np.random.default_rng(seed))


def spread_over(size_m: float, count: int = 5000) -> Array:
    random = np.random.default_rng(0)
    return np.vstack((random.uniform(0, size_m, (2, count)), random.uniform(-3, 3, (1, count))))


def test_a_cloud_in_one_bin_needs_no_more_than_the_least() -> None:
    assert kld_count(np.full((3, 500), 0.1), np.full(500, 1 / 500)) == 0


def test_the_wider_the_cloud_the_more_poses_it_needs() -> None:
    weights = np.full(5000, 1 / 5000)
    counts = [kld_count(spread_over(size), weights) for size in (0.5, 2.0, 5.0, 1000.0)]

    assert counts == sorted(counts)
    assert counts[0] < 0.2 * counts[2]
    # Far apart, every pose has a bin of its own: as sorted, so counted.
    assert counts[-1] == pytest.approx(5000 / 0.04, rel=0.1)


def test_poses_without_weight_do_not_count() -> None:
    poses = spread_over(20.0)
    weights = np.zeros(5000)
    weights[:2] = 0.5
    poses[:, 1] = poses[:, 0]

    assert kld_count(poses, weights) == 0


def test_a_cloud_shrinks_as_scans_tell_more() -> None:
    it = cloud()
    it.set_gaussian((0.0, 0.0, 0.0), np.diag([1.0, 1.0, 0.3]))
    assert it.count == 5000

    for _ in range(6):
        it.fuse(lambda poses: -0.5 * (poses[0] ** 2 + poses[1] ** 2 + poses[2] ** 2) / 0.05)

    assert 400 <= it.count < 2000
    assert it.estimate().spread < 0.2


def test_a_likelihood_that_few_poses_meet_is_taken_in_stages() -> None:
    it = cloud()
    it.set_gaussian((0.0, 0.0, 0.0), np.diag([0.09, 0.09, 0.01]))

    it.fuse(lambda poses: -0.5 * ((poses[0] - 0.7) ** 2 + poses[1] ** 2) / 0.01**2)

    assert it.estimate().mean[0] == pytest.approx(0.7, abs=0.03)
    assert len(np.unique(it.poses[0])) > 300


def test_moving_spreads_the_cloud_and_standing_does_not() -> None:
    it = cloud()
    it.set_gaussian((0.0, 0.0, 0.0), np.diag([1e-4, 1e-4, 1e-4]))
    before = it.poses.copy()

    it.move(OdometryStep(0.0, 0.0, 0.0, 0.0))
    assert np.array_equal(it.poses, before)
    it.move(OdometryStep(4.0, 0.0, 0.0, 8.0))

    found = it.estimate()
    assert found.mean[0] == pytest.approx(4.0, abs=0.05)
    assert math.sqrt(found.covariance[2, 2]) == pytest.approx(0.03 * 2.0, abs=0.02)


@given(st.integers(0, 1000), st.floats(-3.1, 3.1), st.floats(0.01, 2.5))
@settings(max_examples=50)
def test_moments_are_those_of_the_circle(seed: int, heading: float, width: float) -> None:
    random = np.random.default_rng(seed)
    poses = random.standard_normal((3, 300))
    poses[2] = heading + width * poses[2]
    log_weights = random.standard_normal(300)
    weights = np.exp(log_weights) / np.exp(log_weights).sum()

    found = estimate(poses, log_weights)

    assert found.mean[:2] == pytest.approx((poses[:2] @ weights).tolist(), abs=1e-9)
    mean = math.atan2(float(weights @ np.sin(poses[2])), float(weights @ np.cos(poses[2])))
    away = (found.mean[2] - mean + math.pi) % (2 * math.pi) - math.pi
    assert away == pytest.approx(0.0, abs=1e-3)
    assert np.all(np.linalg.eigvalsh(found.covariance) >= -1e-9)


@given(st.integers(0, 1000))
@settings(max_examples=20)
def test_drawing_anew_keeps_mean_and_covariance(seed: int) -> None:
    random = np.random.default_rng(seed)
    poses = np.array([[0.3], [0.1], [0.05]]) * random.standard_normal((3, 4000))
    before = estimate(poses, np.zeros(4000))

    drawn = resample(poses, np.full(4000, 1 / 4000), 0.3, random)

    after = estimate(drawn, np.zeros(4000))
    assert after.mean == pytest.approx(before.mean, abs=0.02)
    np.testing.assert_allclose(after.covariance, before.covariance, rtol=0.1, atol=2e-3)


@given(st.lists(st.floats(0, 1), min_size=1, max_size=50), st.integers(1, 300), st.integers(0, 99))
def test_every_pose_is_chosen_as_often_as_it_weighs(
    parts: list[float], count: int, seed: int
) -> None:
    weights = np.array(parts) + 1e-6
    weights /= weights.sum()

    chosen = systematic_choice(weights, count, np.random.default_rng(seed))

    times = np.bincount(chosen, minlength=weights.size)
    assert np.all(np.abs(times - count * weights) <= 1.0 + 1e-6)
