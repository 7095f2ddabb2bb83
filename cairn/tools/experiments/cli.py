"""`cairn experiment`: the experiments of the paper."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from cairn import CairnError
from cairn.cli.options import Json
from cairn.cli.output import line, print_json
from cairn.cli.runs import seeds_of
from cairn.tools.experiments.ablation import Ask, run_ablation
from cairn.tools.experiments.map_update import run_map_update
from cairn.tools.experiments.methods import ABLATION, OURS, PAPER, Method
from cairn.tools.experiments.options import (
    DEPLOYMENT,
    OVERLAY,
    DeploymentFile,
    Driver,
    DriverOption,
    Out,
    Overlay,
    Seeds,
    Set,
    Workers,
    overlays,
    refuse_unreadable,
)
from cairn.tools.experiments.pairs import Plan
from cairn.tools.experiments.uncertainty import UNCERTAINTY, run_uncertainty

app = typer.Typer(help="Run the experiments of the paper.", no_args_is_help=True)


@app.callback()
def _experiment() -> None:
    """Run the experiments of the paper, in lockstep, many runs each."""


@app.command()
def uncertainty(
    driver: DriverOption = Driver.pixels,
    seeds: Seeds = "0..29",
    out: Out = Path("uncertainty"),
    deployment: DeploymentFile = DEPLOYMENT,
    overlay: Overlay = OVERLAY,
    set_: Set = None,
    workers: Workers = 0,
    json: Json = False,
) -> None:
    """Show what a change of the room does to the pose, with and without an update (figure 9).

    Each seed is a way, driven by scans alone, in the room as it is and in the room in which
    something is moved. Ends with status 1 if a run failed.
    """
    plan = _plan(deployment, overlay, driver, set_, None, UNCERTAINTY)
    numbers = seeds_of(seeds)
    _tell(*run_uncertainty(plan, numbers, out.absolute(), workers, quiet=json), out=out, json=json)


@app.command()
def map_update(
    driver: DriverOption = Driver.pixels,
    seeds: Seeds = "0..29",
    out: Out = Path("map-update"),
    deployment: DeploymentFile = DEPLOYMENT,
    overlay: Overlay = OVERLAY,
    set_: Set = None,
    workers: Workers = 0,
    json: Json = False,
) -> None:
    """Move an object while the robot drives, and show how it repairs its map (figure 10).

    Ends with status 1 if a run failed.
    """
    plan = _plan(deployment, overlay, driver, set_, OURS, (PAPER,))
    numbers = seeds_of(seeds)
    _tell(*run_map_update(plan, numbers, out.absolute(), workers, quiet=json), out=out, json=json)


@app.command()
def ablation(
    moved: Annotated[int, typer.Option(min=0, max=1000, help="Objects moved in each run.")] = 1,
    move_distance: Annotated[
        float | None,
        typer.Option(min=0.05, max=1000, help="How far [m]; else anywhere, 0.6 m at least."),
    ] = None,
    at: Annotated[
        float, typer.Option(min=1, max=1e5, help="When something is changed [s].")
    ] = 62.0,
    kidnap: Annotated[
        bool, typer.Option("--kidnap", help="Carry the robot off at the same time.")
    ] = False,
    false_matches: Annotated[
        float | None,
        typer.Option(min=0, max=1, help="Share of mistaken sightings; geometric driver only."),
    ] = None,
    scanner_range: Annotated[
        float | None, typer.Option(min=0.3, max=30, help="How far the scanner sees [m].")
    ] = None,
    driver: DriverOption = Driver.pixels,
    seeds: Seeds = "0..29",
    out: Out = Path("ablation"),
    deployment: DeploymentFile = DEPLOYMENT,
    overlay: Overlay = OVERLAY,
    set_: Set = None,
    workers: Workers = 0,
    json: Json = False,
) -> None:
    """Compare the paper's rule, ours and others on the same data, in one table.

    Ends with status 1 if a run failed.
    """
    if false_matches is not None and driver is not Driver.geometric:
        raise CairnError(
            "--false-matches is a parameter of the geometric driver: from pixels their rate is "
            "what it is; add --driver geometric"
        )
    ask = Ask(moved, move_distance, at, kidnap, scanner_range, false_matches)
    others = tuple(method for method in ABLATION if method is not OURS)
    plan = _plan(deployment, overlay, driver, [*ask.sets(), *(set_ or ())], OURS, others)
    numbers = seeds_of(seeds)
    _tell(
        *run_ablation(plan, ask, numbers, out.absolute(), workers, quiet=json), out=out, json=json
    )


def _plan(
    deployment: Path,
    overlay: Path,
    driver: Driver,
    sets: list[str] | None,
    driving: Method | None,
    shadows: tuple[Method, ...],
) -> Plan:
    over = overlays(overlay, driver)
    refuse_unreadable(deployment, over)
    files = tuple(file.absolute() for file in over)
    return Plan(deployment.absolute(), files, tuple(sets or ()), driving, shadows)


def _tell(lines: list[str], body: dict[str, Any], done: bool, *, out: Path, json: bool) -> None:
    if json:
        print_json(body)
    else:
        for told in lines:
            line(told)
        line(f"report: {out}/report.txt, {out}/report.json and pictures")
    if not done:
        raise typer.Exit(1)
