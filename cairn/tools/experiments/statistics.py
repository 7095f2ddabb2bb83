"""Rates, means and percentiles of many runs, and how sure they are."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

Z95 = 1.959964
LEAST_CASES = math.floor(Z95**2) + 1
"""Of fewer cases no rate tells anything: even the intervals of none and of all of them overlap."""
ENOUGH_RUNS = 10
"""Of fewer runs intervals by resampling are too narrow: of 5 they hold the mean in 4 of 5 cases."""
_RESAMPLES = 2000


class Rate(BaseModel):
    """A share of cases, with its 95 % interval after Wilson (1927)."""

    model_config = ConfigDict(extra="forbid")

    count: int = Field(description="Cases in which it was so.")
    of: int = Field(description="All cases.")
    rate: float | None = Field(description="The share; null if there is no case.")
    low: float | None = Field(description="Lower end of the interval.")
    high: float | None = Field(description="Upper end of the interval.")


class Mean(BaseModel):
    """A mean over runs, with its 95 % interval by resampling the runs (bootstrap)."""

    model_config = ConfigDict(extra="forbid")

    runs: int = Field(description="How many runs it is of.")
    mean: float | None = Field(description="The mean; null without runs.")
    low: float | None = Field(
        description="Lower end of the interval; null of a single run, which has none."
    )
    high: float | None = Field(description="Upper end of the interval; null as the lower.")


class Spread(BaseModel):
    """What half and what nine tenths of the cases do not exceed."""

    model_config = ConfigDict(extra="forbid")

    cases: int = Field(description="How many cases it is of.")
    median: float | None = Field(description="The median; null without cases.")
    p90: float | None = Field(description="The 90th percentile; null of a single case.")


def rate_of(count: int, of: int) -> Rate:
    """A rate and its Wilson interval, which is sound for 0 and for all of few cases, too."""
    if of == 0:
        return Rate(count=0, of=0, rate=None, low=None, high=None)
    share, z2 = count / of, Z95**2
    middle = (share + z2 / (2 * of)) / (1 + z2 / of)
    half = Z95 / (1 + z2 / of) * math.sqrt(share * (1 - share) / of + z2 / (4 * of**2))
    low, high = max(0.0, middle - half), min(1.0, middle + half)
    # At the ends the interval reaches them; rounding may leave a trace beside.
    return Rate(
        count=count,
        of=of,
        rate=share,
        low=0.0 if count == 0 else low,
        high=1.0 if count == of else high,
    )


def mean_of(values: Sequence[float] | NDArray[np.float64]) -> Mean:
    """The mean of one value for each run, NaN left out."""
    known = np.array([value for value in values if math.isfinite(value)], np.float64)
    if known.size == 0:
        return Mean(runs=0, mean=None, low=None, high=None)
    low, high = _interval(known[_choices(known.size)].mean(axis=1))
    return Mean(runs=known.size, mean=float(known.mean()), low=low, high=high)


def root_mean_square_of(values: Sequence[float] | NDArray[np.float64]) -> Mean:
    """The root of the mean square of one root mean square for each run, NaN left out."""
    squares = mean_of(np.square(np.asarray(values, np.float64)))
    low, mean, high = (
        None if one is None else math.sqrt(one) for one in (squares.low, squares.mean, squares.high)
    )
    return Mean(runs=squares.runs, mean=mean, low=low, high=high)


def ratio_of(values: NDArray[np.float64], reference: NDArray[np.float64]) -> Mean:
    """The mean of one value for each run over that of a reference for the same runs.

    Runs are resampled with both of their values; those in which one is NaN are left out.
    """
    known = np.isfinite(values) & np.isfinite(reference)
    if not known.any() or not reference[known].mean() > 0:
        return Mean(runs=0, mean=None, low=None, high=None)
    chosen = _choices(int(known.sum()))
    ratios = values[known][chosen].mean(axis=1) / reference[known][chosen].mean(axis=1)
    low, high = _interval(ratios)
    ratio = values[known].mean() / reference[known].mean()
    return Mean(runs=int(known.sum()), mean=float(ratio), low=low, high=high)


def near_of(values: NDArray[np.float64], reference: NDArray[np.float64], share: float) -> Rate:
    """In how many runs a value is off its reference by no more than that share of it.

    Runs in which one of them is NaN are left out.
    """
    known = np.isfinite(values) & np.isfinite(reference)
    near = np.abs(values[known] - reference[known]) <= share * reference[known]
    return rate_of(int(near.sum()), int(known.sum()))


def spread_of(values: Sequence[float]) -> Spread:
    """Median and 90th percentile."""
    if not values:
        return Spread(cases=0, median=None, p90=None)
    median, p90 = np.percentile(np.array(values, np.float64), [50, 90])
    return Spread(
        cases=len(values), median=float(median), p90=float(p90) if len(values) > 1 else None
    )


def _choices(runs: int) -> NDArray[np.int64]:
    """Which runs each resample is of (resamples, runs); none of a single run."""
    # A generator of its own: the same runs give the same interval.
    resamples = _RESAMPLES if runs > 1 else 0
    return np.random.default_rng(0).integers(runs, size=(resamples, runs))


def _interval(resampled: NDArray[np.float64]) -> tuple[float | None, float | None]:
    if resampled.size == 0:
        return None, None
    low, high = np.percentile(resampled, [2.5, 97.5])
    return float(low), float(high)
