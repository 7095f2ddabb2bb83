"""Rates and means with their intervals."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.tools.experiments.statistics import (
    LEAST_CASES,
    mean_of,
    near_of,
    rate_of,
    ratio_of,
    root_mean_square_of,
    spread_of,
)


def test_the_interval_of_a_rate_is_wilsons() -> None:
    # Newcombe (1998), Statistics in Medicine 17, table I, method 3.
    for count, of, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ):
        rate = rate_of(count, of)
        assert rate.low == pytest.approx(low, abs=5e-5)
        assert rate.high == pytest.approx(high, abs=5e-5)


@given(st.integers(1, 10_000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_a_rate_lies_in_its_interval_and_that_in_0_to_1(case: tuple[int, int]) -> None:
    rate = rate_of(*case)

    assert rate.rate is not None
    assert rate.low is not None
    assert rate.high is not None
    assert 0.0 <= rate.low <= rate.rate <= rate.high <= 1.0
    assert rate.high > rate.low


def test_of_too_few_cases_all_and_none_cannot_be_told_apart() -> None:
    def told_apart(cases: int) -> bool:
        none, every = rate_of(0, cases).high, rate_of(cases, cases).low
        assert none is not None
        assert every is not None
        return none < every

    assert told_apart(LEAST_CASES)
    assert not told_apart(LEAST_CASES - 1)


def test_of_no_case_there_is_no_rate() -> None:
    assert rate_of(0, 0).rate is None


def test_means_leave_out_runs_that_have_none() -> None:
    mean = mean_of([1.0, math.nan, 3.0])

    assert (mean.runs, mean.mean) == (2, 2.0)
    assert mean_of([math.nan]).mean is None


def test_the_interval_of_a_mean_holds_it_about_as_often_as_it_says() -> None:
    random = np.random.default_rng(1)
    held = 0
    for _ in range(200):
        mean = mean_of(random.normal(5.0, 2.0, 30))
        assert mean.low is not None
        assert mean.high is not None
        held += mean.low <= 5.0 <= mean.high
    assert 0.88 <= held / 200 <= 0.99


def test_a_root_mean_square_is_that_of_all_runs() -> None:
    assert root_mean_square_of([3.0, 4.0]).mean == pytest.approx(math.sqrt(12.5))


def test_a_ratio_is_taken_run_by_run() -> None:
    """Runs differ more among each other than by what is compared; that is not held against it."""
    reference = np.array([1.0, 5.0, 20.0, 100.0])

    ratio = ratio_of(1.1 * reference, reference)

    assert ratio.mean == pytest.approx(1.1)
    assert ratio.low == pytest.approx(1.1)
    assert ratio.high == pytest.approx(1.1)
    assert ratio_of(reference, np.zeros(4)).mean is None


def test_a_single_run_has_no_interval() -> None:
    one = np.array([math.nan, 3.0])
    for mean in (mean_of(one), root_mean_square_of(one), ratio_of(one, np.array([2.0, 3.0]))):
        assert mean.runs == 1
        assert mean.mean is not None
        assert mean.low is None
        assert mean.high is None


def test_runs_near_their_reference_are_counted() -> None:
    reference = np.array([1.0, 1.0, 1.0, 10.0, 1.0])

    near = near_of(np.array([1.09, 0.91, 1.11, 10.9, math.nan]), reference, 0.1)

    assert (near.count, near.of) == (3, 4)


def test_half_and_nine_tenths_of_the_cases() -> None:
    spread = spread_of([float(value) for value in range(1, 12)])

    assert (spread.cases, spread.median, spread.p90) == (11, 6.0, 10.0)
    assert spread_of([]).median is None


def test_a_single_case_has_no_nine_tenths() -> None:
    assert (spread_of([3.0]).median, spread_of([3.0]).p90) == (3.0, None)
