"""`cairn experiment map-update`: an object is moved, and the robot repairs its map (figure 10)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from cairn_lab.batch.options import BatchOptions
from cairn_lab.experiments.map_sequence import draw_map_panels, map_panels
from cairn_lab.experiments.methods import (
    MAP_BUILDER,
    OURS,
    PAPER,
    ExperimentSetup,
    Method,
    base_deployment,
    first_event_s,
)
from cairn_lab.experiments.report_folder import ReportFolder, open_report, write_report
from cairn_lab.experiments.results import (
    CORRECT_M,
    ExperimentRunResult,
    MethodResult,
    MoveResult,
)
from cairn_lab.experiments.runs import FinishedRun, RunSpec, check_setup, run_experiment
from cairn_lab.experiments.series import STEP_S, MethodSeries, WorldSeries
from cairn_lab.experiments.statistics import (
    Mean,
    Percentiles,
    Rate,
    bootstrap_mean,
    format_count,
    format_mean,
    format_percentiles,
    format_rate,
    format_table,
    interval_note,
    percentiles,
    too_few_note,
    wilson_rate,
)

METHODS = (OURS, PAPER)
_PANELS, _RELIABILITY = "maps_a_h.png", "reliability.png"


class MapUpdateSummary(BaseModel):
    """All runs of one method."""

    model_config = ConfigDict(extra="forbid")

    method: str
    title: str
    repaired: Rate = Field(
        description="Runs in which every moved object was removed and registered within 0.3 m of "
        "its new position."
    )
    no_false_removal: Rate = Field(description="Runs in which no object was removed that stood.")
    no_false_registration: Rate = Field(
        description="Runs in which no object was registered more than 0.3 m from its position."
    )
    all_correct: Rate = Field(description="Runs in which all three are true.")
    removed_after: Percentiles = Field(description="From the move to the removal [s].")
    registered_after: Percentiles = Field(description="From the move to the registration [s].")
    observations_to_remove: Percentiles
    viewpoints_to_remove: Percentiles
    observations_to_register: Percentiles
    registration_error: Percentiles = Field(
        description="Distance of the registered from the true position [m]."
    )
    map_error: Mean = Field(
        description="Mean distance of the live landmarks from their true positions at the end [m]."
    )


def run_map_update(
    setup: ExperimentSetup, seeds: Sequence[int], out: Path, batch: BatchOptions, *, quiet: bool
) -> tuple[list[str], dict[str, Any], bool]:
    """Run it; return the report's lines, its figures, and whether all runs succeeded."""
    at = first_event_s(setup)
    folder = ReportFolder(out, "map-update", (_PANELS, _RELIABILITY))
    specs = [RunSpec(setup, seed, folder.run(seed), moves=True) for seed in seeds]
    check_setup(setup)
    with open_report(folder):
        runs, failures = run_experiment(specs, folder, batch, at, quiet=quiet)
        results = [run.result for run in runs]
        summaries = [_summarize(method, results) for method in METHODS] if runs else []
        lines = list(_lines(summaries, results, failures))
        body = {
            "seeds": list(seeds),
            "changed_at": at,
            "failures": failures,
            "summary": [one.model_dump(mode="json") for one in summaries],
            "runs": [result.model_dump(mode="json") for result in results],
        }
        pictures = {}
        if runs:
            parameters = base_deployment(setup).member(MAP_BUILDER).spec.parameters
            grid = Path(parameters["grid_file"])
            shown = _shown(runs)
            panels = map_panels(shown.methods[PAPER.name], shown.world)
            pictures = {
                _PANELS: partial(draw_map_panels, panels, shown.world, grid),
                _RELIABILITY: partial(
                    _draw_reliability, [(run.methods[OURS.name], run.world) for run in runs]
                ),
            }
        models = (MapUpdateSummary, Rate, Mean, Percentiles)
        results_models = (ExperimentRunResult, MethodResult, MoveResult)
        write_report(folder, lines, body, (*models, *results_models), pictures)
    return lines, {key: body[key] for key in ("failures", "summary")}, not failures


def _shown(runs: Sequence[FinishedRun]) -> FinishedRun:
    """Return the run whose maps are drawn: the first in which the paper's rule repaired the map."""
    for run in runs:
        paper = next(one for one in run.result.methods if one.method == PAPER.name)
        if _is_repaired(paper):
            return run
    return runs[0]


def _is_repaired(result: MethodResult) -> bool:
    return all(
        move.removed_at is not None
        and move.registration_error is not None
        and move.registration_error <= CORRECT_M
        for move in result.moves
    )


def _summarize(method: Method, runs: Sequence[ExperimentRunResult]) -> MapUpdateSummary:
    results = [one for run in runs for one in run.methods if one.method == method.name]
    moves = [move for result in results for move in result.moves]
    removed = [move for move in moves if move.removed_at is not None]
    registered = [move for move in moves if move.registered_at is not None]

    def share(true: Sequence[bool]) -> Rate:
        return wilson_rate(sum(true), len(true))

    repaired = [_is_repaired(result) for result in results]
    kept = [not result.false_removals for result in results]
    correct = [not result.false_registrations for result in results]
    return MapUpdateSummary(
        method=method.name,
        title=method.title,
        repaired=share(repaired),
        no_false_removal=share(kept),
        no_false_registration=share(correct),
        all_correct=share([all(three) for three in zip(repaired, kept, correct, strict=True)]),
        removed_after=percentiles([(m.removed_at or 0.0) - m.moved_at for m in removed]),
        registered_after=percentiles([(m.registered_at or 0.0) - m.moved_at for m in registered]),
        observations_to_remove=percentiles([m.observations_to_remove or 0 for m in removed]),
        viewpoints_to_remove=percentiles([m.viewpoints_to_remove or 0 for m in removed]),
        observations_to_register=percentiles([m.observations_to_register or 0 for m in registered]),
        registration_error=percentiles([m.registration_error or 0.0 for m in registered]),
        map_error=bootstrap_mean([one.map_error for one in results if one.map_error is not None]),
    )


def _lines(
    summaries: Sequence[MapUpdateSummary],
    runs: Sequence[ExperimentRunResult],
    failures: Mapping[str, str],
) -> Iterator[str]:
    yield f"map update: {format_count(len(runs), 'run')}"
    for name, failure in failures.items():
        yield f"{name} failed: {failure}"
    if not runs:
        return
    yield from too_few_note(len(runs))
    yield f"{OURS.title}, run by run:"
    yield from format_table(
        (
            "seed",
            "removed at [s]",
            "registered at [s]",
            "error [m]",
            "observations to remove",
            "to register",
            "false removals",
            "false registrations",
            "map error [m]",
        ),
        [row for run in runs for row in _rows(run)],
    )
    yield ""
    yield from format_table(
        (
            "method",
            "repaired",
            "no false removal",
            "no false registration",
            "all correct",
            "map error [m]",
        ),
        [
            (
                one.title,
                format_rate(one.repaired),
                format_rate(one.no_false_removal),
                format_rate(one.no_false_registration),
                format_rate(one.all_correct),
                format_mean(one.map_error),
            )
            for one in summaries
        ],
    )
    yield f"  in brackets: 95 % intervals, for rates by Wilson, {interval_note(len(runs))}"
    yield ""
    yield from format_table(
        (
            "median / 90 %",
            "removed",
            "registered",
            "observations",
            "viewpoints",
            "to register",
            "error",
        ),
        [
            (
                one.title,
                format_percentiles(one.removed_after, 1, "s"),
                format_percentiles(one.registered_after, 1, "s"),
                format_percentiles(one.observations_to_remove),
                format_percentiles(one.viewpoints_to_remove),
                format_percentiles(one.observations_to_register),
                format_percentiles(one.registration_error, 3, "m"),
            )
            for one in summaries
        ],
    )
    yield ""
    yield "observations of each object before and after the change, the fewest of all runs:"
    yield "  " + ", ".join(_coverage(runs))


def _rows(run: ExperimentRunResult) -> Iterator[tuple[str, ...]]:
    ours = next(one for one in run.methods if one.method == OURS.name)
    for move in ours.moves:
        yield (
            str(run.seed),
            _format(move.removed_at, 1),
            _format(move.registered_at, 1),
            _format(move.registration_error, 3),
            _format(move.observations_to_remove, 0),
            _format(move.observations_to_register, 0),
            str(len(ours.false_removals)),
            str(len(ours.false_registrations)),
            _format(ours.map_error, 3),
        )


def _coverage(runs: Sequence[ExperimentRunResult]) -> Iterator[str]:
    for key in sorted({key for run in runs for key in run.coverage}):
        before, after = (min(run.coverage.get(key, (0, 0))[i] for run in runs) for i in (0, 1))
        yield f"{key}: {before}, {after}"


def _format(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _draw_reliability(runs: Sequence[tuple[MethodSeries, WorldSeries]], file: Path) -> None:
    """Draw reliability over time: of the moved objects, and of the others, mean of all runs."""
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    axes = figure.subplots()
    end = min(float(world.stamps[-1]) for _, world in runs)
    stamps = np.arange(0.0, end, STEP_S)
    groups: dict[bool, list[NDArray[np.float64]]] = {True: [], False: []}
    for series, world in runs:
        moved = {move.object_id for move in world.moves}
        for key in series.map_at(math.inf):
            groups[key in moved].append(_reliability(series, key, stamps))
    for is_moved, label, color in (
        (False, "objects that stay", "tab:green"),
        (True, "objects that are moved", "tab:red"),
    ):
        if not groups[is_moved]:
            continue
        rows = np.array(groups[is_moved])
        low, high = np.percentile(rows, [5, 95], axis=0)
        axes.plot(stamps, rows.mean(axis=0), color=color, label=f"{label}: mean, 5 to 95 %")
        axes.fill_between(stamps, low, high, color=color, alpha=0.15, linewidth=0)
    for stamp in {move.stamp for _, world in runs for move in world.moves}:
        axes.axvline(stamp, color="black", linewidth=0.8)
    axes.set_ylim(0.0, 1.02)
    axes.set_xlabel("time [s]; vertical line: an object is moved")
    axes.set_ylabel("reliability [1]")
    axes.legend(loc="lower left", frameon=False)
    figure.savefig(file, dpi=110)


def _reliability(
    series: MethodSeries, object_id: int, stamps: NDArray[np.float64]
) -> NDArray[np.float64]:
    mine = [one for one in series.landmarks if one.object_id == object_id]
    since = np.array([one.stamp for one in mine])
    values = np.array([one.reliability for one in mine])
    return np.asarray(values[np.maximum(np.searchsorted(since, stamps, "right") - 1, 0)])
