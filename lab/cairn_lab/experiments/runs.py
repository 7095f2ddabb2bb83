"""Runs an experiment: many runs in parallel, in lockstep; reads their series and judges them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from cairn.cli.run_folders import writing_report
from cairn.terminal.output import note
from cairn_lab.batch.options import BatchOptions
from cairn_lab.batch.packing import pack_deployment
from cairn_lab.batch.runner import Batch, Outcome
from cairn_lab.batch.task import LOG, PackedDeployment, Task
from cairn_lab.experiments.methods import (
    WORLD,
    ExperimentSetup,
    experiment_deployment,
    series_file,
)
from cairn_lab.experiments.report_folder import ReportFolder
from cairn_lab.experiments.results import ExperimentRunResult, judge_method, judge_run
from cairn_lab.experiments.series import MethodSeries, WorldSeries, read_method, read_world

_SERIES = "series"  # apart from the files of the deployment, such as the state of its world


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
    specs: Sequence[RunSpec],
    folder: ReportFolder,
    options: BatchOptions,
    changed_at: float,
    *,
    quiet: bool,
) -> tuple[list[FinishedRun], dict[str, str]]:
    """Run all; return the runs that succeeded, and the reasons of those that failed, by name.

    A failed run counts for nothing.
    """
    tasks = _tasks(specs, folder.path)
    done = 0

    def receive(number: int, outcome: Outcome) -> str:
        nonlocal done
        done += 1
        with writing_report(folder.path):
            failure = _write(specs[number], tasks[number], outcome)
        if not quiet:
            end = f"failed: {failure}" if failure else "done"
            note(f"{done} of {len(specs)}: {tasks[number].name} {end}")
        return failure

    workers, cache = options.open_workers(len(tasks)), options.open_cache()
    failures = Batch(tasks, workers, cache, receive).run()
    runs: list[FinishedRun] = []
    failed: dict[str, str] = {}
    for spec, task, failure in zip(specs, tasks, failures, strict=True):
        if failure:
            failed[task.name] = failure
            continue
        run = _read(spec, changed_at)
        problem = _problem(run)
        if problem:
            failed[task.name] = problem
        else:
            runs.append(run)
    return runs, failed


def _tasks(specs: Sequence[RunSpec], out: Path) -> list[Task]:
    """Return the task of each run; a setup that differs by its events alone is packed once."""
    known: list[tuple[ExperimentSetup, PackedDeployment]] = []
    tasks = []
    for spec in specs:
        setup, events = replace(spec.setup, events=None), spec.setup.events
        packed = next((packed for other, packed in known if other == setup), None)
        if packed is None:
            with TemporaryDirectory(prefix="cairn-experiment-") as scratch:
                report = Path(scratch)
                deployment = experiment_deployment(setup, report / _SERIES, report)
                packed = pack_deployment(deployment, report)
            known.append((setup, packed))
        changes = {} if events is None else {WORLD: {"events": list(events)}}
        outputs = tuple(f"{_SERIES}/{file.name}" for file in _series_files(spec))
        tasks.append(Task(spec.name(out), packed, spec.seed, outputs, changes))
    return tasks


def _series_files(spec: RunSpec) -> Iterator[Path]:
    yield series_file(spec.folder, WORLD)
    for method in spec.setup.methods:
        yield series_file(spec.folder, method.name)


def _write(spec: RunSpec, task: Task, outcome: Outcome) -> str:
    """Write the log and the series of a run; return why it failed, "" if it did not."""
    spec.folder.mkdir(parents=True, exist_ok=True)
    result = outcome.result
    if result is None:
        return task.packed.with_origins(outcome.failure)
    for name, content in result.files.items():
        (spec.folder / Path(name).name).write_bytes(content)
    log = task.packed.with_origins(result.files.get(LOG, b"").decode(errors="replace"))
    (spec.folder / LOG).write_text(log, encoding="utf-8")
    succeeded = result.normal and result.success and not outcome.failure
    return "" if succeeded else task.packed.with_origins(outcome.failure or result.reason)


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
