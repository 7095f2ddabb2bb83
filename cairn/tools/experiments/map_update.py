"""`cairn experiment map-update`: an object is moved, and the robot repairs its map (figure 10)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from cairn.tools.experiments import text
from cairn.tools.experiments.experiment import Observed, observed
from cairn.tools.experiments.judging import THERE_M, MoveResult, PairResult, RunResult
from cairn.tools.experiments.map_pictures import draw_reliabilities, draw_sequence
from cairn.tools.experiments.methods import OURS, PAPER, Method
from cairn.tools.experiments.pairs import MAP_BUILDER, Plan, changed_at, plain
from cairn.tools.experiments.report_folder import ReportFolder, begun, write_report
from cairn.tools.experiments.runs import Job, checked
from cairn.tools.experiments.sequence import sequence_of
from cairn.tools.experiments.statistics import Mean, Rate, Spread, mean_of, rate_of, spread_of

METHODS = (OURS, PAPER)
_SEQUENCE, _RELIABILITIES = "maps_a_h.png", "reliability.png"


class UpdateSummary(BaseModel):
    """All runs of one method."""

    model_config = ConfigDict(extra="forbid")

    method: str
    title: str
    repaired: Rate = Field(
        description="Runs in which all that was moved was removed and registered within 0.3 m of "
        "its new place."
    )
    none_lost: Rate = Field(description="Runs in which nothing that stood there was removed.")
    none_false: Rate = Field(
        description="Runs in which nothing was registered more than 0.3 m off its place."
    )
    all_right: Rate = Field(description="Runs of which all three are true.")
    removed_after: Spread = Field(description="From the move to the removal [s].")
    registered_after: Spread = Field(description="From the move to the registration [s].")
    sightings_to_remove: Spread
    views_to_remove: Spread
    sightings_to_register: Spread
    registered_error: Spread = Field(description="How far off its place an object is put [m].")
    map_error: Mean = Field(
        description="Mean distance of live objects from their true places in the end [m]."
    )


def run_map_update(
    plan: Plan, seeds: Sequence[int], out: Path, workers: int, *, quiet: bool
) -> tuple[list[str], dict[str, Any], bool]:
    """Run it; the report's lines, its figures, and whether all runs did what they should."""
    at = changed_at(plan)
    folder = ReportFolder(out, "map-update", (_SEQUENCE, _RELIABILITIES))
    jobs = [Job(plan, seed, folder.run(seed), moves=True) for seed in seeds]
    checked(plan)
    with begun(folder):
        runs, failures = observed(jobs, folder, workers, at, quiet=quiet)
        results = [run.result for run in runs]
        summaries = [_summed_up(method, results) for method in METHODS] if runs else []
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
            grid = Path(plain(plan).member(MAP_BUILDER).spec.parameters["grid_file"])
            shown = _shown(runs)
            sequence = sequence_of(shown.pairs[PAPER.name], shown.world)
            pictures = {
                _SEQUENCE: partial(draw_sequence, sequence, shown.world, grid),
                _RELIABILITIES: partial(
                    draw_reliabilities, [(run.pairs[OURS.name], run.world) for run in runs]
                ),
            }
        models = (UpdateSummary, Rate, Mean, Spread, RunResult, PairResult, MoveResult)
        write_report(folder, lines, body, models, pictures)
    return lines, {key: body[key] for key in ("failures", "summary")}, not failures


def _shown(runs: Sequence[Observed]) -> Observed:
    """The run whose maps are shown: the first in which the paper's rule repaired the map."""
    for run in runs:
        paper = next(pair for pair in run.result.pairs if pair.method == PAPER.name)
        if _repaired(paper):
            return run
    return runs[0]


def _repaired(pair: PairResult) -> bool:
    return all(
        move.removed_at is not None
        and move.registered_error is not None
        and move.registered_error <= THERE_M
        for move in pair.moves
    )


def _summed_up(method: Method, runs: Sequence[RunResult]) -> UpdateSummary:
    pairs = [pair for run in runs for pair in run.pairs if pair.method == method.name]
    moves = [move for pair in pairs for move in pair.moves]
    removed = [move for move in moves if move.removed_at is not None]
    registered = [move for move in moves if move.registered_at is not None]

    def share(right: Sequence[bool]) -> Rate:
        return rate_of(sum(right), len(right))

    repaired = [_repaired(pair) for pair in pairs]
    kept = [not pair.false_removals for pair in pairs]
    true = [not pair.false_registrations for pair in pairs]
    return UpdateSummary(
        method=method.name,
        title=method.title,
        repaired=share(repaired),
        none_lost=share(kept),
        none_false=share(true),
        all_right=share([all(three) for three in zip(repaired, kept, true, strict=True)]),
        removed_after=spread_of([(m.removed_at or 0.0) - m.moved_at for m in removed]),
        registered_after=spread_of([(m.registered_at or 0.0) - m.moved_at for m in registered]),
        sightings_to_remove=spread_of([m.sightings_to_remove or 0 for m in removed]),
        views_to_remove=spread_of([m.views_to_remove or 0 for m in removed]),
        sightings_to_register=spread_of([m.sightings_to_register or 0 for m in registered]),
        registered_error=spread_of([m.registered_error or 0.0 for m in registered]),
        map_error=mean_of([pair.map_error for pair in pairs if pair.map_error is not None]),
    )


def _lines(
    summaries: Sequence[UpdateSummary], runs: Sequence[RunResult], failures: Mapping[str, str]
) -> Iterator[str]:
    yield f"map update: {text.count(len(runs), 'run')}"
    for name, failure in failures.items():
        yield f"{name} failed: {failure}"
    if not runs:
        return
    yield from text.few(len(runs))
    yield f"{OURS.title}, run by run:"
    yield from text.table(
        (
            "seed",
            "removed at [s]",
            "registered at [s]",
            "off [m]",
            "sightings to remove",
            "to register",
            "false removals",
            "false registrations",
            "map error [m]",
        ),
        [row for run in runs for row in _rows(run)],
    )
    yield ""
    yield from text.table(
        ("method", "repaired", "nothing lost", "nothing false", "all of it", "map error [m]"),
        [
            (
                one.title,
                text.rate(one.repaired),
                text.rate(one.none_lost),
                text.rate(one.none_false),
                text.rate(one.all_right),
                text.mean(one.map_error),
            )
            for one in summaries
        ],
    )
    yield f"  in brackets: 95 % intervals, of rates after Wilson, {text.of_means(len(runs))}"
    yield ""
    yield from text.table(
        ("median / 90 %", "removed", "registered", "sightings", "views", "to register", "off"),
        [
            (
                one.title,
                text.spread(one.removed_after, 1, "s"),
                text.spread(one.registered_after, 1, "s"),
                text.spread(one.sightings_to_remove),
                text.spread(one.views_to_remove),
                text.spread(one.sightings_to_register),
                text.spread(one.registered_error, 3, "m"),
            )
            for one in summaries
        ],
    )
    yield ""
    yield "sightings of each object before and after the change, fewest of all runs:"
    yield "  " + ", ".join(_coverage(runs))


def _rows(run: RunResult) -> Iterator[tuple[str, ...]]:
    pair = next(one for one in run.pairs if one.method == OURS.name)
    for move in pair.moves:
        yield (
            str(run.seed),
            _figure(move.removed_at, 1),
            _figure(move.registered_at, 1),
            _figure(move.registered_error, 3),
            _figure(move.sightings_to_remove, 0),
            _figure(move.sightings_to_register, 0),
            str(len(pair.false_removals)),
            str(len(pair.false_registrations)),
            _figure(pair.map_error, 3),
        )


def _coverage(runs: Sequence[RunResult]) -> Iterator[str]:
    for key in sorted({key for run in runs for key in run.coverage}):
        before, after = (min(run.coverage.get(key, (0, 0))[i] for run in runs) for i in (0, 1))
        yield f"{key}: {before}, {after}"


def _figure(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
