"""What all experiments do alike: run, read again what was written down, and judge it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from cairn.cli.output import note
from cairn.tools.experiments.judging import RunResult, judged_pair, judged_world
from cairn.tools.experiments.pairs import WORLD, series_file
from cairn.tools.experiments.report_folder import ReportFolder
from cairn.tools.experiments.runs import Job, run_all
from cairn.tools.experiments.series import PairSeries, WorldSeries, read_pair, read_world


@dataclass(frozen=True)
class Observed:
    """A run that was done: what was true, what each pair told by its method, and the judgment."""

    job: Job
    world: WorldSeries
    pairs: Mapping[str, PairSeries]
    result: RunResult


def observed(
    jobs: Sequence[Job], folder: ReportFolder, workers: int, changed_at: float, *, quiet: bool
) -> tuple[list[Observed], dict[str, str]]:
    """Run all and read what was written down; and why runs failed, by their names.

    A run that failed counts for nothing.
    """
    out = folder.path
    done = 0

    def tell(job: Job, failure: str) -> None:
        nonlocal done
        done += 1
        if not quiet:
            what = f"failed: {failure}" if failure else "done"
            note(f"{done} of {len(jobs)}: {job.called(out)} {what}")

    failures = run_all(jobs, workers, tell)
    runs: list[Observed] = []
    failed: dict[str, str] = {}
    for job, failure in zip(jobs, failures, strict=True):
        if failure:
            failed[job.called(out)] = failure
            continue
        run = _read(job, changed_at)
        lacking = _lacking(run)
        if lacking:
            failed[job.called(out)] = lacking
        else:
            runs.append(run)
    return runs, failed


def _lacking(run: Observed) -> str:
    """Why a run that was finished has nothing to tell; "" if it has."""
    if not run.result.sightings:
        return (
            "no object was recognized in all of the run; if it is from pixels, see that the "
            "visual map holds the objects' pictures (cairn object list): `cairn map import "
            "world` makes one that does, for --set visual_map=FILE"
        )
    if run.job.moves and not run.world.moves:
        return (
            f"nothing was moved at {run.result.changed_at:g} s: the world refused it (see the "
            "run's log.txt), the tour was over before, or no event moves an object; change the "
            "events of the world"
        )
    return ""


def _read(job: Job, changed_at: float) -> Observed:
    world = read_world(series_file(job.folder, WORLD))
    pairs = {m.name: read_pair(series_file(job.folder, m.name)) for m in job.plan.methods}
    result = judged_world(job.seed, world, changed_at)
    judged = [judged_pair(name, pair, world, changed_at) for name, pair in pairs.items()]
    return Observed(job, world, pairs, result.model_copy(update={"pairs": judged}))
