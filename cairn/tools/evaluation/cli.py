"""`cairn evaluate navigation`: many runs in lockstep, and what came of them."""

from __future__ import annotations

import os
from json import dumps
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from cairn import CairnError
from cairn.cli.options import Json
from cairn.cli.output import line, note, print_json
from cairn.cli.runs import seeds_of, worker_pool, writing_report
from cairn.deployment.shipped import FOLDER, deployment_file, world_file
from cairn.planar.map_file import read_map
from cairn.tools.evaluation.pictures import draw_tracks, draw_ways
from cairn.tools.evaluation.report import report_lines
from cairn.tools.evaluation.results import GoalResult, RunResult, Summary, summed_up
from cairn.tools.evaluation.runs import Trial, examination, run_trial
from cairn.tools.evaluation.surveying import robot_start, scripted_events, survey

app = typer.Typer(help="Evaluate what the robot does, by many runs.", no_args_is_help=True)


@app.callback()
def _evaluate() -> None:
    """Evaluate what the robot does, by many runs."""


@app.command()
def navigation(
    world: Annotated[
        Path,
        typer.Option(
            help="World file, or the name of a world that Cairn ships.", parser=world_file
        ),
    ],
    goals: Annotated[int, typer.Option(min=1, help="Random goals of each run.")] = 10,
    seeds: Annotated[str, typer.Option(help="Seeds A..B, one run each.")] = "0..19",
    kidnap: Annotated[
        bool, typer.Option("--kidnap", help="Carry the robot off once in each run.")
    ] = False,
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
        int, typer.Option(min=0, help="Runs at a time; 0: as many as there are processors.")
    ] = 0,
    json: Json = False,
) -> None:
    """Send a simulated robot to random goals, in lockstep, and report how it did.

    Ends with status 1 if a goal was not reached, anything was hit, or a run failed.
    """
    numbers = seeds_of(seeds)
    if not os.access(deployment, os.R_OK):
        raise CairnError(
            f"{deployment}: no such deployment, or none that can be read; name yours with "
            "--deployment FILE"
        )
    map_file = (out / "surveyed.yaml").absolute()
    visual_map = map_file.with_suffix(".cairn")
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
        survey(world, map_file, visual_map)
    runs = _run(trials, logs, workers or os.cpu_count() or 1, quiet=json)
    summary = summed_up(runs, events)
    with writing_report(out):
        _write(out, map_file, runs, summary)
    if json:
        print_json({"world": str(world), "summary": summary.model_dump(mode="json")})
    else:
        for told in report_lines(world.name, runs, summary):
            line(told)
        line(f"report: {out}/runs.json, {out}/tracks.png, {out}/ways.png, {out}/logs")
    if summary.reached < summary.goals or summary.collisions or summary.failed:
        raise typer.Exit(1)


def _run(trials: list[Trial], logs: Path, workers: int, *, quiet: bool) -> list[RunResult]:
    runs: list[RunResult] = []
    with (
        TemporaryDirectory(prefix="cairn-evaluation-") as scratch,
        worker_pool(min(workers, len(trials))) as pool,
    ):
        begun = [pool.submit(run_trial, trial, scratch, logs) for trial in trials]
        for trial, future in zip(trials, begun, strict=True):
            try:
                run = future.result()
            except Exception as error:  # whatever it is, the other runs are not to be lost
                told = str(error) if isinstance(error, CairnError) else repr(error)
                run = RunResult(seed=trial.seed, failure=told)
            runs.append(run)
            if not quiet:
                reached = sum(goal.reached for goal in run.goals)
                failed = f", failed: {run.failure}" if run.failure else ""
                note(
                    f"seed {run.seed}: {reached} of {len(run.goals)} goals, "
                    f"{len(run.collisions)} collisions{failed}"
                )
    return runs


def _write(out: Path, map_file: Path, runs: list[RunResult], summary: Summary) -> None:
    grid = read_map(map_file)
    draw_tracks(grid, runs, out / "tracks.png")
    draw_ways(runs, out / "ways.png")
    about = {
        model.__name__: {
            name: field.description
            for name, field in model.model_fields.items()
            if field.description
        }
        for model in (Summary, RunResult, GoalResult)
    }
    body = ",\n".join(run.model_dump_json() for run in runs)
    text = (
        f'{{"summary": {summary.model_dump_json()},\n"about": {dumps(about)},\n'
        f'"runs": [\n{body}\n]}}\n'
    )
    (out / "runs.json").write_text(text, encoding="utf-8")
