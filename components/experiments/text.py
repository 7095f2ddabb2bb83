"""Figures as text: tables of fixed columns, intervals, metres."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from components.experiments.statistics import Mean, Rate, Spread


def table(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """The lines of a table; the first column is flush left, the others flush right."""
    widths = [max(map(len, column)) for column in zip(titles, *rows, strict=True)]
    for row in (titles, *rows):
        cells = [
            cell.ljust(width) if first else cell.rjust(width)
            for cell, width, first in zip(row, widths, (True, *(False,) * len(row)), strict=False)
        ]
        yield "  ".join(cells).rstrip()


def rate(value: Rate, per: int = 1) -> str:
    """A rate with its interval; `per` 1000 as so many of a thousand."""
    if value.rate is None or value.low is None or value.high is None:
        return "-"
    digits = 2 if per == 1 else 1 if per * value.high >= 10 else 2
    low, middle, high = (f"{per * one:.{digits}f}" for one in (value.low, value.rate, value.high))
    return f"{middle} [{low}, {high}]"


def mean(value: Mean, digits: int = 3) -> str:
    """A mean with its interval."""
    if value.mean is None:
        return "-"
    return f"{value.mean:.{digits}f} [{value.low:.{digits}f}, {value.high:.{digits}f}]"


def spread(value: Spread, digits: int = 0) -> str:
    """Median and 90th percentile."""
    if value.median is None:
        return "-"
    return f"{value.median:.{digits}f} / {value.p90:.{digits}f}"
