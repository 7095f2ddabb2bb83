"""`cairn experiment ablation`: several methods of map update, compared on the same data."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from pydantic import BaseModel, ConfigDict, Field

from cairn import CairnError
from cairn_lab.batch.options import BatchOptions
from cairn_lab.experiments.methods import (
    ABLATION,
    OURS,
    WORLD,
    Events,
    ExperimentSetup,
    Method,
    base_deployment,
)
from cairn_lab.experiments.random_changes import RandomChanges
from cairn_lab.experiments.report_folder import ReportFolder, open_report, write_report
from cairn_lab.experiments.results import (
    CORRECT_M,
    ExperimentRunResult,
    MethodResult,
    MoveResult,
)
from cairn_lab.experiments.runs import RunSpec, check_setup, run_experiment
from cairn_lab.experiments.statistics import (
    LEAST_CASES,
    Mean,
    Percentiles,
    Rate,
    bootstrap_mean,
    bootstrap_rms,
    format_count,
    format_count_of_cases,
    format_mean,
    format_percentiles,
    format_rate,
    format_rate_of_cases,
    format_table,
    interval_note,
    join_names,
    percentiles,
    wilson_rate,
)

# Range [m], model and `skip` of the paper's scanner, and of scanners with a longer range.
_SCANNERS = ((3.0, "PBS-03JN", 1), (10.0, "UST-10LX", 3), (30.0, "UTM-30LX", 3))
# Free space around a kidnapped robot, in addition to its radius [m].
_CLEARANCE_M = 0.15
# Moved objects with fewer observations after the move do not count in recall.
ENOUGH_OBSERVATIONS = 5
_PICTURE = "ablation.png"
_NAN = float("nan")


@dataclass(frozen=True)
class AblationOptions:
    """How many objects are moved, how far [m] and when [s], and the other changes.

    `distance` None: any distance; `scanner_range` [m] or share of `false_matches` None: as in the
    deployment.
    """

    moved: int
    distance: float | None
    at: float
    kidnap: bool
    scanner_range: float | None
    false_matches: float | None

    def sets(self) -> Iterator[str]:
        """Yield the changes of the deployment, as for `--set`."""
        if self.false_matches is not None:
            parameter = "components.object_recognizer.parameters.confusion_probability"
            yield f"{parameter}={self.false_matches}"
        if self.scanner_range is not None:
            model, skip = _scanner(self.scanner_range)
            yield f"settings.scanner={model}"
            yield f"components.range_scanner.parameters.skip={skip}"
            yield f"components.range_scanner.parameters.farthest={self.scanner_range}"

    def describe(self) -> str:
        """Return the options in words."""
        parts = [f"{format_count(self.moved, 'object')} moved"]
        if self.moved and self.distance is not None:
            parts[0] += f" by {self.distance:g} m"
        parts[0] += f" at {self.at:g} s"
        if self.kidnap:
            parts.append("the robot kidnapped at the same time")
        if self.scanner_range is not None:
            parts.append(f"scanner range {self.scanner_range:g} m")
        if self.false_matches is not None:
            parts.append(f"{self.false_matches:.0%} false matches")
        return ", ".join(parts)


class MethodSummary(BaseModel):
    """All runs of one method."""

    model_config = ConfigDict(extra="forbid")

    method: str
    title: str
    runs: int = Field(description="Runs that succeeded.")
    moved: int = Field(description="Objects that were moved in them, observed or not.")
    recall: Rate = Field(
        description="Moved objects that were removed, or removed before the move and then "
        "registered correctly, of those observed at least 5 times after the move."
    )
    recall_by_viewpoints: Rate = Field(
        description="The same, of those observed from at least 5 poses that differ by 0.15 m or "
        "0.2 rad."
    )
    precision: Rate = Field(description="Removals of objects that did not stand there, of all.")
    false_removals: Rate = Field(
        description="Removals of objects that stood there, by observations."
    )
    false_registrations: Rate = Field(
        description="Registrations more than 0.3 m from the true position, of all."
    )
    repaired: Rate = Field(
        description="Moved objects registered within 0.3 m of their new position, of those "
        "observed at least 5 times after the move."
    )
    observations_to_remove: Percentiles = Field(description="From the move to the removal.")
    viewpoints_to_remove: Percentiles = Field(description="The same, counted by viewpoints.")
    observations_to_register: Percentiles = Field(description="From the move to the registration.")
    registration_error: Percentiles = Field(
        description="Distance of the registered from the true position [m]."
    )
    map_error: Mean = Field(
        description="Mean distance of the live landmarks from their true positions at the end [m]."
    )
    rms_after: Mean = Field(description="Position error after the change, rms [m].")
    p95_after: Mean = Field(
        description="95th percentile of the position error after the change, mean of runs [m]."
    )
    lost: Mean = Field(
        description="Share of the time after the change with an error of more than 1 m, or without "
        "a pose."
    )
    relocalized: Rate = Field(
        description="Runs in which the kidnapped robot was relocalized, of all with a kidnapping."
    )
    relocalized_s: Percentiles = Field(description="Time from the kidnapping until then [s].")


def run_ablation(
    setup: ExperimentSetup,
    options: AblationOptions,
    seeds: Sequence[int],
    out: Path,
    batch: BatchOptions,
    *,
    quiet: bool,
) -> tuple[list[str], dict[str, Any], bool]:
    """Run it; return the report's lines, its figures, and whether all runs succeeded."""
    if not options.moved and not options.kidnap:
        raise CairnError("--moved 0 without --kidnap changes nothing; specify at least one change")
    folder = ReportFolder(out, "ablation", (_PICTURE,))
    specs = _run_specs(setup, options, seeds, folder)
    check_setup(specs[0].setup)
    with open_report(folder):
        runs, failures = run_experiment(specs, folder, batch, options.at, quiet=quiet)
        results = [run.result for run in runs]
        summaries = [summarize_method(method, results) for method in ABLATION]
        lines = list(_lines(options, summaries, results, failures))
        body = {
            "options": options.describe(),
            "seeds": list(seeds),
            "failures": failures,
            "summary": [one.model_dump(mode="json") for one in summaries],
            "runs": [run.model_dump(mode="json") for run in results],
        }
        pictures = {_PICTURE: partial(_draw_methods, summaries)} if results else {}
        models = (MethodSummary, Rate, Mean, Percentiles)
        results_models = (ExperimentRunResult, MethodResult, MoveResult)
        write_report(folder, lines, body, (*models, *results_models), pictures)
    return lines, {key: body[key] for key in ("options", "failures", "summary")}, not failures


def _run_specs(
    setup: ExperimentSetup, options: AblationOptions, seeds: Sequence[int], folder: ReportFolder
) -> list[RunSpec]:
    """Return a run for each seed, each with other moves; `CairnError` if there is no room."""
    world = base_deployment(setup).member(WORLD).spec.parameters
    changes = RandomChanges(Path(world["world"]))
    radius = float(world.get("radius", 0.0))
    return [
        RunSpec(
            replace(setup, events=_events(changes, options, radius, seed)),
            seed,
            folder.run(seed),
            moves=options.moved > 0,
        )
        for seed in seeds
    ]


def _events(changes: RandomChanges, options: AblationOptions, radius: float, seed: int) -> Events:
    # A generator of its own: the run's random numbers are those of its components.
    random = np.random.default_rng([seed, options.moved])
    events = changes.draw_moves(options.moved, options.distance, options.at, random)
    if options.kidnap:
        x, y, theta = changes.draw_kidnap_pose(radius + _CLEARANCE_M, random)
        events.append({"at": options.at, "kidnap": {"x": x, "y": y, "theta": theta}})
    return tuple(events)


def _scanner(range_m: float) -> tuple[str, int]:
    for longest, model, skip in _SCANNERS:
        if range_m <= longest:
            return model, skip
    raise CairnError(
        f"--scanner-range {range_m:g}: no simulated scanner has this range; specify at most "
        f"{_SCANNERS[-1][0]:g} m"
    )


def summarize_method(method: Method, runs: Sequence[ExperimentRunResult]) -> MethodSummary:
    """Return the figures of one method in all runs."""
    results = [one for run in runs for one in run.methods if one.method == method.name]
    moves = [move for result in results for move in result.moves]
    observed = [move for move in moves if move.observations >= ENOUGH_OBSERVATIONS]
    viewed = [move for move in moves if move.viewpoints >= ENOUGH_OBSERVATIONS]
    removals = sum(result.removals for result in results)
    false_removals = sum(len(result.false_removals) for result in results)
    kidnapped = [
        one
        for run in runs
        for one in run.methods
        if one.method == method.name and run.kidnapped_at is not None
    ]
    relocalized = [one.relocalized_s for one in kidnapped if one.relocalized_s is not None]
    return MethodSummary(
        method=method.name,
        title=method.title,
        runs=len(results),
        moved=len(moves),
        recall=wilson_rate(sum(move.noticed for move in observed), len(observed)),
        recall_by_viewpoints=wilson_rate(sum(move.noticed for move in viewed), len(viewed)),
        precision=wilson_rate(removals - false_removals, removals),
        false_removals=wilson_rate(false_removals, sum(run.observations for run in runs)),
        false_registrations=wilson_rate(
            sum(len(result.false_registrations) for result in results),
            sum(result.registrations for result in results),
        ),
        repaired=wilson_rate(sum(map(_is_repaired, observed)), len(observed)),
        observations_to_remove=_percentiles(move.observations_to_remove for move in observed),
        viewpoints_to_remove=_percentiles(move.viewpoints_to_remove for move in observed),
        observations_to_register=_percentiles(move.observations_to_register for move in observed),
        registration_error=_percentiles(move.registration_error for move in observed),
        map_error=bootstrap_mean([_or_nan(result.map_error) for result in results]),
        rms_after=bootstrap_rms([_or_nan(result.rms_after) for result in results]),
        p95_after=bootstrap_mean([_or_nan(result.p95_after) for result in results]),
        lost=bootstrap_mean([result.lost_after for result in results]),
        relocalized=wilson_rate(len(relocalized), len(kidnapped)),
        relocalized_s=_percentiles(relocalized),
    )


def _is_repaired(move: MoveResult) -> bool:
    return move.registration_error is not None and move.registration_error <= CORRECT_M


def _percentiles(values: Iterable[float | None]) -> Percentiles:
    return percentiles([value for value in values if value is not None])


def _or_nan(value: float | None) -> float:
    return _NAN if value is None else value


def _lines(
    options: AblationOptions,
    summaries: Sequence[MethodSummary],
    runs: Sequence[ExperimentRunResult],
    failures: Mapping[str, str],
) -> Iterator[str]:
    yield f"ablation: {format_count(len(runs), 'run')}, {options.describe()}"
    for name, failure in failures.items():
        yield f"{name} failed: {failure}"
    if not runs:
        return
    observations = sum(run.observations for run in runs)
    false_matches = sum(run.false_matches for run in runs)
    yield (
        f"{format_count(observations, 'observation')}, {false_matches} of them "
        f"({false_matches / max(observations, 1):.1%}) false matches; "
        f"{format_count(sum(len(run.collisions) for run in runs), 'collision')}"
    )
    ours = next(one for one in summaries if one.method == OURS.name)
    if options.moved:
        yield (
            f"{format_count(ours.moved, 'moved object')}, {ours.recall.of} of them observed at "
            f"least {ENOUGH_OBSERVATIONS} times after the move"
        )
    yield ""
    if options.moved:
        yield from _map_change_tables(summaries)
    yield from format_table(
        ("method", "map error [m]", "position rms after [m]", "p95 [m]", "lost"),
        [
            (
                one.title,
                format_mean(one.map_error),
                format_mean(one.rms_after),
                format_mean(one.p95_after),
                format_mean(one.lost),
            )
            for one in summaries
        ],
    )
    yield f"  in brackets: 95 % intervals, for rates by Wilson, {interval_note(len(runs))}"
    if options.kidnap:
        yield ""
        yield from _relocalization_table(summaries, runs)
    yield ""
    yield from compare_with_ours(ours, [one for one in summaries if one is not ours])


def _map_change_tables(summaries: Sequence[MethodSummary]) -> Iterator[str]:
    yield from format_table(
        ("method", "recall", "precision", "false removals", "false registrations"),
        [
            (
                one.title,
                format_rate_of_cases(one.recall),
                format_rate_of_cases(one.precision),
                format_rate(one.false_removals, per=1000),
                format_count_of_cases(one.false_registrations),
            )
            for one in summaries
        ],
    )
    yield (
        f"  recall: of moved objects observed at least {ENOUGH_OBSERVATIONS} times after the move; "
        "false removals: per 1000 observations"
    )
    yield ""
    yield from format_table(
        ("method", "to remove", "viewpoints", "to register", "registration error", "repaired"),
        [
            (
                one.title,
                format_percentiles(one.observations_to_remove),
                format_percentiles(one.viewpoints_to_remove),
                format_percentiles(one.observations_to_register),
                format_percentiles(one.registration_error, 3, "m"),
                format_rate(one.repaired),
            )
            for one in summaries
        ],
    )
    yield "  observations since the move, median / 90 %; repaired: registered within 0.3 m"
    yield ""


def _relocalization_table(
    summaries: Sequence[MethodSummary], runs: Sequence[ExperimentRunResult]
) -> Iterator[str]:
    yield from format_table(
        ("method", "relocalized", "after [s]", "false removals per run"),
        [
            (
                one.title,
                format_rate_of_cases(one.relocalized),
                format_percentiles(one.relocalized_s, 1),
                f"{one.false_removals.count / len(runs):.2f}",
            )
            for one in summaries
        ],
    )
    yield "  our method drives the robot: where it is lost, the path of all methods is affected"


@dataclass(frozen=True)
class _Criterion:
    """A rate by which methods are compared, shown `per` so many cases."""

    title: str
    per: int
    more_is_better: bool
    rate: Callable[[MethodSummary], Rate]

    def is_better(self, other: MethodSummary, ours: MethodSummary) -> bool:
        """Return whether the other method's rate is better; false if one of them is unknown."""
        our_rate, other_rate = self.rate(ours).rate, self.rate(other).rate
        if our_rate is None or other_rate is None:
            return False
        return other_rate > our_rate if self.more_is_better else other_rate < our_rate

    def describe(self, other: MethodSummary, ours: MethodSummary) -> str:
        """Return in what the other method is better, by how much, and whether that is certain."""
        other_rate, our_rate = (
            f"{self.per * (self.rate(method).rate or 0.0):.2f}" for method in (other, ours)
        )
        if ours.runs < LEAST_CASES:
            doubt = f"; {format_count(ours.runs, 'run')}: too few to be certain"
        else:
            overlap = _overlap(self.rate(ours), self.rate(other))
            doubt = "; the intervals overlap" if overlap else ""
        unit = "" if self.per == 1 else f" per {self.per} observations"
        return f"in {self.title}{unit} ({other_rate} against {our_rate}{doubt})"


_RECALL = _Criterion("recall", 1, True, lambda one: one.recall)
_FALSE_REMOVALS = _Criterion("false removals", 1000, False, lambda one: one.false_removals)


def compare_with_ours(ours: MethodSummary, others: Sequence[MethodSummary]) -> Iterator[str]:
    """Yield in words which methods are better than ours in recall or in false removals.

    Also what these runs cannot decide.
    """
    criteria = [_RECALL, _FALSE_REMOVALS]
    for other in others:
        parts = [one.describe(other, ours) for one in criteria if one.is_better(other, ours)]
        if parts:
            both = "both " if len(parts) == len(criteria) else ""
            nothing = ", as it removes nothing at all" if other.precision.of == 0 else ""
            title = other.title.capitalize()
            yield f"{title} is better than ours {both}{' and '.join(parts)}{nothing}."
    if ours.recall.of < LEAST_CASES:
        yield f"Recall cannot be compared: {_too_few_moved(ours)}."
        criteria.remove(_RECALL)
    if ours.runs < LEAST_CASES:
        yield (
            f"{format_count(ours.runs, 'run')}: too few to decide which method is better; at least "
            f"{LEAST_CASES} are needed."
        )
        return
    for criterion in criteria:
        yield from _unbeaten(criterion, ours, others)


def _unbeaten(
    criterion: _Criterion, ours: MethodSummary, others: Sequence[MethodSummary]
) -> Iterator[str]:
    """Yield that no other method is better, and for which methods that is not certain."""
    if any(criterion.is_better(other, ours) for other in others):
        return
    rate = criterion.rate
    similar = [one.title for one in others if _overlap(rate(ours), rate(one))]
    doubt = f"; the intervals of {join_names(similar)} overlap with ours" if similar else ""
    yield (
        f"No other method is better than ours in {criterion.title} in these {ours.runs} runs"
        f"{doubt}."
    )


def _too_few_moved(summary: MethodSummary) -> str:
    if not summary.moved:
        return "no object was moved"
    return (
        f"{summary.recall.of} of {format_count(summary.moved, 'moved object')} observed at least "
        f"{ENOUGH_OBSERVATIONS} times after the move, and at least {LEAST_CASES} are needed"
    )


def _overlap(one: Rate, other: Rate) -> bool:
    if one.low is None or one.high is None or other.low is None or other.high is None:
        return True
    return one.low <= other.high and other.low <= one.high


def _draw_methods(summaries: Sequence[MethodSummary], file: Path) -> None:
    """Draw recall and false removals of each method, with their 95 % intervals."""
    figure = Figure(figsize=(9.0, 0.8 + 0.45 * len(summaries)), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for row, one in enumerate(summaries):
        color = "tab:green" if row == 0 else "tab:blue"
        for axes, value, per in ((left, one.recall, 1), (right, one.false_removals, 1000)):
            _draw_interval(axes, value, per, row, color)
    if not any(one.recall.of for one in summaries):
        text = "no object moved and observed"
        left.annotate(text, (0.5, 0.5), xycoords="axes fraction", ha="center")
    left.set_yticks(range(len(summaries)), [one.title for one in summaries])
    left.set_ylim(len(summaries) - 0.5, -0.5)
    left.set_xlim(-0.02, 1.02)
    left.set_xlabel("recall of moved objects [1]")
    right.set_xlim(left=0.0)
    right.set_xlabel("false removals per 1000 observations [1]")
    for axes in (left, right):
        axes.grid(axis="x", linewidth=0.3)
    figure.savefig(file, dpi=110)


def _draw_interval(axes: Axes, value: Rate, per: int, row: int, color: str) -> None:
    if value.rate is None or value.low is None or value.high is None:
        return
    middle = per * value.rate
    around = [[middle - per * value.low], [per * value.high - middle]]
    axes.errorbar([middle], [row], xerr=around, fmt="o", color=color, capsize=3, markersize=5)
