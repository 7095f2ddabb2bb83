"""`cairn experiment ablation`: several ways of keeping a visual map, on the same data."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cairn import CairnError
from cairn.tools.experiments import text
from cairn.tools.experiments.comparison import (
    ENOUGH_SIGHTINGS,
    MethodSummary,
    better_elsewhere,
    summed_up,
)
from cairn.tools.experiments.experiment import observed
from cairn.tools.experiments.judging import MoveResult, PairResult, RunResult
from cairn.tools.experiments.methods import ABLATION, OURS
from cairn.tools.experiments.pairs import WORLD, Events, Plan, plain
from cairn.tools.experiments.pictures import draw_methods
from cairn.tools.experiments.report_folder import ReportFolder, begun, write_report
from cairn.tools.experiments.room import Room
from cairn.tools.experiments.runs import Job, checked
from cairn.tools.experiments.statistics import Mean, Rate, Spread

# Of the paper's scanner, and of those that see farther [m].
_SCANNERS = ((3.0, "PBS-03JN", 1), (10.0, "UST-10LX", 3), (30.0, "UTM-30LX", 3))
# A robot that is carried off is set down with so much more room around it [m].
_CLEARANCE_M = 0.15
_PICTURE = "ablation.png"


@dataclass(frozen=True)
class Ask:
    """What is asked: how many objects are moved how far [m] and when [s], and what else.

    None as a distance: anywhere; as a scanner's range [m] or share of false matches: as in the
    deployment.
    """

    moved: int
    distance: float | None
    at: float
    kidnap: bool
    scanner_range: float | None
    false_matches: float | None

    def sets(self) -> Iterator[str]:
        """What `--set` would be given for it."""
        if self.false_matches is not None:
            parameter = "components.object_recognizer.parameters.confusion_probability"
            yield f"{parameter}={self.false_matches}"
        if self.scanner_range is not None:
            model, skip = _scanner(self.scanner_range)
            yield f"settings.scanner={model}"
            yield f"components.range_scanner.parameters.skip={skip}"
            yield f"components.range_scanner.parameters.farthest={self.scanner_range}"

    def told(self) -> str:
        """It in words."""
        parts = [f"{text.count(self.moved, 'object')} moved"]
        if self.moved and self.distance is not None:
            parts[0] += f" by {self.distance:g} m"
        parts[0] += f" at {self.at:g} s"
        if self.kidnap:
            parts.append("the robot carried off at the same time")
        if self.scanner_range is not None:
            parts.append(f"scanner of {self.scanner_range:g} m")
        if self.false_matches is not None:
            parts.append(f"{self.false_matches:.0%} false matches")
        return ", ".join(parts)


def jobs_of(plan: Plan, ask: Ask, seeds: Sequence[int], folder: ReportFolder) -> list[Job]:
    """A run for each seed, with moves of its own; `CairnError` if the world has no room for them.

    `plan` is what is run but for the events.
    """
    world = plain(plan).member(WORLD).spec.parameters
    room = Room(Path(world["world"]))
    radius = float(world.get("radius", 0.0))
    return [
        Job(
            replace(plan, events=_events(room, ask, radius, seed)),
            seed,
            folder.run(seed),
            moves=ask.moved > 0,
        )
        for seed in seeds
    ]


def run_ablation(
    plan: Plan, ask: Ask, seeds: Sequence[int], out: Path, workers: int, *, quiet: bool
) -> tuple[list[str], dict[str, Any], bool]:
    """Run it; the report's lines, its figures, and whether all runs did what they should."""
    if not ask.moved and not ask.kidnap:
        raise CairnError("--moved 0 without --kidnap leaves nothing to be compared; ask for either")
    folder = ReportFolder(out, "ablation", (_PICTURE,))
    jobs = jobs_of(plan, ask, seeds, folder)
    checked(jobs[0].plan)
    with begun(folder):
        runs, failures = observed(jobs, folder, workers, ask.at, quiet=quiet)
        results = [run.result for run in runs]
        summaries = [summed_up(method, results) for method in ABLATION]
        lines = list(_lines(ask, summaries, results, failures))
        body = {
            "asked": ask.told(),
            "seeds": list(seeds),
            "failures": failures,
            "summary": [one.model_dump(mode="json") for one in summaries],
            "runs": [run.model_dump(mode="json") for run in results],
        }
        pictures = {_PICTURE: partial(draw_methods, summaries)} if results else {}
        models = (MethodSummary, Rate, Mean, Spread, RunResult, PairResult, MoveResult)
        write_report(folder, lines, body, models, pictures)
    return lines, {key: body[key] for key in ("asked", "failures", "summary")}, not failures


def _scanner(reach: float) -> tuple[str, int]:
    for most, model, skip in _SCANNERS:
        if reach <= most:
            return model, skip
    raise CairnError(
        f"--scanner-range {reach:g}: no simulated scanner sees so far; ask for at most "
        f"{_SCANNERS[-1][0]:g} m"
    )


def _events(room: Room, ask: Ask, radius: float, seed: int) -> Events:
    # Of the experiment alone: the run's own random numbers are those of its components.
    random = np.random.default_rng([seed, ask.moved])
    events = room.moves(ask.moved, ask.distance, ask.at, random)
    if ask.kidnap:
        x, y, theta = room.somewhere(radius + _CLEARANCE_M, random)
        events.append({"at": ask.at, "kidnap": {"x": x, "y": y, "theta": theta}})
    return tuple(events)


def _lines(
    ask: Ask,
    summaries: Sequence[MethodSummary],
    runs: Sequence[RunResult],
    failures: Mapping[str, str],
) -> Iterator[str]:
    yield f"ablation: {text.count(len(runs), 'run')}, {ask.told()}"
    for name, failure in failures.items():
        yield f"{name} failed: {failure}"
    if not runs:
        return
    sightings = sum(run.sightings for run in runs)
    mistaken = sum(run.mistaken for run in runs)
    yield (
        f"{sightings} sightings, of which {mistaken} ({mistaken / max(sightings, 1):.1%}) were "
        f"mistaken; {text.count(sum(len(run.collisions) for run in runs), 'collision')}"
    )
    ours = next(one for one in summaries if one.method == OURS.name)
    if ask.moved:
        yield (
            f"{text.count(ours.moved, 'moved object')}, {ours.recall.of} of them sighted "
            f"{ENOUGH_SIGHTINGS} times after"
        )
    yield ""
    if ask.moved:
        yield from text.table(
            ("method", "recall", "precision", "false removals", "false registrations"),
            [
                (
                    one.title,
                    text.rate_of_cases(one.recall),
                    text.rate_of_cases(one.precision),
                    text.rate(one.false_removals, per=1000),
                    text.count_of_cases(one.false_registrations),
                )
                for one in summaries
            ],
        )
        yield (
            f"  recall: of moved objects sighted {ENOUGH_SIGHTINGS} times after; false removals: "
            "of 1000 sightings"
        )
        yield ""
        yield from text.table(
            ("method", "to remove", "in views", "to register", "registered off", "repaired"),
            [
                (
                    one.title,
                    text.spread(one.sightings_to_remove),
                    text.spread(one.views_to_remove),
                    text.spread(one.sightings_to_register),
                    text.spread(one.registered_error, 3, "m"),
                    text.rate(one.repaired),
                )
                for one in summaries
            ],
        )
        yield "  sightings from the move, median / 90 %; repaired: registered within 0.3 m"
        yield ""
    yield from text.table(
        ("method", "map error [m]", "position rms after [m]", "p95 [m]", "lost"),
        [
            (
                one.title,
                text.mean(one.map_error),
                text.mean(one.rms_after),
                text.mean(one.p95_after),
                text.mean(one.lost),
            )
            for one in summaries
        ],
    )
    yield f"  in brackets: 95 % intervals, of rates after Wilson, {text.of_means(len(runs))}"
    if ask.kidnap:
        yield ""
        yield from _carried_off(summaries, runs)
    yield ""
    yield from better_elsewhere(ours, [one for one in summaries if one is not ours])


def _carried_off(summaries: Sequence[MethodSummary], runs: Sequence[RunResult]) -> Iterator[str]:
    yield from text.table(
        ("method", "found itself", "within [s]", "false removals a run"),
        [
            (
                one.title,
                text.rate_of_cases(one.found),
                text.spread(one.found_s, 1),
                f"{one.false_removals.count / len(runs):.2f}",
            )
            for one in summaries
        ],
    )
    yield "  the robot is driven by ours: where it is lost, so is the way of all"
