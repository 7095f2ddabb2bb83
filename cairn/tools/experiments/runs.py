"""Runs an experiment: many runs in parallel, in lockstep; reads their series and judges them."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from cairn import CairnError
from cairn.cli.output import note
from cairn.cli.runs import log_file
from cairn.cli.worker_pool import worker_pool
from cairn.placement.lockstep import LockstepRun
from cairn.tools.experiments.methods import (
    WORLD,
    ExperimentSetup,
    experiment_deployment,
    series_file,
)
from cairn.tools.experiments.report_folder import ReportFolder
from cairn.tools.experiments.results import ExperimentRunResult, judge_method, judge_run
from cairn.tools.experiments.series import MethodSeries, WorldSeries, read_method, read_world


@dataclass(frozen=True)
class RunSpec:
    """One run: its setup, its seed, and the folder of its series and its log.

    `moves`: an object is to be moved in it.
    """

    setup: ExperimentSetup
    seed: int
    folder: Path
    moves: bool

    def name(self, out: Path) -> str:
        """Return its name in the report whose folder is `out`."""
        return str(self.folder.relative_to(out))


@dataclass(frozen=True)
class FinishedRun:
    """A run that has finished: the ground truth, the series of each method, and the results."""

    spec: RunSpec
    world: WorldSeries
    methods: Mapping[str, MethodSeries]
    result: ExperimentRunResult


def check_setup(setup: ExperimentSetup) -> None:
    """Raise `CairnError` if the setup cannot be run, before many runs of it are started."""
    with TemporaryDirectory(prefix="cairn-experiment-") as scratch:
        experiment_deployment(setup, Path(scratch), Path(scratch))


def run_experiment(
    specs: Sequence[RunSpec], folder: ReportFolder, workers: int, changed_at: float, *, quiet: bool
) -> tuple[list[FinishedRun], dict[str, str]]:
    """Run all; return the runs that succeeded, and the reasons of those that failed, by name.

    A failed run counts for nothing.
    """
    out = folder.path
    done = 0

    def report_progress(spec: RunSpec, failure: str) -> None:
        nonlocal done
        done += 1
        if not quiet:
            end = f"failed: {failure}" if failure else "done"
            note(f"{done} of {len(specs)}: {spec.name(out)} {end}")

    failures = _run_all(specs, workers, report_progress)
    runs: list[FinishedRun] = []
    failed: dict[str, str] = {}
    for spec, failure in zip(specs, failures, strict=True):
        if failure:
            failed[spec.name(out)] = failure
            continue
        run = _read(spec, changed_at)
        problem = _problem(run)
        if problem:
            failed[spec.name(out)] = problem
        else:
            runs.append(run)
    return runs, failed


def _run_all(
    specs: Sequence[RunSpec], workers: int, on_end: Callable[[RunSpec, str], None]
) -> list[str]:
    """Run all and return why each failed, "" if it did not; call `on_end` at the end of each."""
    failures = [""] * len(specs)
    count = min(workers or os.cpu_count() or 1, len(specs))
    with worker_pool(count) as pool:
        futures = {pool.submit(_run, spec): number for number, spec in enumerate(specs)}
        for future in as_completed(futures):
            number = futures[future]
            try:
                failures[number] = future.result()
            except Exception as error:  # any failure: the results of the other runs are kept
                failures[number] = str(error) if isinstance(error, CairnError) else repr(error)
            on_end(specs[number], failures[number])
    return failures


def _run(spec: RunSpec) -> str:
    """Run one; return why the robot did not succeed, "" if it did.

    Raises `CairnError` if the deployment fails.
    """
    spec.folder.mkdir(parents=True, exist_ok=True)
    logging.getLogger("cairn").propagate = False  # failures are in the run's log and its result
    with TemporaryDirectory(prefix="cairn-experiment-") as scratch:
        deployment = experiment_deployment(spec.setup, spec.folder, Path(scratch))
        run = LockstepRun(deployment, spec.seed)
        with log_file(spec.folder / "log.txt", run.executor.now):
            end = run.run(lambda: None)
    if not end.normal:
        raise CairnError(end.reason)
    return "" if end.success else end.reason


def _read(spec: RunSpec, changed_at: float) -> FinishedRun:
    world = read_world(series_file(spec.folder, WORLD))
    methods = {m.name: read_method(series_file(spec.folder, m.name)) for m in spec.setup.methods}
    result = judge_run(spec.seed, world, changed_at)
    judged = [judge_method(name, series, world, changed_at) for name, series in methods.items()]
    return FinishedRun(spec, world, methods, result.model_copy(update={"methods": judged}))


def _problem(run: FinishedRun) -> str:
    """Return why a run that has finished shows nothing; "" if it does."""
    if not run.result.observations:
        return (
            "no object was recognized in the whole run; if it is from pixels, check that the "
            "visual map holds the objects' models (cairn object list): `cairn map import world` "
            "makes one that does, for --set visual_map=FILE"
        )
    if run.spec.moves and not run.world.moves:
        return (
            f"nothing was moved at {run.result.changed_at:g} s: the world rejected the event (see "
            "the run's log.txt), the tour had ended before, or no event moves an object; change "
            "the events of the world"
        )
    return ""
