"""Pictures of an evaluation: where the robot drove, goal by goal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from cairn.planar.grid import FREE_TO, OCCUPIED_FROM, OccupancyCells
from cairn.tools.evaluation.results import RunResult

# Steps of the truth longer than this [m] are not driven.
_CARRIED_M = 0.5


def draw_tracks(grid: OccupancyCells, runs: Sequence[RunResult], file: Path) -> None:
    """The map with the ways of all runs, their goals, and crosses where one was not reached."""
    width, height = grid.size_m
    figure = Figure(figsize=(8.0, max(2.5, 8.0 * height / width)), layout="constrained")
    axes = figure.add_subplot()
    x, y, _ = grid.frame.origin
    extent = (x, x + width, y, y + height)
    axes.imshow(_painted(grid), cmap="gray", vmin=0, vmax=255, origin="lower", extent=extent)
    for run in runs:
        track = _broken_where_carried(np.array(run.track).reshape(-1, 2))
        axes.plot(track[:, 0], track[:, 1], color="tab:blue", linewidth=0.6, alpha=0.5)
    goals = [goal for run in runs for goal in run.goals]
    for reached, marker, color in ((True, "o", "tab:green"), (False, "x", "tab:red")):
        places = [(goal.x, goal.y) for goal in goals if goal.reached is reached]
        if places:
            xs, ys = zip(*places, strict=True)
            label = f"{len(places)} goals {'reached' if reached else 'not reached'}"
            axes.scatter(xs, ys, s=18, marker=marker, color=color, label=label, zorder=3)
    axes.set_title("true ways, broken where the robot was carried off", fontsize="medium")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    if goals:
        figure.legend(loc="outside upper center", ncols=2, frameon=False)
    figure.savefig(file, dpi=110)


def draw_ways(runs: Sequence[RunResult], file: Path) -> None:
    """Length driven over the shortest possible, and the error of localization, for each run."""
    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    plain = [g for run in runs for g in run.goals if g.reached and not g.kidnapped]
    left.scatter([g.shortest for g in plain], [g.driven for g in plain], s=10, color="tab:blue")
    longest = max((g.shortest for g in plain), default=1.0)
    left.plot([0, longest], [0, longest], color="gray", linewidth=0.8, label="shortest possible")
    left.plot([0, longest], [0, 1.25 * longest], color="gray", linestyle=":", label="1.25 times")
    left.set_xlabel("shortest way [m]")
    left.set_ylabel("way driven [m]")
    left.legend(frameon=False)
    seeds = [run.seed for run in runs]
    for key, label, color in (
        ("error_median", "median", "tab:blue"),
        ("error_p95", "95 % of the poses below", "tab:orange"),
    ):
        # A run without poses has no error: NaN is not drawn.
        values = [math.nan if (error := getattr(run, key)) is None else error for run in runs]
        right.plot(seeds, values, "o", markersize=4, color=color, label=label)
    right.set_xlabel("seed")
    right.xaxis.set_major_locator(MaxNLocator(integer=True))
    right.set_ylabel("error of the position, unless lost [m]")
    right.set_ylim(bottom=0.0)
    right.legend(frameon=False)
    figure.savefig(file, dpi=110)


def _broken_where_carried(track: NDArray[np.float64]) -> NDArray[np.float64]:
    """The track with a gap wherever the robot did not drive: lines through walls would mislead."""
    carried = np.flatnonzero(np.hypot(*np.diff(track, axis=0).T) > _CARRIED_M) + 1
    return np.insert(track, carried, math.nan, axis=0)


def _painted(grid: OccupancyCells) -> NDArray[np.uint8]:
    """The map as a picture: white free, black occupied, gray unknown; row 0 at the bottom."""
    picture = np.full(grid.values.shape, 200, np.uint8)
    picture[(grid.values >= 0) & (grid.values <= FREE_TO)] = 255
    picture[grid.values >= OCCUPIED_FROM] = 0
    return picture
