"""`cairn experiment uncertainty`: what a change does to the pose, with and without an update."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from cairn.tools.experiments import text
from cairn.tools.experiments.conditions import (
    AFTER,
    FUSIONS,
    HEADING,
    NOT_UPDATED,
    PHASES,
    POSITION,
    QUANTITIES,
    UNCHANGED,
    UNCHANGED_FIXED,
    UPDATED,
    Figure,
    Way,
    at_its_word,
    figures,
)
from cairn.tools.experiments.errors import Course, course_of
from cairn.tools.experiments.experiment import Observed, observed
from cairn.tools.experiments.judging import MoveResult, PairResult, RunResult
from cairn.tools.experiments.methods import (
    NO_UPDATE,
    NO_UPDATE_AT_ITS_WORD,
    OURS,
    OURS_AT_ITS_WORD,
)
from cairn.tools.experiments.pairs import Plan, changed_at
from cairn.tools.experiments.pictures import draw_courses
from cairn.tools.experiments.repair import repair
from cairn.tools.experiments.report_folder import ReportFolder, begun, write_report
from cairn.tools.experiments.runs import Job, checked
from cairn.tools.experiments.statistics import Mean, Rate

UNCERTAINTY = (OURS, NO_UPDATE, OURS_AT_ITS_WORD, NO_UPDATE_AT_ITS_WORD)
"""The pairs that follow each way."""
_PICTURES = {"fig9_position.png": POSITION, "fig9_orientation.png": HEADING}


def run_uncertainty(
    plan: Plan, seeds: Sequence[int], out: Path, workers: int, *, quiet: bool
) -> tuple[list[str], dict[str, Any], bool]:
    """Run it; the report's lines, its figures, and whether all runs did what they should.

    The robot drives by scans alone, so that no condition changes its way.
    """
    at = changed_at(plan)
    folder = ReportFolder(out, "uncertainty", tuple(_PICTURES))
    still = replace(plan, events=())
    jobs = [
        job
        for seed in seeds
        for job in (
            Job(still, seed, folder.run(seed, "unchanged"), moves=False),
            Job(plan, seed, folder.run(seed, "changed"), moves=True),
        )
    ]
    checked(plan)
    with begun(folder):
        runs, failures = observed(jobs, folder, workers, at, quiet=quiet)
        ways = list(_ways(runs, at))
        found = figures(ways) if ways else []
        lines = list(_lines(ways, found, failures))
        body = {
            "seeds": list(seeds),
            "changed_at": at,
            "failures": failures,
            "summary": [figure.model_dump(mode="json") for figure in found],
            "runs": {run.job.called(out): run.result.model_dump(mode="json") for run in runs},
        }
        pictures = {
            name: partial(draw_courses, ways, quantities)
            for name, quantities in _PICTURES.items()
            if ways
        }
        models = (Figure, Mean, Rate, RunResult, PairResult, MoveResult)
        write_report(folder, lines, body, models, pictures)
    return lines, {key: body[key] for key in ("failures", "summary")}, not failures


def _ways(runs: Sequence[Observed], at: float) -> Iterator[Way]:
    """The ways of which both runs were done."""
    unchanged = {run.job.seed: run for run in runs if not run.job.moves}
    changed = {run.job.seed: run for run in runs if run.job.moves}
    for seed in sorted(unchanged.keys() & changed.keys()):
        still, moved = unchanged[seed], changed[seed]
        end = min(still.result.seconds, moved.result.seconds)
        courses: dict[str, Course] = {}
        for kept, fixed, of in (
            (OURS, NO_UPDATE, lambda condition: condition),
            (OURS_AT_ITS_WORD, NO_UPDATE_AT_ITS_WORD, at_its_word),
        ):
            courses |= {
                of(UNCHANGED).name: course_of(still.pairs[kept.name], still.world, end),
                of(UPDATED).name: course_of(moved.pairs[kept.name], moved.world, end),
                of(UNCHANGED_FIXED).name: course_of(still.pairs[fixed.name], still.world, end),
                of(NOT_UPDATED).name: course_of(moved.pairs[fixed.name], moved.world, end),
            }
        ours = next(pair for pair in moved.result.pairs if pair.method == OURS.name)
        registered = [m.registered_at for m in ours.moves if m.registered_at is not None]
        yield Way(seed, courses, at, max(registered, default=None), end)


def _lines(
    ways: Sequence[Way], found: Sequence[Figure], failures: Mapping[str, str]
) -> Iterator[str]:
    yield f"uncertainty: {text.count(len(ways), 'way')}, each in the room unchanged and changed"
    for name, failure in failures.items():
        yield f"{name} failed: {failure}"
    if not ways:
        return
    registered = [way.registered_at for way in ways if way.registered_at is not None]
    told = f"; the moved object was registered in {len(registered)} of {len(ways)}"
    yield f"changed at {ways[0].changed_at:g} s{told}"
    yield from text.few(len(ways), "way")
    by_key = {(one.condition, one.phase, one.quantity): one for one in found}
    for fusion, conditions in FUSIONS.items():
        yield ""
        yield f"{fusion}:"
        for phase, what in PHASES.items():
            yield ""
            yield from text.table(
                (what, *QUANTITIES.values()),
                [
                    (
                        condition.title,
                        *(text.mean(by_key[condition.name, phase, q].value, 4) for q in QUANTITIES),
                    )
                    for condition in conditions
                ],
            )
        _, kept, _, fixed = conditions
        yield ""
        yield from text.table(
            ("against unchanged, after the change", *QUANTITIES.values()),
            [
                (
                    condition.title,
                    *(
                        text.mean(by_key[condition.name, AFTER, q].against_unchanged)
                        for q in QUANTITIES
                    ),
                )
                for condition in (kept, fixed)
            ],
        )
        yield ""
        yield from repair(by_key, kept, fixed, len(ways))
    yield ""
    yield f"in brackets: 95 % intervals, {text.of_means(len(ways), 'way')}; errors are rms"
