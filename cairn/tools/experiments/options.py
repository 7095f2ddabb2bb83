"""What all experiments may be told on the command line."""

from __future__ import annotations

import os
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from cairn import CairnError
from cairn.deployment.shipped import FOLDER, deployment_file

Seeds = Annotated[str, typer.Option(help="Seeds A..B, a run or two each.")]
Out = Annotated[
    Path,
    typer.Option(
        help="Folder for the report: one that is new or empty, or holds an earlier report of the "
        "same command, which is replaced with its runs and pictures."
    ),
]
Workers = Annotated[
    int, typer.Option(min=0, help="Runs at a time; 0: as many as there are processors.")
]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", help="Change a value of the deployment: path=value.", metavar="SET"),
]
DeploymentFile = Annotated[
    Path,
    typer.Option(
        help="The robot's deployment, by file or by shipped name.", parser=deployment_file
    ),
]
Overlay = Annotated[
    Path,
    typer.Option(
        help="What is laid over it: tour, scanner, and what is moved. With --driver pixels the "
        "pixels.yaml beside it is laid over it, too."
    ),
]
DEPLOYMENT, OVERLAY = FOLDER / "sim.yaml", FOLDER / "experiment.yaml"


class Driver(StrEnum):
    """Who recognizes objects."""

    pixels = "pixels"
    geometric = "geometric"


DriverOption = Annotated[
    Driver,
    typer.Option(
        help="pixels: a simulated stereo camera and the object recognizer; geometric: what a "
        "recognizer would tell, by geometry, many times faster."
    ),
]


def overlays(overlay: Path, driver: Driver) -> tuple[Path, ...]:
    """The files that are laid over the deployment."""
    if driver is Driver.geometric:
        return (overlay,)
    return (overlay, overlay.with_name(f"{driver}.yaml"))


def refuse_unreadable(deployment: Path, over: tuple[Path, ...]) -> None:
    """`CairnError` if the deployment or what is laid over it cannot be read."""
    for file, option in ((deployment, "--deployment"), *((one, "--overlay") for one in over)):
        if not os.access(file, os.R_OK):
            raise CairnError(
                f"{file}: no such deployment, or none that can be read; name yours with "
                f"{option} FILE"
            )
