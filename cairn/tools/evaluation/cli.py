"""`cairn evaluate navigation`: many lockstep runs of a simulated robot, and a report of them."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from cairn import CairnError
from cairn.cli.options import Json
from cairn.cli.output import line, note, print_json
from cairn.cli.runs import seeds_of, writing_report
from cairn.cli.worker_pool import worker_pool
from cairn.deployment.shipped import FOLDER, deployment_file, world_file
from cairn.planar.map_file import read_map
from cairn.tools.evaluation.report import report_lines, write_report
from cairn.tools.evaluation.results import RunResult, summarize
from cairn.tools.evaluation.runs import (
    Trial,
    align,
    examination,
    robot_start,
    run_trial,
    scripted_events,
    survey,
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
    workers: Annotated[
        int, typer.Option(min=0, help="Number of parallel runs; 0: one per processor.")
    ] = 0,
    json: Json = False,
) -> None:
    """Send a simulated robot to random goals, in lockstep, and report the results.

    Exits with status 1 if a goal was not reached, the robot collided, or a run failed.
    """
    numbers = seeds_of(seeds)
    if not os.access(deployment, os.R_OK):
        raise CairnError(
            f"{deployment}: there is no such deployment, or it cannot be read; name yours with "
            "--deployment FILE"
        )
    surveyed = (out / "surveyed.yaml").absolute()
    map_file = surveyed if map_ is None else (out / "map.yaml").absolute()
    visual_map = surveyed.with_suffix(".cairn")
    start = robot_start(world)
    trials = [
        Trial(
            deployment=deployment.absolute(),
            world=world.absolute(),
            map_file=map_file,
            visual_map=visual_map,
            start=start,
            goals=goals,
            seed=seed,
            kidnap_at=(goals + 1) // 2 if kidnap else 0,
            sets=tuple(set_ or ()),
        )
        for seed in numbers
    ]
    with TemporaryDirectory(prefix="cairn-evaluation-") as scratch:
        folder = Path(scratch)
        examined = examination(trials[0], folder, folder / "result.json")
    events = scripted_events(world, examined)
    logs = (out / "logs").absolute()
    with writing_report(out):
        logs.mkdir(parents=True, exist_ok=True)
        survey(world, surveyed, visual_map)
        if map_ is not None:
            note(align(map_, world, map_file))
    runs = _run(trials, logs, workers or os.cpu_count() or 1, quiet=json)
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


def _run(trials: list[Trial], logs: Path, workers: int, *, quiet: bool) -> list[RunResult]:
    runs: list[RunResult] = []
    with (
        TemporaryDirectory(prefix="cairn-evaluation-") as scratch,
        worker_pool(min(workers, len(trials))) as pool,
    ):
        futures = [pool.submit(run_trial, trial, scratch, logs) for trial in trials]
        for trial, future in zip(trials, futures, strict=True):
            try:
                run = future.result()
            except Exception as error:  # any failure: the results of the other runs are kept
                failure = str(error) if isinstance(error, CairnError) else repr(error)
                run = RunResult(seed=trial.seed, failure=failure)
            runs.append(run)
            if not quiet:
                reached = sum(goal.reached for goal in run.goals)
                failed = f", failed: {run.failure}" if run.failure else ""
                note(
                    f"seed {run.seed}: {reached} of {len(run.goals)} goals, "
                    f"{len(run.collisions)} collisions{failed}"
                )
    return runs
