"""Clouds of poses: resampling keeps their number and their mean, narrowing finds the posterior."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.components.localizer.particle_set import (
    effective_count,
    estimate,
    normalized,
    resample,
    systematic_choice,
    tempered_update,
)


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


def test_a_redraw_keeps_mean_and_spread() -> None:
    random = np.random.default_rng(1)
    poses = np.array([[1.0], [2.0], [3.1]]) + np.array([[0.3], [0.1], [0.2]]) * (
        random.standard_normal((3, 4000))
    )

    before = estimate(poses, np.zeros(4000))
    after = estimate(resample(poses, np.full(4000, 1 / 4000), 0.25, random), np.zeros(4000))

    assert after.mean == pytest.approx(before.mean, abs=0.02)
    assert np.sqrt(np.diag(after.covariance)) == pytest.approx(
        np.sqrt(np.diag(before.covariance)), rel=0.05
    )


def test_headings_are_averaged_across_the_turn() -> None:
    poses = np.array([[0.0, 0.0], [0.0, 0.0], [math.pi - 0.1, -math.pi + 0.1]])

    assert abs(estimate(poses, np.zeros(2)).mean[2]) == pytest.approx(math.pi)


@settings(max_examples=25)
@given(st.floats(-1.5, 1.5), st.floats(0.03, 0.3), st.integers(0, 1000))
def test_narrowing_finds_the_posterior_that_few_samples_lie_in(
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


def test_weights_of_vanishing_likelihood_are_still_weights() -> None:
    assert normalized(np.array([-1e5, -1e5 - 1.0])).sum() == pytest.approx(1.0)
