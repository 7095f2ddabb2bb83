"""The report of an evaluation: as text, as pictures and as a JSON file."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from json import dumps
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from cairn.planar.grid import FREE_TO, OCCUPIED_FROM, OccupancyCells
from cairn_lab.evaluation.results import GoalResult, RunResult, Summary

# Steps of the ground truth longer than this [m] were not driven: the robot was kidnapped.
_KIDNAPPED_M = 0.5


def write_report(
    folder: Path, grid: OccupancyCells, runs: Sequence[RunResult], summary: Summary
) -> None:
    """Write `tracks.png`, `paths.png` and `runs.json`; raises `OSError`."""
    draw_tracks(grid, runs, folder / "tracks.png")
    draw_paths(runs, folder / "paths.png")
    about = {
        model.__name__: {
            name: field.description
            for name, field in model.model_fields.items()
            if field.description
        }
        for model in (Summary, RunResult, GoalResult)
    }
    body = ",\n".join(run.model_dump_json() for run in runs)
    text = (
        f'{{"summary": {summary.model_dump_json()},\n"about": {dumps(about)},\n'
        f'"runs": [\n{body}\n]}}\n'
    )
    (folder / "runs.json").write_text(text, encoding="utf-8")


def report_lines(world: str, runs: Sequence[RunResult], summary: Summary) -> Iterator[str]:
    """Yield the failures run by run, then the figures of all runs."""
    for run in runs:
        yield from _failures(run)
    yield f"{world}: {summary.runs} runs"
    if summary.failed:
        yield f"  failed            {summary.failed} of {summary.runs} runs"
    yield f"  reached           {summary.reached} of {summary.goals}, {summary.reached_share:.1%}"
    yield from _events(summary)
    if summary.kidnapped:
        yield from _kidnappings(summary)
    yield f"  collisions        {summary.collisions}"
    if summary.path_ratio_mean is not None:
        yield (
            f"  path / shortest   {summary.path_ratio_mean:.3f} mean, "
            f"{summary.path_ratio_p95:.3f} 95th percentile"
        )
    if summary.seconds_mean is not None:
        yield f"  time per goal     {summary.seconds_mean:.1f} s"
    yield f"  recoveries        {summary.recoveries}"
    yield f"  unsure of pose    {summary.unsure_s:.1f} s in all"
    yield f"  wrong, but sure   {summary.misled_s:.1f} s at most"
    if summary.end_error_median is not None:
        yield (
            f"  error at goal     {summary.end_error_median:.3f} m, "
            f"{summary.end_turn_median:.3f} rad median, {summary.end_error_p95:.3f} m, "
            f"{summary.end_turn_p95:.3f} rad 95th percentile"
        )
    if summary.error_median is not None:
        yield (
            f"  position error    {summary.error_median:.3f} m median, "
            f"{summary.error_p95:.3f} m 95th percentile"
        )
    if summary.within is not None:
        one, two, three = summary.within
        yield f"  truth within      {one:.0%}, {two:.0%}, {three:.0%} in 1, 2, 3 sigma"
    if summary.kidnapped and summary.error_median is not None:
        yield "                    (both without the time from kidnapping to relocalization)"


def _failures(run: RunResult) -> Iterator[str]:
    if run.failure:
        yield f"seed {run.seed} failed: {run.failure}"
    for number, goal in enumerate(run.goals, start=1):
        if not goal.reached:
            yield (
                f"seed {run.seed}, goal {number} at ({goal.x:.2f}, {goal.y:.2f}) not reached: "
                f"{goal.reason}"
            )
    for collision in run.collisions:
        yield f"seed {run.seed}, collision: {collision}"


def _events(summary: Summary) -> Iterator[str]:
    """Yield which events of the world came due after the end of a run, and so were not tested."""
    runs = summary.runs - summary.failed
    missed = {event: count for event, count in summary.events.items() if count < runs}
    if not missed:
        return
    every = "every valid run" if summary.failed else "every run"
    parts = [f"{len(summary.events) - len(missed)} of {len(summary.events)} came due in {every}"]
    parts += [
        f'"{event}" in {f"{count} of {runs}" if count else "none"}'
        for event, count in missed.items()
    ]
    yield f"  events            {'; '.join(parts)}"


def _kidnappings(summary: Summary) -> Iterator[str]:
    yield f"  kidnapped         reached {summary.kidnapped_reached} of {summary.kidnapped}"
    found = f"  relocalized       {summary.relocalized} of {summary.kidnapped}"
    if summary.relocalized_median_s is not None:
        found += (
            f", {summary.relocalized_median_s:.1f} s median, "
            f"{summary.relocalized_worst_s:.1f} s maximum"
        )
    yield found


def draw_tracks(grid: OccupancyCells, runs: Sequence[RunResult], file: Path) -> None:
    """Draw the map with the true paths of all runs and their goals, failed ones as crosses."""
    width, height = grid.size_m
    figure = Figure(figsize=(8.0, max(2.5, 8.0 * height / width)), layout="constrained")
    axes = figure.add_subplot()
    x, y, _ = grid.frame.origin
    extent = (x, x + width, y, y + height)
    axes.imshow(_gray_levels(grid), cmap="gray", vmin=0, vmax=255, origin="lower", extent=extent)
    for run in runs:
        track = _split_at_kidnappings(np.array(run.track).reshape(-1, 2))
        axes.plot(track[:, 0], track[:, 1], color="tab:blue", linewidth=0.6, alpha=0.5)
    goals = [goal for run in runs for goal in run.goals]
    for reached, marker, color in ((True, "o", "tab:green"), (False, "x", "tab:red")):
        points = [(goal.x, goal.y) for goal in goals if goal.reached is reached]
        if points:
            xs, ys = zip(*points, strict=True)
            label = f"{len(points)} goals {'reached' if reached else 'not reached'}"
            axes.scatter(xs, ys, s=18, marker=marker, color=color, label=label, zorder=3)
    axes.set_title("true paths, interrupted where the robot was kidnapped", fontsize="medium")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    if goals:
        figure.legend(loc="outside upper center", ncols=2, frameon=False)
    figure.savefig(file, dpi=110)


def draw_paths(runs: Sequence[RunResult], file: Path) -> None:
    """Draw driven length over shortest length, and the localization error of each run."""
    figure = Figure(figsize=(8.0, 3.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    plain = [g for run in runs for g in run.goals if g.reached and not g.kidnapped]
    left.scatter([g.shortest for g in plain], [g.driven for g in plain], s=10, color="tab:blue")
    longest = max((g.shortest for g in plain), default=1.0)
    left.plot([0, longest], [0, longest], color="gray", linewidth=0.8, label="shortest possible")
    left.plot([0, longest], [0, 1.25 * longest], color="gray", linestyle=":", label="1.25 times")
    left.set_xlabel("shortest path [m]")
    left.set_ylabel("driven path [m]")
    left.legend(frameon=False)
    seeds = [run.seed for run in runs]
    for key, label, color in (
        ("error_median", "median", "tab:blue"),
        ("error_p95", "95th percentile", "tab:orange"),
    ):
        # A run without poses has no error: NaN is not drawn.
        values = [math.nan if (error := getattr(run, key)) is None else error for run in runs]
        right.plot(seeds, values, "o", markersize=4, color=color, label=label)
    right.set_xlabel("seed")
    right.xaxis.set_major_locator(MaxNLocator(integer=True))
    right.set_ylabel("position error while localized [m]")
    right.set_ylim(bottom=0.0)
    right.legend(frameon=False)
    figure.savefig(file, dpi=110)


def _split_at_kidnappings(track: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the track with NaN wherever the robot did not drive, so that no line is drawn."""
    kidnapped = np.flatnonzero(np.hypot(*np.diff(track, axis=0).T) > _KIDNAPPED_M) + 1
    return np.insert(track, kidnapped, math.nan, axis=0)


def _gray_levels(grid: OccupancyCells) -> NDArray[np.uint8]:
    """Return the map as an image: white free, black occupied, gray unknown; row 0 at the bottom."""
    image = np.full(grid.values.shape, 200, np.uint8)
    image[(grid.values >= 0) & (grid.values <= FREE_TO)] = 255
    image[grid.values >= OCCUPIED_FROM] = 0
    return image
