"""Figures as text: tables of fixed columns, intervals, and what so few runs cannot tell."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cairn.tools.experiments.statistics import ENOUGH_RUNS, LEAST_CASES, Mean, Rate, Spread


def table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """The lines of a table; the first column is flush left, the others flush right."""
    widths = [max(map(len, column)) for column in zip(titles, *rows, strict=True)]
    for row in (titles, *rows):
        cells = [
            cell.ljust(width) if first else cell.rjust(width)
            for cell, width, first in zip(row, widths, (True, *(False,) * len(row)), strict=False)
        ]
        yield "  ".join(cells).rstrip()


def count(number: int, what: str) -> str:
    """So many of something: 1 run, 2 runs."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def enumerated(parts: Sequence[str]) -> str:
    """a, b and c."""
    *first, last = parts
    return f"{', '.join(first)} and {last}" if first else last


def rate(value: Rate, per: int = 1) -> str:
    """A rate with its interval; `per` 1000 as so many of a thousand; "-" of no case."""
    if value.rate is None or value.low is None or value.high is None:
        return "-"
    digits = 2 if per == 1 else 1 if per * value.high >= 10 else 2
    low, middle, high = (f"{per * one:.{digits}f}" for one in (value.low, value.rate, value.high))
    return f"{middle} [{low}, {high}]"


def rate_of_cases(value: Rate) -> str:
    """A rate with its interval and of how many cases it is; "-" of none."""
    return rate(value) if value.of == 0 else f"{rate(value)} of {value.of}"


def count_of_cases(value: Rate) -> str:
    """In how many of how many cases it was so; "-" of none."""
    return "-" if value.of == 0 else f"{value.count} of {value.of}"


def mean(value: Mean, digits: int = 3) -> str:
    """A mean with its interval, which that of a single run has not; "-" of none."""
    if value.mean is None:
        return "-"
    return f"{value.mean:.{digits}f}{_interval(value, f'.{digits}f')}"


def change(ratio: Mean) -> str:
    """How much more or less than its reference something is, with its interval; "-" of no run."""
    if ratio.mean is None:
        return "-"
    low, middle, high = (
        None if one is None else 100 * (one - 1) for one in (ratio.low, ratio.mean, ratio.high)
    )
    percent = Mean(runs=ratio.runs, mean=middle, low=low, high=high)
    return f"{percent.mean:+z.1f} %{_interval(percent, '+z.1f')}"


def spread(value: Spread, digits: int = 0, unit: str = "") -> str:
    """Median and 90th percentile, which that of a single case has not; "-" of none."""
    if value.median is None:
        return "-"
    p90 = "-" if value.p90 is None else f"{value.p90:.{digits}f}"
    return f"{value.median:.{digits}f} / {p90}{unit and f' {unit}'}"


def few(runs: int, what: str = "run") -> Iterator[str]:
    """That so few runs cannot tell how often, or how much, something is; nothing of enough."""
    if runs < LEAST_CASES:
        yield (
            f"{count(runs, what)} cannot tell what is so in general and what is chance: at least "
            f"{LEAST_CASES} are needed"
        )


def of_means(runs: int, what: str = "run") -> str:
    """What the intervals of means are, and what they are worth of so few runs."""
    if runs == 1:
        return f"of means none: there is 1 {what} only"
    told = f"of means by resampling the {count(runs, what)}"
    if runs < ENOUGH_RUNS:
        told += f", which of fewer than {ENOUGH_RUNS} are too narrow"
    return told


def _interval(value: Mean, form: str) -> str:
    if value.low is None or value.high is None:
        return ""
    return f" [{value.low:{form}}, {value.high:{form}}]"
