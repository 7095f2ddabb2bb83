"""Rates, means and percentiles of many runs, with their confidence intervals, and as text."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

LEAST_CASES = 4
"""Fewer cases show nothing: even the Wilson intervals of 0 of 3 and of 3 of 3 overlap."""
ENOUGH_RUNS = 10
"""Bootstrap intervals of fewer runs are too narrow: those of 5 contain the mean in 4 of 5 cases."""
_RESAMPLES = 2000


class Rate(BaseModel):
    """A share of cases, with its 95 % interval by Wilson (1927)."""

    model_config = ConfigDict(extra="forbid")

    count: int = Field(description="Cases in which it is true.")
    of: int = Field(description="All cases.")
    rate: float | None = Field(description="The share; null without cases.")
    low: float | None = Field(description="Lower end of the interval.")
    high: float | None = Field(description="Upper end of the interval.")


class Mean(BaseModel):
    """A mean over runs, with its 95 % interval by resampling the runs (bootstrap)."""

    model_config = ConfigDict(extra="forbid")

    runs: int = Field(description="Number of runs.")
    mean: float | None = Field(description="The mean; null without runs.")
    low: float | None = Field(
        description="Lower end of the interval; null for a single run, which has none."
    )
    high: float | None = Field(description="Upper end of the interval; null like the lower end.")


class Percentiles(BaseModel):
    """The median and the 90th percentile of the cases."""

    model_config = ConfigDict(extra="forbid")

    cases: int = Field(description="Number of cases.")
    median: float | None = Field(description="The median; null without cases.")
    p90: float | None = Field(description="The 90th percentile; null for a single case.")


def wilson_rate(count: int, of: int) -> Rate:
    """Return a rate with its Wilson interval, which is also sound for rates of 0 and 1."""
    from scipy.stats import binomtest  # takes 0.5 s: only when a report is written

    if of == 0:
        return Rate(count=0, of=0, rate=None, low=None, high=None)
    interval = binomtest(count, of).proportion_ci(method="wilson")
    return Rate(
        count=count, of=of, rate=count / of, low=float(interval.low), high=float(interval.high)
    )


def bootstrap_mean(values: Sequence[float] | NDArray[np.float64]) -> Mean:
    """Return the mean of one value per run; NaN values are left out."""
    known = np.array([value for value in values if math.isfinite(value)], np.float64)
    if known.size == 0:
        return Mean(runs=0, mean=None, low=None, high=None)
    low, high = _bootstrap_interval([known], np.mean)
    return Mean(runs=known.size, mean=float(known.mean()), low=low, high=high)


def bootstrap_rms(values: Sequence[float] | NDArray[np.float64]) -> Mean:
    """Return the root mean square over all runs of one root mean square per run, without NaN."""
    squares = bootstrap_mean(np.square(np.asarray(values, np.float64)))
    low, mean, high = (
        None if one is None else math.sqrt(one) for one in (squares.low, squares.mean, squares.high)
    )
    return Mean(runs=squares.runs, mean=mean, low=low, high=high)


def bootstrap_ratio(values: NDArray[np.float64], reference: NDArray[np.float64]) -> Mean:
    """Return the mean of one value per run divided by the mean of a reference of the same runs.

    Runs are resampled with both of their values; runs in which one of them is NaN are left out.
    """
    known = np.isfinite(values) & np.isfinite(reference)
    if not known.any() or not reference[known].mean() > 0:
        return Mean(runs=0, mean=None, low=None, high=None)
    values, reference = values[known], reference[known]
    ratio = float(_ratio_of_means(values, reference))
    low, high = _bootstrap_interval([values, reference], _ratio_of_means)
    return Mean(runs=values.size, mean=ratio, low=low, high=high)


def rate_within(values: NDArray[np.float64], reference: NDArray[np.float64], share: float) -> Rate:
    """Return the rate of runs whose value differs from its reference by at most `share` of it.

    Runs in which one of them is NaN are left out.
    """
    known = np.isfinite(values) & np.isfinite(reference)
    near = np.abs(values[known] - reference[known]) <= share * reference[known]
    return wilson_rate(int(near.sum()), int(known.sum()))


def percentiles(values: Sequence[float]) -> Percentiles:
    """Return median and 90th percentile."""
    if not values:
        return Percentiles(cases=0, median=None, p90=None)
    median, p90 = np.percentile(np.array(values, np.float64), [50, 90])
    return Percentiles(
        cases=len(values), median=float(median), p90=float(p90) if len(values) > 1 else None
    )


def _ratio_of_means(
    values: NDArray[np.float64], reference: NDArray[np.float64], axis: int = -1
) -> NDArray[np.float64]:
    return np.asarray(values.mean(axis=axis) / reference.mean(axis=axis), np.float64)


def _bootstrap_interval(
    samples: Sequence[NDArray[np.float64]], statistic: Callable[..., object]
) -> tuple[float | None, float | None]:
    """Return the 95 % interval of a statistic of paired samples (runs,); none of a single run."""
    from scipy.stats import bootstrap  # takes 0.5 s: only when a report is written

    if samples[0].size < 2:
        return None, None
    found = bootstrap(
        samples,
        statistic,
        n_resamples=_RESAMPLES,
        paired=True,
        vectorized=True,
        method="percentile",
        rng=np.random.default_rng(0),  # the same runs give the same interval
    )
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def format_table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a table; the first column is flush left, the others flush right.

    Not by rich, which needs more code than this to keep it from wrapping lines at the width of the
    terminal and from reading intervals such as [0.1, 0.2] as markup.
    """
    widths = [max(map(len, column)) for column in zip(titles, *rows, strict=True)]
    for first, *others in (titles, *rows):
        cells = [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        yield "  ".join([first.ljust(widths[0]), *cells]).rstrip()


def format_count(number: int, noun: str) -> str:
    """Return a number with its noun: 1 run, 2 runs."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def join_names(names: Sequence[str]) -> str:
    """Return "a, b and c"."""
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last


def format_rate(value: Rate, per: int = 1) -> str:
    """Return a rate `per` so many cases, with its interval; "-" without cases."""
    if value.rate is None or value.low is None or value.high is None:
        return "-"
    digits = 2 if per == 1 else 1 if per * value.high >= 10 else 2
    low, middle, high = (f"{per * one:.{digits}f}" for one in (value.low, value.rate, value.high))
    return f"{middle} [{low}, {high}]"


def format_rate_of_cases(value: Rate) -> str:
    """Return a rate with its interval and the number of cases; "-" without cases."""
    return format_rate(value) if value.of == 0 else f"{format_rate(value)} of {value.of}"


def format_count_of_cases(value: Rate) -> str:
    """Return the count and the number of cases, such as "3 of 5"; "-" without cases."""
    return "-" if value.of == 0 else f"{value.count} of {value.of}"


def format_mean(value: Mean, digits: int = 3) -> str:
    """Return a mean with its interval, which a single run does not have; "-" without runs."""
    if value.mean is None:
        return "-"
    return f"{value.mean:.{digits}f}{_format_interval(value, f'.{digits}f')}"


def format_change(ratio: Mean) -> str:
    """Return a ratio as a difference in percent, with its interval; "-" without runs."""
    if ratio.mean is None:
        return "-"
    low, middle, high = (
        None if one is None else 100 * (one - 1) for one in (ratio.low, ratio.mean, ratio.high)
    )
    percent = Mean(runs=ratio.runs, mean=middle, low=low, high=high)
    return f"{percent.mean:+z.1f} %{_format_interval(percent, '+z.1f')}"


def format_percentiles(value: Percentiles, digits: int = 0, unit: str = "") -> str:
    """Return "median / 90th percentile", "-" for what the cases do not have."""
    if value.median is None:
        return "-"
    p90 = "-" if value.p90 is None else f"{value.p90:.{digits}f}"
    return f"{value.median:.{digits}f} / {p90}{unit and f' {unit}'}"


def too_few_note(runs: int, noun: str = "run") -> Iterator[str]:
    """Yield a warning if there are too few runs for any conclusion."""
    if runs < LEAST_CASES:
        yield (
            f"{format_count(runs, noun)}: too few to distinguish an effect from chance; at least "
            f"{LEAST_CASES} are needed"
        )


def interval_note(runs: int, noun: str = "run") -> str:
    """Return how the intervals of means were made, and whether they are too narrow."""
    if runs == 1:
        return f"none for means: there is only 1 {noun}"
    note = f"for means by resampling the {format_count(runs, noun)}"
    if runs < ENOUGH_RUNS:
        note += f", too narrow as there are fewer than {ENOUGH_RUNS}"
    return note


def _format_interval(value: Mean, form: str) -> str:
    if value.low is None or value.high is None:
        return ""
    return f" [{value.low:{form}}, {value.high:{form}}]"
