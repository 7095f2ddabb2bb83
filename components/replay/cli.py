"""`cairn recording`: shows what a recording holds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from cairn.cli.options import Json
from cairn.cli.output import line, note, print_json, show
from cairn.components.replay.contents import contents_of
from cairn.components.replay.formats import open_recording
from cairn.components.replay.pictures import draw_recording

app = typer.Typer(help="Recordings: what they hold, as a table and a picture.")

_COLUMNS = {
    "replayed_as": "replayed as",
    "topic": "topic",
    "type": "type",
    "count": "count",
    "span_s": "span [s]",
    "rate_hz": "rate [Hz]",
}


@app.callback(no_args_is_help=True)
def _recording() -> None:
    """Recordings: what they hold, as a table and a picture."""


@app.command("show")
def show_recording(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="ROS 1 bag, ROS 2 bag's folder, MCAP file, CARMEN log, MRCLAM folder, video, or "
            "folder of images.",
        ),
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="PICTURE", help="Draw it: PNG, PDF or SVG.")
    ] = None,
    robot: Annotated[
        int | None, typer.Option(min=1, max=5, help="Robot of an MRCLAM data set.")
    ] = None,
    scan: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="Scans, if a bag has several such topics.")
    ] = None,
    odom: Annotated[str | None, typer.Option(metavar="TOPIC", help="Odometry, the same.")] = None,
    truth: Annotated[str | None, typer.Option(metavar="TOPIC", help="A bag's true poses.")] = None,
    image_rate: Annotated[
        float | None,
        typer.Option(min=0.01, max=1000, help="Images per second, where nothing tells [Hz]."),
    ] = None,
    json: Json = False,
) -> None:
    """Show what is recorded: its streams, the scanner, and a picture of scans and way."""
    named = {"scan": scan, "odom": odom, "truth": truth}
    topics = {kind: topic for kind, topic in named.items() if topic is not None}
    recording = open_recording(file, robot, topics, image_rate_hz=image_rate)
    contents = contents_of(recording)
    if json:
        print_json(contents)
    else:
        show(contents["streams"], _COLUMNS, as_json=False)
        line(f"scanner: {_described(contents['scanner'])}")
        line(f"odometry: {'yes' if contents['odometry'] else 'none'}")
        line(f"true poses: {'yes' if contents['true_poses'] else 'none'}")
        for told in contents["notes"]:
            note(f"{file}: {told}")
    if out is not None:
        draw_recording(recording, file.name, out)
        note(f"{out} written")


def _described(scanner: dict[str, Any] | None) -> str:
    if scanner is None:
        return "none"
    return (
        f"{scanner['last_deg'] - scanner['first_deg']:.1f} deg "
        f"({scanner['first_deg']:.1f} to {scanner['last_deg']:.1f}), "
        f"{scanner['beams']} beams of {scanner['increment_deg']:.3f} deg, "
        f"{scanner['range_min_m']:g} to {scanner['range_max_m']:g} m"
    )
