"""`cairn experiment uncertainty`: how a change affects the pose, with and without a map update.

Section 4.1 and figure 9 of the paper: uncertainty and error over time, by condition and phase.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from cairn_lab.batch.options import BatchOptions
from cairn_lab.experiments.methods import (
    NO_UPDATE,
    NO_UPDATE_CERTAIN,
    OURS,
    OURS_CERTAIN,
    ExperimentSetup,
    first_event_s,
)
from cairn_lab.experiments.report_folder import ReportFolder, open_report, write_report
from cairn_lab.experiments.results import ExperimentRunResult, MethodResult, MoveResult
from cairn_lab.experiments.runs import FinishedRun, RunSpec, check_setup, run_experiment
from cairn_lab.experiments.series import ErrorCurve, error_curve
from cairn_lab.experiments.statistics import (
    LEAST_CASES,
    Mean,
    Rate,
    bootstrap_mean,
    bootstrap_ratio,
    format_change,
    format_count,
    format_count_of_cases,
    format_mean,
    format_table,
    interval_note,
    join_names,
    rate_within,
    too_few_note,
)

Array = NDArray[np.float64]

UNCERTAINTY = (OURS, NO_UPDATE, OURS_CERTAIN, NO_UPDATE_CERTAIN)
"""The methods that run in the shadow; scans alone drive the robot."""

QUANTITIES = {
    "position_spread": "position spread [m]",
    "position_sigma": "position sigma [m]",
    "position_error": "position error [m]",
    "heading_spread": "heading spread [rad]",
    "heading_sigma": "heading sigma [rad]",
    "heading_error": "heading error [rad]",
}
"""The attributes of an `ErrorCurve` and their titles.

spread: standard deviation of the particles; sigma: the one that the estimate states; error: rms.
"""

_PICTURES = {
    "fig9_position.png": tuple(QUANTITIES)[:3],
    "fig9_orientation.png": tuple(QUANTITIES)[3:],
}

TOLERANCE = 0.1
"""A quantity within this share of its value in the unchanged room has returned to it."""
_TOLERANCE = f"{100 * TOLERANCE:g} %"

BEFORE, AFTER, REPAIRED = "before", "after", "repaired"
PHASES = {
    BEFORE: "before the change",
    AFTER: "after the change",
    REPAIRED: "from the registration of the moved object on",
}


@dataclass(frozen=True)
class Condition:
    """Whether the room was changed, and whether the map is updated; `title` names it in reports.

    `reference` is the name of the same condition without a change: the comparison with it shows
    only what the change causes.
    """

    name: str
    title: str
    reference: str
    color: str
    style: str


UNCHANGED = Condition("unchanged", "unchanged, map updated", "unchanged", "tab:red", "-")
CHANGED = Condition("changed", "changed, map updated", "unchanged", "tab:green", "--")
UNCHANGED_FIXED = Condition(
    "unchanged_fixed", "unchanged, map fixed", "unchanged_fixed", "tab:orange", "-"
)
CHANGED_FIXED = Condition("changed_fixed", "changed, map fixed", "unchanged_fixed", "tab:blue", ":")
CONDITIONS = (UNCHANGED, CHANGED, UNCHANGED_FIXED, CHANGED_FIXED)


def with_certain_fusion(condition: Condition) -> Condition:
    """Return the same condition for a filter that trusts the map position of each object fully."""
    return replace(
        condition, name=f"certain_{condition.name}", reference=f"certain_{condition.reference}"
    )


CERTAIN_CONDITIONS = tuple(map(with_certain_fusion, CONDITIONS))
FUSIONS = {
    "objects fused by their reliability": CONDITIONS,
    "objects fused as certain": CERTAIN_CONDITIONS,
}


@dataclass(frozen=True)
class SeedCurves:
    """The two runs of one seed: the error curve of each condition, and when [s] what happened."""

    seed: int
    curves: Mapping[str, ErrorCurve]
    changed_at: float
    registered_at: float | None
    end: float

    def phase(self, condition: str, phase: str) -> ErrorCurve:
        """Return one phase of a curve; empty for `REPAIRED` if nothing was registered."""
        begin, end = {
            BEFORE: (0.0, self.changed_at),
            AFTER: (self.changed_at, self.end),
            REPAIRED: (self.end if self.registered_at is None else self.registered_at, self.end),
        }[phase]
        return self.curves[condition].between(begin, end)


class ConditionSummary(BaseModel):
    """One quantity of one condition in one phase: its mean over time, over all seeds."""

    model_config = ConfigDict(extra="forbid")

    condition: str = Field(
        description="unchanged or changed: the room; _fixed: the map is not updated; certain_: the "
        "filter trusts the map position of each object fully, instead of by its reliability."
    )
    phase: str = Field(
        description="before: until the change; after: from it on; repaired: from the registration "
        "of the moved object on, the same time for all conditions."
    )
    quantity: str = Field(
        description="spread: standard deviation of the particles; sigma: the one that the estimate "
        "states; error: of the estimate, rms. Of the position [m] or of the heading [rad]."
    )
    value: Mean
    against_unchanged: Mean = Field(
        description="Ratio to the unchanged room, in the same phase of the same seeds, with the "
        "map updated or fixed alike."
    )
    seeds_near_unchanged: Rate = Field(
        description="Seeds in which it is within 10 % of its value in the unchanged room."
    )


def run_uncertainty(
    setup: ExperimentSetup, seeds: Sequence[int], out: Path, batch: BatchOptions, *, quiet: bool
) -> tuple[list[str], dict[str, Any], bool]:
    """Run it; return the report's lines, its figures, and whether all runs succeeded.

    Scans alone drive the robot, so that it follows the same path under all conditions.
    """
    at = first_event_s(setup)
    folder = ReportFolder(out, "uncertainty", tuple(_PICTURES))
    unchanged = replace(setup, events=())
    specs = [
        spec
        for seed in seeds
        for spec in (
            RunSpec(unchanged, seed, folder.run(seed, "unchanged"), moves=False),
            RunSpec(setup, seed, folder.run(seed, "changed"), moves=True),
        )
    ]
    check_setup(setup)
    with open_report(folder):
        runs, failures = run_experiment(specs, folder, batch, at, quiet=quiet)
        curves = list(_seed_curves(runs, at))
        summaries = summarize_conditions(curves) if curves else []
        lines = list(_lines(curves, summaries, failures))
        body = {
            "seeds": list(seeds),
            "changed_at": at,
            "failures": failures,
            "summary": [one.model_dump(mode="json") for one in summaries],
            "runs": {run.spec.name(out): run.result.model_dump(mode="json") for run in runs},
        }
        pictures = {
            name: partial(_draw_curves, curves, quantities)
            for name, quantities in _PICTURES.items()
            if curves
        }
        models = (ConditionSummary, Mean, Rate, ExperimentRunResult, MethodResult, MoveResult)
        write_report(folder, lines, body, models, pictures)
    return lines, {key: body[key] for key in ("failures", "summary")}, not failures


def _seed_curves(runs: Sequence[FinishedRun], at: float) -> Iterator[SeedCurves]:
    """Yield the curves of the seeds of which both runs succeeded."""
    unchanged_runs = {run.spec.seed: run for run in runs if not run.spec.moves}
    changed_runs = {run.spec.seed: run for run in runs if run.spec.moves}
    for seed in sorted(unchanged_runs.keys() & changed_runs.keys()):
        unchanged, changed = unchanged_runs[seed], changed_runs[seed]
        end = min(unchanged.result.seconds, changed.result.seconds)
        curves = {}
        for conditions, updating, fixed in (
            (CONDITIONS, OURS, NO_UPDATE),
            (CERTAIN_CONDITIONS, OURS_CERTAIN, NO_UPDATE_CERTAIN),
        ):
            sources = (
                (unchanged, updating),
                (changed, updating),
                (unchanged, fixed),
                (changed, fixed),
            )
            for condition, (run, method) in zip(conditions, sources, strict=True):
                curves[condition.name] = error_curve(run.methods[method.name], run.world, end)
        ours = next(one for one in changed.result.methods if one.method == OURS.name)
        registered = [m.registered_at for m in ours.moves if m.registered_at is not None]
        yield SeedCurves(seed, curves, at, max(registered, default=None), end)


def summarize_conditions(curves: Sequence[SeedCurves]) -> list[ConditionSummary]:
    """Return all quantities of all conditions in all phases."""
    summaries = []
    for phase in PHASES:
        for quantity in QUANTITIES:
            for condition in (*CONDITIONS, *CERTAIN_CONDITIONS):
                reference = _means(curves, condition.reference, phase, quantity)
                values = _means(curves, condition.name, phase, quantity)
                summaries.append(
                    ConditionSummary(
                        condition=condition.name,
                        phase=phase,
                        quantity=quantity,
                        value=bootstrap_mean(values),
                        against_unchanged=bootstrap_ratio(values, reference),
                        seeds_near_unchanged=rate_within(values, reference, TOLERANCE),
                    )
                )
    return summaries


def _means(curves: Sequence[SeedCurves], condition: str, phase: str, quantity: str) -> Array:
    """Return the quantity's mean over time for each seed (n,), of errors the rms; or NaN."""
    power = 2 if quantity.endswith("_error") else 1
    values = []
    for one in curves:
        row = getattr(one.phase(condition, phase), quantity)
        known = row[np.isfinite(row)]
        values.append(np.mean(known**power) ** (1 / power) if known.size else np.nan)
    return np.array(values, np.float64)


def _lines(
    curves: Sequence[SeedCurves],
    summaries: Sequence[ConditionSummary],
    failures: Mapping[str, str],
) -> Iterator[str]:
    yield (
        f"uncertainty: {format_count(len(curves), 'seed')}, each in the unchanged and in the "
        "changed room"
    )
    for name, failure in failures.items():
        yield f"{name} failed: {failure}"
    if not curves:
        return
    registered = sum(one.registered_at is not None for one in curves)
    yield (
        f"changed at {curves[0].changed_at:g} s; the moved object was registered in {registered} "
        f"of {format_count(len(curves), 'seed')}"
    )
    yield from too_few_note(len(curves), "seed")
    by_key = {(one.condition, one.phase, one.quantity): one for one in summaries}
    for fusion, conditions in FUSIONS.items():
        yield ""
        yield f"{fusion}:"
        for phase, title in PHASES.items():
            yield ""
            yield from format_table(
                (title, *QUANTITIES.values()),
                [
                    (
                        condition.title,
                        *(
                            format_mean(by_key[condition.name, phase, q].value, 4)
                            for q in QUANTITIES
                        ),
                    )
                    for condition in conditions
                ],
            )
        _, updated, _, fixed = conditions
        yield ""
        yield from format_table(
            ("ratio to unchanged, after the change", *QUANTITIES.values()),
            [
                (
                    condition.title,
                    *(
                        format_mean(by_key[condition.name, AFTER, q].against_unchanged)
                        for q in QUANTITIES
                    ),
                )
                for condition in (updated, fixed)
            ],
        )
        yield ""
        yield from describe_repair(by_key, updated, fixed, len(curves))
    yield ""
    yield f"in brackets: 95 % intervals, {interval_note(len(curves), 'seed')}"
    yield (
        "spread: standard deviation of the particles; sigma: the one that the estimate states; "
        "errors are rms"
    )


Summaries = Mapping[tuple[str, str, str], ConditionSummary]
"""By condition, phase and quantity."""


def describe_repair(
    summaries: Summaries, updated: Condition, fixed: Condition, seeds: int
) -> Iterator[str]:
    """Yield in words what a wrong map does to the pose, and whether an updated map undoes it.

    `updated` and `fixed` are the conditions of one filter in the changed room.
    """
    harm = {q: summaries[fixed.name, AFTER, q].against_unchanged for q in QUANTITIES}
    yield _describe_harm(harm)
    rest = {q: summaries[updated.name, REPAIRED, q].against_unchanged for q in QUANTITIES}
    repaired = max(ratio.runs for ratio in rest.values())
    if not repaired:
        yield (
            f"In 0 of {format_count(seeds, 'seed')} the moved object was registered again: the "
            "effect of a repaired map is unknown."
        )
        return
    if repaired < seeds:
        yield (
            f"In {seeds - repaired} of {format_count(seeds, 'seed')} the moved object was not "
            "registered again: these are left out below."
        )
    yield ""
    yield from format_table(
        (
            f"difference to unchanged, {PHASES[REPAIRED]}",
            fixed.title,
            updated.title,
            f"updated: within {_TOLERANCE}",
            f"seeds within {_TOLERANCE}",
        ),
        [
            (
                title,
                format_change(summaries[fixed.name, REPAIRED, q].against_unchanged),
                format_change(rest[q]),
                _verdict(rest[q]),
                format_count_of_cases(summaries[updated.name, REPAIRED, q].seeds_near_unchanged),
            )
            for q, title in QUANTITIES.items()
        ],
    )
    yield ""
    yield from _describe_rest(rest, repaired)


def _describe_harm(ratios: Mapping[str, Mean]) -> str:
    """Return what a map without updates does, as far as the intervals allow a conclusion."""
    begin = "With a fixed map, after the change"
    fewest = min(ratio.runs for ratio in ratios.values())
    if fewest < LEAST_CASES:
        return f"{begin}: {_list_changes(ratios)}; {_too_few(fewest)}."
    raised = {q: r for q, r in ratios.items() if r.low is not None and r.low > 1}
    lowered = {q: r for q, r in ratios.items() if r.high is not None and r.high < 1}
    others = [q for q in ratios if q not in raised and q not in lowered]
    parts = []
    if raised:
        parts.append(f"larger than in the unchanged room: {_list_changes(raised)}")
    if lowered:
        parts.append(f"smaller: {_list_changes(lowered)}")
    if others:
        parts.append(f"no significant difference: {', '.join(map(_title, others))}")
    return f"{begin}: {'; '.join(parts)}."


def _describe_rest(ratios: Mapping[str, Mean], seeds: int) -> Iterator[str]:
    """Yield which quantities have returned to those of the unchanged room, and how certainly."""
    returned = [q for q, ratio in ratios.items() if _is_near(ratio.mean)]
    off = {q: ratio for q, ratio in ratios.items() if q not in returned}
    yield (
        f"With an updated map, {len(returned)} of {len(ratios)} quantities are within {_TOLERANCE} "
        f"of the unchanged room{f'; not: {_list_changes(off)}' if off else ''}."
    )
    if seeds < LEAST_CASES:
        yield f"{_too_few(seeds).capitalize()}."
        return
    uncertain = [_title(q) for q, ratio in ratios.items() if _is_uncertain(ratio)]
    if uncertain:
        yield (
            f"Not certain with {seeds} seeds: {join_names(uncertain)}; the interval includes "
            f"{_TOLERANCE}."
        )
    else:
        yield f"Certain with {seeds} seeds: no interval includes {_TOLERANCE}."


def _verdict(ratio: Mean) -> str:
    verdict = "yes" if _is_near(ratio.mean) else "no"
    return f"{verdict}, not certain" if _is_uncertain(ratio) else verdict


def _is_near(ratio: float | None) -> bool:
    return ratio is not None and abs(ratio - 1) <= TOLERANCE


def _is_uncertain(ratio: Mean) -> bool:
    """Return whether the interval is neither all within the tolerance nor all off, or missing."""
    if ratio.low is None or ratio.high is None or ratio.runs < LEAST_CASES:
        return True
    all_near = _is_near(ratio.low) and _is_near(ratio.high)
    all_off = ratio.low > 1 + TOLERANCE or ratio.high < 1 - TOLERANCE
    return not (all_near or all_off)


def _too_few(seeds: int) -> str:
    return f"{format_count(seeds, 'seed')} cannot distinguish this from chance"


def _list_changes(ratios: Mapping[str, Mean]) -> str:
    return ", ".join(f"{_title(q)} {format_change(ratio)}" for q, ratio in ratios.items())


def _title(quantity: str) -> str:
    return QUANTITIES[quantity].partition(" [")[0]


def _draw_curves(curves: Sequence[SeedCurves], quantities: Sequence[str], file: Path) -> None:
    """Draw quantities over time for each condition: mean of all seeds, and standard deviation.

    There is a column for each kind of fusion.
    """
    size = (7.0 * len(FUSIONS), 3.0 * len(quantities) + 0.4)
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(
        len(quantities), len(FUSIONS), sharex=True, sharey="row", squeeze=False
    )
    figure.suptitle(
        f"mean of {format_count(len(curves), 'seed')}, shaded: standard deviation; vertical line: "
        "an object is moved; dashed: it is registered again (median)"
    )
    for column, (title, conditions) in zip(panels.T, FUSIONS.items(), strict=True):
        _draw_column(column, curves, quantities, conditions)
        column[0].set_title(title)
        column[-1].set_xlabel("time [s]")
    for row, quantity in zip(panels, quantities, strict=True):
        row[0].set_ylabel(QUANTITIES[quantity])
        row[0].set_ylim(bottom=0.0)  # after all is drawn: it ends automatic scaling
    panels[0, 0].legend(loc="upper left", frameon=False, fontsize="small")
    figure.savefig(file, dpi=110)


def _draw_column(
    column: Sequence[Axes],
    curves: Sequence[SeedCurves],
    quantities: Sequence[str],
    conditions: Sequence[Condition],
) -> None:
    registered = [one.registered_at for one in curves if one.registered_at is not None]
    for axes, quantity in zip(column, quantities, strict=True):
        for condition in conditions:
            stamps, rows = common_time(curves, condition.name, quantity)
            mean, deviation = _mean_and_deviation(rows)
            color = condition.color
            axes.plot(
                stamps, mean, condition.style, color=color, linewidth=1.4, label=condition.title
            )
            low, high = np.maximum(mean - deviation, 0.0), mean + deviation
            axes.fill_between(stamps, low, high, color=color, alpha=0.12, linewidth=0)
        axes.axvline(curves[0].changed_at, color="black", linewidth=0.8)
        if registered:
            axes.axvline(float(np.median(registered)), color="gray", linewidth=0.8, linestyle="--")
        axes.grid(linewidth=0.3)


def common_time(curves: Sequence[SeedCurves], condition: str, quantity: str) -> tuple[Array, Array]:
    """Return stamps (n,) [s] and the quantity (seeds, n) over the time that all seeds have."""
    steps = min(one.curves[condition].stamps.size for one in curves)
    rows = [getattr(one.curves[condition], quantity)[:steps] for one in curves]
    return curves[0].curves[condition].stamps[:steps], np.array(rows, np.float64)


def _mean_and_deviation(rows: Array) -> tuple[Array, Array]:
    """Return mean and standard deviation (n,) of the known values of rows (m, n); else NaN."""
    known = np.isfinite(rows)
    count = np.where(known.any(axis=0), known.sum(axis=0), np.nan)
    mean = np.where(known, rows, 0.0).sum(axis=0) / count
    squares = np.where(known, (rows - mean) ** 2, 0.0).sum(axis=0) / count
    return np.asarray(mean, np.float64), np.asarray(np.sqrt(squares), np.float64)
