"""Figures as a reader sees them."""

from __future__ import annotations

import numpy as np
import pytest

from cairn.tools.experiments import text
from cairn.tools.experiments.statistics import mean_of, rate_of, ratio_of, spread_of


def test_a_single_run_is_shown_without_an_interval() -> None:
    assert text.mean(mean_of([0.25])) == "0.250"
    assert text.change(ratio_of(np.array([1.2]), np.array([1.0]))) == "+20.0 %"
    assert text.spread(spread_of([6.0]), 1, "s") == "6.0 / - s"


def test_what_has_no_case_is_shown_as_such() -> None:
    assert text.rate_of_cases(rate_of(0, 0)) == "-"
    assert text.count_of_cases(rate_of(0, 0)) == "-"
    assert text.mean(mean_of([])) == "-"
    assert text.change(mean_of([])) == "-"
    assert text.spread(spread_of([]), 3, "m") == "-"


def test_intervals_are_in_brackets() -> None:
    assert text.mean(mean_of([1.0, 1.0])) == "1.000 [1.000, 1.000]"
    assert text.change(mean_of([0.9, 0.9])) == "-10.0 % [-10.0, -10.0]"
    assert text.rate_of_cases(rate_of(15, 148)) == "0.10 [0.06, 0.16] of 148"
    assert text.spread(spread_of([1.0, 2.0]), 1) == "1.5 / 1.9"


@pytest.mark.parametrize(
    ("ways", "told"),
    [
        (1, "of means none: there is 1 way only"),
        (5, "of means by resampling the 5 ways, which of fewer than 10 are too narrow"),
        (30, "of means by resampling the 30 ways"),
    ],
)
def test_what_intervals_of_means_are_worth_is_told(ways: int, told: str) -> None:
    assert text.of_means(ways, "way") == told


def test_too_few_runs_are_told_of() -> None:
    assert next(text.few(3)).startswith("3 runs cannot tell")
    assert not list(text.few(4))
