"""The particle set: its size, moments, resampling, and tempered updates."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cairn.components.localizer.particle_set import (
    ParticleSet,
    effective_count,
    estimate,
    kld_count,
    normalized,
    resample,
    systematic_choice,
    tempered_update,
)
from cairn.planar.motion_model import MotionModel, OdometryStep

MODEL = MotionModel(0.0, 0.0, 0.02, 0.04, 0.03)
Array = NDArray[np.float64]


def particle_set(least: int = 400, most: int = 5000, seed: int = 0) -> ParticleSet:
    return ParticleSet(least, most, MODEL, np.random.default_rng(seed))


def spread_over(size_m: float, count: int = 5000) -> Array:
    random = np.random.default_rng(0)
    return np.vstack((random.uniform(0, size_m, (2, count)), random.uniform(-3, 3, (1, count))))


def test_particles_in_one_bin_need_the_minimum_number() -> None:
    assert kld_count(np.full((3, 500), 0.1)) == 0


def test_wider_particle_set_needs_more_particles() -> None:
    counts = [kld_count(spread_over(size)) for size in (0.5, 2.0, 5.0, 1000.0)]

    assert counts == sorted(counts)
    assert counts[0] < 0.2 * counts[2]
    # Far apart, every pose has a bin of its own.
    assert counts[-1] == pytest.approx(5000 / 0.04, rel=0.1)


def test_particle_set_shrinks_as_it_becomes_certain() -> None:
    it = particle_set()
    it.set_gaussian((0.0, 0.0, 0.0), np.diag([1.0, 1.0, 0.3]))
    assert it.count == 5000

    for _ in range(6):
        it.fuse(lambda poses: -0.5 * (poses[0] ** 2 + poses[1] ** 2 + poses[2] ** 2) / 0.05)

    assert 400 <= it.count < 2000
    assert it.estimate().spread < 0.2


def test_narrow_likelihood_is_fused_in_stages() -> None:
    it = particle_set()
    it.set_gaussian((0.0, 0.0, 0.0), np.diag([0.09, 0.09, 0.01]))

    it.fuse(lambda poses: -0.5 * ((poses[0] - 0.7) ** 2 + poses[1] ** 2) / 0.01**2)

    assert it.estimate().mean[0] == pytest.approx(0.7, abs=0.03)
    assert len(np.unique(it.poses[0])) > 300


def test_motion_spreads_the_particles_and_standing_does_not() -> None:
    it = particle_set()
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
def test_mean_and_covariance_use_circular_headings(seed: int, heading: float, width: float) -> None:
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
def test_resampling_keeps_mean_and_covariance(seed: int) -> None:
    random = np.random.default_rng(seed)
    poses = np.array([[0.3], [0.1], [0.05]]) * random.standard_normal((3, 4000))
    before = estimate(poses, np.zeros(4000))

    drawn = resample(poses, np.full(4000, 1 / 4000), random)

    after = estimate(drawn, np.zeros(4000))
    assert after.mean == pytest.approx(before.mean, abs=0.02)
    np.testing.assert_allclose(after.covariance, before.covariance, rtol=0.1, atol=2e-3)


@given(st.lists(st.floats(0, 1), min_size=1, max_size=50), st.integers(1, 300), st.integers(0, 99))
def test_particles_are_chosen_in_proportion_to_their_weights(
    parts: list[float], count: int, seed: int
) -> None:
    weights = np.array(parts) + 1e-6
    weights /= weights.sum()

    chosen = systematic_choice(weights, count, np.random.default_rng(seed))

    times = np.bincount(chosen, minlength=weights.size)
    assert np.all(np.abs(times - count * weights) <= 1.0 + 1e-6)


@given(
    st.lists(st.floats(0.0, 1.0), min_size=1, max_size=50).filter(lambda w: sum(w) > 1e-3),
    st.integers(1, 200),
    st.integers(0, 2**32),
)
def test_systematic_resampling_draws_each_as_often_as_its_weight(
    weights: list[float], count: int, seed: int
) -> None:
    share = np.array(weights) / sum(weights)

    chosen = systematic_choice(share, count, np.random.default_rng(seed))

    drawn = np.bincount(chosen, minlength=len(share))
    assert drawn.sum() == count
    assert np.all(np.abs(drawn - count * share) <= 1.0 + 1e-6)


def test_resampling_is_unbiased_over_many_draws() -> None:
    share = np.array([0.05, 0.15, 0.3, 0.5])
    random = np.random.default_rng(0)

    drawn = np.concatenate([systematic_choice(share, 7, random) for _ in range(4000)])

    assert np.bincount(drawn) / drawn.size == pytest.approx(share, abs=0.005)


def test_resampling_keeps_mean_and_spread() -> None:
    random = np.random.default_rng(1)
    poses = np.array([[1.0], [2.0], [3.1]]) + np.array([[0.3], [0.1], [0.2]]) * (
        random.standard_normal((3, 4000))
    )

    before = estimate(poses, np.zeros(4000))
    after = estimate(resample(poses, np.full(4000, 1 / 4000), random), np.zeros(4000))

    assert after.mean == pytest.approx(before.mean, abs=0.02)
    assert np.sqrt(np.diag(after.covariance)) == pytest.approx(
        np.sqrt(np.diag(before.covariance)), rel=0.05
    )


def test_headings_are_averaged_across_the_wrap() -> None:
    poses = np.array([[0.0, 0.0], [0.0, 0.0], [math.pi - 0.1, -math.pi + 0.1]])

    assert abs(estimate(poses, np.zeros(2)).mean[2]) == pytest.approx(math.pi)


@settings(max_examples=25)
@given(st.floats(-1.5, 1.5), st.floats(0.03, 0.3), st.integers(0, 1000))
def test_tempered_update_finds_a_posterior_with_few_samples(
    place: float, sd: float, seed: int
) -> None:
    random = np.random.default_rng(seed)
    poses = random.standard_normal((3, 1, 500)) * np.array([1.0, 0.1, 0.1])[:, None, None]
    log_weights = np.zeros((1, 500))

    tempered_update(poses, log_weights, lambda p, _: -0.5 * ((p[0] - place) / sd) ** 2, random)

    found = estimate(poses[:, 0], log_weights[0])
    posterior_variance = 1 / (1 + 1 / sd**2)
    assert found.mean[0] == pytest.approx(place * posterior_variance / sd**2, abs=0.35 * sd + 0.02)
    assert math.sqrt(found.covariance[0, 0]) == pytest.approx(
        math.sqrt(posterior_variance), rel=0.5
    )
    assert effective_count(log_weights)[0] > 150


def test_weights_are_normalized_for_vanishing_likelihoods() -> None:
    assert normalized(np.array([-1e5, -1e5 - 1.0])).sum() == pytest.approx(1.0)
