"""Rates, means and percentiles with their intervals, and as text."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn_lab.experiments.statistics import (
    LEAST_CASES,
    bootstrap_mean,
    bootstrap_ratio,
    bootstrap_rms,
    format_change,
    format_count_of_cases,
    format_mean,
    format_percentiles,
    format_rate,
    format_rate_of_cases,
    format_table,
    interval_note,
    percentiles,
    rate_within,
    too_few_note,
    wilson_rate,
)
from tests.wording import assert_words


def test_interval_of_a_rate_is_that_of_wilson() -> None:
    # Newcombe (1998), Statistics in Medicine 17, table I, method 3.
    for count, of, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ):
        rate = wilson_rate(count, of)
        assert rate.low == pytest.approx(low, abs=5e-5)
        assert rate.high == pytest.approx(high, abs=5e-5)


@given(st.integers(1, 10_000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_rate_lies_within_its_interval_and_the_interval_within_0_to_1(
    case: tuple[int, int],
) -> None:
    rate = wilson_rate(*case)

    assert rate.rate is not None
    assert rate.low is not None
    assert rate.high is not None
    assert 0.0 <= rate.low <= rate.rate <= rate.high <= 1.0
    assert rate.high > rate.low


def test_intervals_of_0_and_100_percent_overlap_below_the_minimum_number_of_cases() -> None:
    def are_separate(cases: int) -> bool:
        none, every = wilson_rate(0, cases).high, wilson_rate(cases, cases).low
        assert none is not None
        assert every is not None
        return none < every

    assert are_separate(LEAST_CASES)
    assert not are_separate(LEAST_CASES - 1)


def test_without_cases_there_is_no_rate() -> None:
    assert wilson_rate(0, 0).rate is None


def test_means_leave_out_runs_without_a_value() -> None:
    mean = bootstrap_mean([1.0, math.nan, 3.0])

    assert (mean.runs, mean.mean) == (2, 2.0)
    assert bootstrap_mean([math.nan]).mean is None


def test_same_runs_give_the_same_interval() -> None:
    values = np.random.default_rng(3).normal(5.0, 2.0, 30)

    assert bootstrap_mean(values) == bootstrap_mean(values)


def test_interval_of_a_mean_contains_the_true_mean_about_as_often_as_stated() -> None:
    random = np.random.default_rng(1)
    contained = 0
    for _ in range(200):
        mean = bootstrap_mean(random.normal(5.0, 2.0, 30))
        assert mean.low is not None
        assert mean.high is not None
        contained += mean.low <= 5.0 <= mean.high
    assert 0.88 <= contained / 200 <= 0.99


def test_root_mean_square_is_that_of_all_runs() -> None:
    assert bootstrap_rms([3.0, 4.0]).mean == pytest.approx(math.sqrt(12.5))


def test_ratio_is_resampled_run_by_run() -> None:
    """Runs differ more among each other than by what is compared; that must not count."""
    reference = np.array([1.0, 5.0, 20.0, 100.0])

    ratio = bootstrap_ratio(1.1 * reference, reference)

    assert ratio.mean == pytest.approx(1.1)
    assert ratio.low == pytest.approx(1.1)
    assert ratio.high == pytest.approx(1.1)
    assert bootstrap_ratio(reference, np.zeros(4)).mean is None


def test_single_run_has_no_interval() -> None:
    one = np.array([math.nan, 3.0])
    for mean in (
        bootstrap_mean(one),
        bootstrap_rms(one),
        bootstrap_ratio(one, np.array([2.0, 3.0])),
    ):
        assert mean.runs == 1
        assert mean.mean is not None
        assert mean.low is None
        assert mean.high is None


def test_runs_near_their_reference_are_counted() -> None:
    reference = np.array([1.0, 1.0, 1.0, 10.0, 1.0])

    near = rate_within(np.array([1.09, 0.91, 1.11, 10.9, math.nan]), reference, 0.1)

    assert (near.count, near.of) == (3, 4)


def test_percentiles_are_the_median_and_the_90th() -> None:
    found = percentiles([float(value) for value in range(1, 12)])

    assert (found.cases, found.median, found.p90) == (11, 6.0, 10.0)
    assert percentiles([]).median is None


def test_single_case_has_no_90th_percentile() -> None:
    assert (percentiles([3.0]).median, percentiles([3.0]).p90) == (3.0, None)


def test_table_aligns_its_columns() -> None:
    lines = list(format_table(("name", "x"), [("a", "[1, 2]"), ("longer", "3")]))

    assert lines == ["name         x", "a       [1, 2]", "longer       3"]


def test_single_run_is_shown_without_an_interval() -> None:
    assert format_mean(bootstrap_mean([0.25])) == "0.250"
    assert format_change(bootstrap_ratio(np.array([1.2]), np.array([1.0]))) == "+20.0 %"
    assert format_percentiles(percentiles([6.0]), 1, "s") == "6.0 / - s"


def test_figures_without_cases_are_shown_as_a_dash() -> None:
    assert format_rate(wilson_rate(0, 0)) == "-"
    assert format_rate_of_cases(wilson_rate(0, 0)) == "-"
    assert format_count_of_cases(wilson_rate(0, 0)) == "-"
    assert format_mean(bootstrap_mean([])) == "-"
    assert format_change(bootstrap_mean([])) == "-"
    assert format_percentiles(percentiles([]), 3, "m") == "-"


def test_intervals_are_in_brackets() -> None:
    assert format_mean(bootstrap_mean([1.0, 1.0])) == "1.000 [1.000, 1.000]"
    assert format_change(bootstrap_mean([0.9, 0.9])) == "-10.0 % [-10.0, -10.0]"
    assert format_rate_of_cases(wilson_rate(15, 148)) == "0.10 [0.06, 0.16] of 148"
    assert format_percentiles(percentiles([1.0, 2.0]), 1) == "1.5 / 1.9"


def test_note_on_intervals_depends_on_the_number_of_runs() -> None:
    assert_words(interval_note(1, "seed"), "none", "only 1 seed")
    assert "too narrow" in interval_note(5, "seed")
    assert_words(interval_note(30, "seed"), "resampling", "30 seeds")


def test_too_few_runs_are_reported() -> None:
    assert next(too_few_note(3)).startswith("3 runs: too few")
    assert not list(too_few_note(4))
