"""`cairn experiment`: the commands of the paper's experiments, and their options."""

from __future__ import annotations

import os
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from cairn import CairnError
from cairn.deployment.shipped import FOLDER, deployment_file
from cairn.terminal.options import Json
from cairn.terminal.output import line, print_json
from cairn_lab.batch.options import BatchOptions, CacheFolder, NoCache, On, WorkerCount, seeds_of
from cairn_lab.experiments.ablation import AblationOptions, run_ablation
from cairn_lab.experiments.map_update import run_map_update
from cairn_lab.experiments.methods import ABLATION, OURS, PAPER, ExperimentSetup, Method
from cairn_lab.experiments.uncertainty import UNCERTAINTY, run_uncertainty

_DEPLOYMENT, _OVERLAY = FOLDER / "sim.yaml", FOLDER / "experiment.yaml"


class RecognitionDriver(StrEnum):
    """The kinds of simulated object recognition."""

    pixels = "pixels"
    geometric = "geometric"


Seeds = Annotated[str, typer.Option(help="Seeds A..B, one or two runs each.")]
Out = Annotated[
    Path,
    typer.Option(
        help="Folder for the report: a new or empty one, or one with an earlier report of the same "
        "command, which is replaced together with its runs and pictures."
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", help="Change a value of the deployment: path=value.", metavar="SET"),
]
DeploymentFile = Annotated[
    Path,
    typer.Option(help="The deployment to run, by file or by shipped name.", parser=deployment_file),
]
Overlay = Annotated[
    Path,
    typer.Option(
        help="Overlay with the tour, the scanner and the changes of the world. With --driver "
        "pixels the file pixels.yaml in the same folder is added."
    ),
]
DriverOption = Annotated[
    RecognitionDriver,
    typer.Option(
        help="pixels: a simulated stereo camera and the object recognizer; geometric: "
        "observations computed by geometry, many times faster."
    ),
]

app = typer.Typer(help="Run the experiments of the paper.", no_args_is_help=True)


@app.callback()
def _experiment() -> None:
    """Run the experiments of the paper, in lockstep, many runs each."""


@app.command()
def uncertainty(
    driver: DriverOption = RecognitionDriver.pixels,
    seeds: Seeds = "0..29",
    out: Out = Path("uncertainty"),
    deployment: DeploymentFile = _DEPLOYMENT,
    overlay: Overlay = _OVERLAY,
    set_: Set = None,
    workers: WorkerCount = 0,
    on: On = "",
    cache: CacheFolder = None,
    no_cache: NoCache = False,
    json: Json = False,
) -> None:
    """Measure how a change of the room affects the pose, with and without a map update (figure 9).

    The robot follows the same path twice for each seed, driven by scans alone: in the unchanged
    room, and in a room in which an object is moved. Exits with status 1 if a run failed.
    """
    batch = BatchOptions(workers, on, cache, no_cache)
    setup = _setup(deployment, overlay, driver, set_, None, UNCERTAINTY)
    _report(
        *run_uncertainty(setup, seeds_of(seeds), out.absolute(), batch, quiet=json),
        out=out,
        json=json,
    )


@app.command()
def map_update(
    driver: DriverOption = RecognitionDriver.pixels,
    seeds: Seeds = "0..29",
    out: Out = Path("map-update"),
    deployment: DeploymentFile = _DEPLOYMENT,
    overlay: Overlay = _OVERLAY,
    set_: Set = None,
    workers: WorkerCount = 0,
    on: On = "",
    cache: CacheFolder = None,
    no_cache: NoCache = False,
    json: Json = False,
) -> None:
    """Move an object while the robot drives, and report how it repairs its map (figure 10).

    Exits with status 1 if a run failed.
    """
    batch = BatchOptions(workers, on, cache, no_cache)
    setup = _setup(deployment, overlay, driver, set_, OURS, (PAPER,))
    _report(
        *run_map_update(setup, seeds_of(seeds), out.absolute(), batch, quiet=json),
        out=out,
        json=json,
    )


@app.command()
def ablation(
    moved: Annotated[
        int, typer.Option(min=0, max=1000, help="Number of objects moved in each run.")
    ] = 1,
    move_distance: Annotated[
        float | None,
        typer.Option(
            min=0.05, max=1000, help="Distance of the moves [m]; default: any of at least 0.6 m."
        ),
    ] = None,
    at: Annotated[float, typer.Option(min=1, max=1e5, help="Time of the changes [s].")] = 62.0,
    kidnap: Annotated[
        bool, typer.Option("--kidnap", help="Kidnap the robot at the same time.")
    ] = False,
    false_matches: Annotated[
        float | None,
        typer.Option(
            min=0,
            max=1,
            help="Share of observations that are false matches; geometric driver only.",
        ),
    ] = None,
    scanner_range: Annotated[
        float | None, typer.Option(min=0.3, max=30, help="Range of the scanner [m].")
    ] = None,
    driver: DriverOption = RecognitionDriver.pixels,
    seeds: Seeds = "0..29",
    out: Out = Path("ablation"),
    deployment: DeploymentFile = _DEPLOYMENT,
    overlay: Overlay = _OVERLAY,
    set_: Set = None,
    workers: WorkerCount = 0,
    on: On = "",
    cache: CacheFolder = None,
    no_cache: NoCache = False,
    json: Json = False,
) -> None:
    """Compare the paper's rule, ours and others on the same data, in one table.

    Exits with status 1 if a run failed.
    """
    if false_matches is not None and driver is not RecognitionDriver.geometric:
        raise CairnError(
            "--false-matches is a parameter of the geometric driver, the rate from pixels cannot "
            "be chosen; add --driver geometric"
        )
    options = AblationOptions(moved, move_distance, at, kidnap, scanner_range, false_matches)
    others = tuple(method for method in ABLATION if method is not OURS)
    sets = [*options.sets(), *(set_ or ())]
    batch = BatchOptions(workers, on, cache, no_cache)
    setup = _setup(deployment, overlay, driver, sets, OURS, others)
    _report(
        *run_ablation(setup, options, seeds_of(seeds), out.absolute(), batch, quiet=json),
        out=out,
        json=json,
    )


def _setup(
    deployment: Path,
    overlay: Path,
    driver: RecognitionDriver,
    sets: list[str] | None,
    driving: Method | None,
    shadows: tuple[Method, ...],
) -> ExperimentSetup:
    overlays = [overlay]
    if driver is RecognitionDriver.pixels:
        overlays.append(overlay.with_name("pixels.yaml"))
    _check_readable(deployment, "--deployment")
    for file in overlays:
        _check_readable(file, "--overlay")
    files = tuple(file.absolute() for file in overlays)
    return ExperimentSetup(deployment.absolute(), files, tuple(sets or ()), driving, shadows)


def _check_readable(file: Path, option: str) -> None:
    if not os.access(file, os.R_OK):
        raise CairnError(
            f"{file}: there is no such deployment, or it cannot be read; name yours with {option} "
            "FILE"
        )


def _report(
    lines: list[str], body: dict[str, Any], succeeded: bool, *, out: Path, json: bool
) -> None:
    if json:
        print_json(body)
    else:
        for text in lines:
            line(text)
        line(f"report: {out}/report.txt, {out}/report.json and pictures")
    if not succeeded:
        raise typer.Exit(1)
