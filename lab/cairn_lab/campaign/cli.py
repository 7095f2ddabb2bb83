"""`cairn campaign FILE`: drive a deployment for long while faults are injected."""

from __future__ import annotations

import signal
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Final

import typer

from cairn.deployment.shipped import file_or_shipped
from cairn.errors import CairnError
from cairn.system.signal_handlers import signal_handlers
from cairn.terminal.output import line
from cairn_lab.campaign.model import Campaign, read_campaign
from cairn_lab.campaign.plan import planned_faults
from cairn_lab.campaign.report import TEXT_NAME
from cairn_lab.campaign.runner import run_campaign

_FOLDER: Final = Path(__file__).parents[1] / "campaigns"


def campaign_file(name: str) -> Path:
    """Return the file of that path, or else the shipped campaign of that name.

    Raises `CairnError` if `name` is not a path and nothing of that name is shipped.
    """
    return file_or_shipped(
        name, _FOLDER, "campaign", sorted(f.stem for f in _FOLDER.glob("*.yaml"))
    )


def campaign(
    file: Annotated[
        Path,
        typer.Argument(
            help="Campaign file, or the name of a campaign that Cairn ships: `devices`, `growth`, "
            "`machines` or `sim`.",
            metavar="FILE",
            parser=campaign_file,
        ),
    ],
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of the faults, in place of that of the file.")
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(min=1, help="End after this time [s], in place of the file's end."),
    ] = None,
    faults: Annotated[
        int | None,
        typer.Option(min=0, help="End after this many faults, in place of the file's end."),
    ] = None,
    interval: Annotated[
        float | None,
        typer.Option(min=0.01, help="Mean time between faults [s], in place of that of the file."),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(help="Folder for the report; by default campaign-TIME in this folder."),
    ] = None,
    plan: Annotated[
        bool, typer.Option("--plan", help="Print the faults of this seed, and run nothing.")
    ] = False,
    stop_on_violation: Annotated[
        bool, typer.Option("--stop-on-violation", help="End with the first violation.")
    ] = False,
) -> None:
    """Run a deployment for long while faults are injected; check that its invariants hold.

    Kinds, times and targets of the faults are drawn by a seed: the same seed draws the same ones.
    Ctrl-C ends the campaign early: all faults are undone, the deployment is stopped, and the report
    is written. Exit status 0 if no invariant was violated, 1 if one was.
    """
    read = _changed(read_campaign(file), seed, duration, faults, interval)
    if plan:
        for planned in planned_faults(read):
            line(f"{planned.at_s:9.1f} s  fault {planned.number}: {planned.kind}")
        return
    folder = report or Path(f"campaign-{datetime.now(UTC):%Y%m%d-%H%M%S}")
    received: list[int] = []
    with signal_handlers(
        (signal.SIGINT, signal.SIGTERM, signal.SIGHUP), lambda number, _: received.append(number)
    ):
        result = run_campaign(
            read,
            file.absolute().parent,
            folder.absolute(),
            name=file.stem,
            show=line,
            is_interrupted=lambda: bool(received),
            stop_on_violation=stop_on_violation,
        )
    line("")
    for name, value in result.summary():
        line(f"{name + ':':<12} {value}")
    line(f"report: {folder / TEXT_NAME}")
    if result.violations:
        raise CairnError(f"campaign {file.stem}: {len(result.violations)} violations; see {folder}")


def _changed(
    campaign: Campaign,
    seed: int | None,
    duration: float | None,
    faults: int | None,
    interval: float | None,
) -> Campaign:
    """Return the campaign with the values that options replace."""
    changes: dict[str, object] = {}
    if seed is not None:
        changes["seed"] = seed
    if interval is not None:
        changes["interval_s"] = interval
    if duration is not None or faults is not None:
        changes |= {"duration_s": duration, "count": faults}
    return campaign.model_copy(update=changes)
