"""Pictures of the experiments: figure 9 of the paper, and how methods compare."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cairn.tools.experiments import text
from cairn.tools.experiments.comparison import MethodSummary
from cairn.tools.experiments.conditions import FUSIONS, QUANTITIES, Condition, Way, together
from cairn.tools.experiments.statistics import Rate

Array = NDArray[np.float64]


def draw_methods(summaries: Sequence[MethodSummary], file: Path) -> None:
    """Recall and false removals of each method, with their 95 % intervals."""
    figure = Figure(figsize=(9.0, 0.8 + 0.45 * len(summaries)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for row, one in enumerate(summaries):
        color = "tab:green" if row == 0 else "tab:blue"
        for axes, value, per in ((left, one.recall, 1), (right, one.false_removals, 1000)):
            _interval(axes, value, per, row, color)
    if not any(one.recall.of for one in summaries):
        left.annotate("none moved and sighted", (0.5, 0.5), xycoords="axes fraction", ha="center")
    left.set_yticks(range(len(summaries)), [one.title for one in summaries])
    left.set_ylim(len(summaries) - 0.5, -0.5)
    left.set_xlim(-0.02, 1.02)
    left.set_xlabel("recall of moved objects [1]")
    right.set_xlim(left=0.0)
    right.set_xlabel("false removals of 1000 sightings [1]")
    for axes in (left, right):
        axes.grid(axis="x", linewidth=0.3)
    figure.savefig(file, dpi=110)


def _interval(axes: Axes, value: Rate, per: int, row: int, color: str) -> None:
    if value.rate is None or value.low is None or value.high is None:
        return
    middle = per * value.rate
    around = [[middle - per * value.low], [per * value.high - middle]]
    axes.errorbar([middle], [row], xerr=around, fmt="o", color=color, capsize=3, markersize=5)


def draw_courses(ways: Sequence[Way], quantities: Sequence[str], file: Path) -> None:
    """Quantities over time for each condition: mean of all ways, and their standard deviation.

    A column for each way of fusing objects.
    """
    size = (7.0 * len(FUSIONS), 3.0 * len(quantities) + 0.4)
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(
        len(quantities), len(FUSIONS), sharex=True, sharey="row", squeeze=False
    )
    figure.suptitle(
        f"mean of {text.count(len(ways), 'way')}, shaded: their standard deviation; vertical line: "
        "an object is moved; dashed: it is registered anew (median)"
    )
    for column, (title, conditions) in zip(panels.T, FUSIONS.items(), strict=True):
        _draw_column(column, ways, quantities, conditions)
        column[0].set_title(title)
        column[-1].set_xlabel("time [s]")
    for row, quantity in zip(panels, quantities, strict=True):
        row[0].set_ylabel(QUANTITIES[quantity])
        row[0].set_ylim(bottom=0.0)  # once all is drawn: it ends the scaling
    panels[0, 0].legend(loc="upper left", frameon=False, fontsize="small")
    figure.savefig(file, dpi=110)


def _draw_column(
    column: Sequence[Axes],
    ways: Sequence[Way],
    quantities: Sequence[str],
    conditions: Sequence[Condition],
) -> None:
    registered = [way.registered_at for way in ways if way.registered_at is not None]
    for axes, quantity in zip(column, quantities, strict=True):
        for condition in conditions:
            stamps, rows = together(ways, condition.name, quantity)
            mean, spread = _mean_and_spread(rows)
            axes.plot(
                stamps,
                mean,
                condition.style,
                color=condition.color,
                linewidth=1.4,
                label=condition.title,
            )
            low, high = np.maximum(mean - spread, 0.0), mean + spread
            axes.fill_between(stamps, low, high, color=condition.color, alpha=0.12, linewidth=0)
        axes.axvline(ways[0].changed_at, color="black", linewidth=0.8)
        if registered:
            axes.axvline(float(np.median(registered)), color="gray", linewidth=0.8, linestyle="--")
        axes.grid(linewidth=0.3)


def _mean_and_spread(rows: Array) -> tuple[Array, Array]:
    """Mean and standard deviation (n,) of the rows (m, n), of those that are known; else NaN."""
    known = np.isfinite(rows)
    count = np.where(known.any(axis=0), known.sum(axis=0), np.nan)
    mean = np.where(known, rows, 0.0).sum(axis=0) / count
    squares = np.where(known, (rows - mean) ** 2, 0.0).sum(axis=0) / count
    return np.asarray(mean, np.float64), np.asarray(np.sqrt(squares), np.float64)
