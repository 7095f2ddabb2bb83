"""`cairn evaluate navigation`: many lockstep runs of a simulated robot, and a report of them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from cairn import CairnError
from cairn.cli.run_folders import writing_report
from cairn.deployment.shipped import FOLDER, deployment_file, world_file
from cairn.planar.map_file import read_map
from cairn.terminal.options import Json
from cairn.terminal.output import line, note, print_json
from cairn_lab.batch.cache import ResultCache
from cairn_lab.batch.options import BatchOptions, CacheFolder, NoCache, On, WorkerCount, seeds_of
from cairn_lab.batch.runner import Batch, Outcome
from cairn_lab.batch.task import LOG, Task
from cairn_lab.batch.workers import Workers
from cairn_lab.evaluation.report import report_lines, write_report
from cairn_lab.evaluation.results import RunResult, summarize
from cairn_lab.evaluation.runs import (
    Trial,
    align,
    examination,
    robot_start,
    run_result,
    scripted_events,
    survey,
    trial_tasks,
)

app = typer.Typer(help="Evaluate the robot over many simulated runs.", no_args_is_help=True)


@app.callback()
def _evaluate() -> None:
    """Evaluate the robot over many simulated runs."""


@app.command()
def navigation(
    world: Annotated[
        Path,
        typer.Option(
            help="World file, or the name of a world that Cairn ships.", parser=world_file
        ),
    ],
    goals: Annotated[int, typer.Option(min=1, help="Number of random goals per run.")] = 10,
    seeds: Annotated[str, typer.Option(help="Seeds A..B, one run each.")] = "0..19",
    kidnap: Annotated[
        bool, typer.Option("--kidnap", help="Kidnap the robot once in each run.")
    ] = False,
    map_: Annotated[
        Path | None,
        typer.Option(
            "--map",
            metavar="FILE",
            help="The robot's grid map, such as one that it has made: its frame is about that of "
            "the world, or of the robot at its start. By default the true map.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the report.")] = Path("evaluation"),
    deployment: Annotated[
        Path,
        typer.Option(
            help="The deployment to run, by file or by shipped name.", parser=deployment_file
        ),
    ] = FOLDER / "sim.yaml",
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", help="Change a value of the deployment: path=value.", metavar="SET"),
    ] = None,
    workers: WorkerCount = 0,
    on: On = "",
    cache: CacheFolder = None,
    no_cache: NoCache = False,
    json: Json = False,
) -> None:
    """Send a simulated robot to random goals, in lockstep, and report the results.

    Exits with status 1 if a goal was not reached, the robot collided, or a run failed.
    """
    numbers = seeds_of(seeds)
    options = BatchOptions(workers, on, cache, no_cache)
    chosen_workers = options.open_workers(len(numbers))
    if not os.access(deployment, os.R_OK):
        raise CairnError(
            f"{deployment}: there is no such deployment, or it cannot be read; name yours with "
            "--deployment FILE"
        )
    surveyed = (out / "surveyed.yaml").absolute()
    map_file = surveyed if map_ is None else (out / "map.yaml").absolute()
    visual_map = surveyed.with_suffix(".cairn")
    start = robot_start(world)
    trial = Trial(
        deployment=deployment.absolute(),
        world=world.absolute(),
        map_file=map_file,
        visual_map=visual_map,
        start=start,
        goals=goals,
        kidnap_at=(goals + 1) // 2 if kidnap else 0,
        sets=tuple(set_ or ()),
    )
    with TemporaryDirectory(prefix="cairn-evaluation-") as scratch:
        folder = Path(scratch)
        examined = examination(trial, folder)
        events = scripted_events(world, examined)
        results = options.open_cache()
        logs = (out / "logs").absolute()
        with writing_report(out):
            logs.mkdir(parents=True, exist_ok=True)
            survey(world, surveyed, visual_map)
            if map_ is not None:
                note(align(map_, world, map_file))
        tasks = trial_tasks(examined, folder, numbers)
    runs = _run(tasks, logs, chosen_workers, results, quiet=json)
    summary = summarize(runs, events)
    with writing_report(out):
        write_report(out, read_map(map_file), runs, summary)
    if json:
        print_json({"world": str(world), "summary": summary.model_dump(mode="json")})
    else:
        for text in report_lines(world.name, runs, summary):
            line(text)
        line(f"report: {out}/runs.json, {out}/tracks.png, {out}/paths.png, {out}/logs")
    if summary.reached < summary.goals or summary.collisions or summary.failed:
        raise typer.Exit(1)


def _run(
    tasks: Sequence[Task], logs: Path, workers: Workers, cache: ResultCache | None, *, quiet: bool
) -> list[RunResult]:
    following: dict[int, RunResult] = {}
    noted = 0

    def receive(number: int, outcome: Outcome) -> RunResult:
        nonlocal noted
        task = tasks[number]
        run = run_result(task, outcome)
        if outcome.result is not None:
            log = outcome.result.files.get(LOG, b"").decode(errors="replace")
            with writing_report(logs.parent):
                file = logs / f"seed-{task.seed}.log"
                file.write_text(task.packed.with_origins(log), encoding="utf-8")
        following[number] = run
        while noted in following:  # in the order of the seeds
            following_run = following.pop(noted)
            noted += 1
            if not quiet:
                _note(following_run)
        return run

    return Batch(tasks, workers, cache, receive).run()


def _note(run: RunResult) -> None:
    reached = sum(goal.reached for goal in run.goals)
    failed = f", failed: {run.failure}" if run.failure else ""
    note(
        f"seed {run.seed}: {reached} of {len(run.goals)} goals, "
        f"{len(run.collisions)} collisions{failed}"
    )
