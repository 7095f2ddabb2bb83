"""`cairn evaluate navigation`: many runs in lockstep, and what came of them."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from cairn.cli.connection import Json
from cairn.cli.tables import line, note, print_json
from cairn.errors import CairnError
from components.evaluation.pictures import draw_tracks, draw_ways
from components.evaluation.results import RunResult, Summary, summed_up
from components.evaluation.runs import Trial, run_trial
from planar.map_file import read_map

app = typer.Typer(help="Evaluate what the robot does, by many runs.", no_args_is_help=True)


@app.callback()
def _evaluate() -> None:
    """Evaluate what the robot does, by many runs."""


@app.command()
def navigation(
    world: Annotated[Path, typer.Option(help="World file: deploy/worlds/*.yaml or your own.")],
    goals: Annotated[int, typer.Option(min=1, help="Random goals of each run.")] = 10,
    seeds: Annotated[str, typer.Option(help="Seeds A..B, one run each.")] = "0..19",
    kidnap: Annotated[
        bool, typer.Option("--kidnap", help="Carry the robot off once in each run.")
    ] = False,
    out: Annotated[Path, typer.Option(help="Folder for the report.")] = Path("evaluation"),
    deployment: Annotated[Path, typer.Option(help="The deployment that is run.")] = Path(
        "deploy/sim.yaml"
    ),
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

    Ends with status 1 if a goal was not reached or anything was hit.
    """
    numbers = _seeds(seeds)
    out.mkdir(parents=True, exist_ok=True)
    map_file = _surveyed(world, out)
    trials = [
        Trial(
            deployment=deployment.absolute(),
            world=world.absolute(),
            map_file=map_file,
            visual_map=map_file.with_suffix(".cairn"),
            goals=goals,
            seed=seed,
            kidnap_at=(goals + 1) // 2 if kidnap else 0,
            sets=tuple(set_ or ()),
        )
        for seed in numbers
    ]
    runs = _run(trials, workers or os.cpu_count() or 1, quiet=json)
    summary = summed_up(runs)
    _write(out, map_file, runs, summary)
    if json:
        print_json({"world": str(world), "summary": summary.model_dump(mode="json")})
    else:
        _show(world, runs, summary)
        line(f"report: {out}/runs.json, {out}/tracks.png, {out}/ways.png")
    if summary.reached < summary.goals or summary.collisions:
        raise typer.Exit(1)


def _seeds(text: str) -> range:
    first, dots, last = text.partition("..")
    try:
        begin = int(first)
        end = int(last) if dots else begin
    except ValueError:
        raise CairnError(f"--seeds {text}: write it as A..B, such as 0..19") from None
    if not 0 <= begin <= end:
        raise CairnError(f"--seeds {text}: A must not be negative nor larger than B")
    return range(begin, end + 1)


def _surveyed(world: Path, out: Path) -> Path:
    """The maps of the world as it stands at the beginning, made by their importers."""
    map_file = (out / "surveyed.yaml").absolute()
    for file in (map_file, map_file.with_suffix(".cairn")):
        command = [sys.executable, "-P", "-m", "cairn.cli.main", "map", "import", "world"]
        done = subprocess.run(
            [*command, str(world), str(file), "--force"],
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        if done.returncode != 0:
            raise CairnError(done.stderr.strip().removeprefix("cairn: "))
    return map_file


def _run(trials: list[Trial], workers: int, *, quiet: bool) -> list[RunResult]:
    runs: list[RunResult] = []
    with (
        TemporaryDirectory(prefix="cairn-evaluation-") as scratch,
        ProcessPoolExecutor(min(workers, len(trials)), mp_context=get_context("spawn")) as pool,
    ):
        for run in pool.map(run_trial, trials, [scratch] * len(trials)):
            runs.append(run)
            if not quiet:
                reached = sum(goal.reached for goal in run.goals)
                note(
                    f"seed {run.seed}: {reached} of {len(run.goals)} goals, "
                    f"{len(run.collisions)} collisions"
                )
    return runs


def _write(out: Path, map_file: Path, runs: list[RunResult], summary: Summary) -> None:
    grid = read_map(map_file)
    draw_tracks(grid, runs, out / "tracks.png")
    draw_ways(runs, out / "ways.png")
    body = ",\n".join(run.model_dump_json() for run in runs)
    text = f'{{"summary": {summary.model_dump_json()},\n"runs": [\n{body}\n]}}\n'
    (out / "runs.json").write_text(text, encoding="utf-8")


def _show(world: Path, runs: list[RunResult], summary: Summary) -> None:
    for run in runs:
        for number, goal in enumerate(run.goals, start=1):
            if not goal.reached:
                line(
                    f"seed {run.seed}, goal {number} at ({goal.x:.2f}, {goal.y:.2f}) not reached: "
                    f"{goal.reason}"
                )
        for collision in run.collisions:
            line(f"seed {run.seed}, collision: {collision}")
    line(f"{world.name}: {summary.runs} runs")
    line(f"  reached           {summary.reached} of {summary.goals}, {summary.reached_share:.1%}")
    if summary.kidnapped:
        line(f"  carried off       arrived {summary.kidnapped_reached} of {summary.kidnapped}")
    line(f"  collisions        {summary.collisions}")
    if summary.path_ratio_mean is not None and summary.path_ratio_p95 is not None:
        line(
            f"  way / shortest    {summary.path_ratio_mean:.3f} on average, "
            f"{summary.path_ratio_p95:.3f} at most in 95 %"
        )
    if summary.seconds_mean is not None:
        line(f"  time a goal       {summary.seconds_mean:.1f} s")
    line(f"  recoveries        {summary.recoveries}")
    if summary.error_median is not None and summary.error_p95 is not None:
        line(
            f"  position error    {summary.error_median:.3f} m median, "
            f"{summary.error_p95:.3f} m in 95 %"
        )
    if summary.within is not None:
        one, two, three = summary.within
        line(f"  truth within      {one:.0%}, {two:.0%}, {three:.0%} in 1, 2, 3 sigma")
