"""`cairn recording`: shows what a recording holds, as a table and a drawing, and tools on it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cairn import SECOND
from cairn.cli.options import Json
from cairn.cli.output import line, note, print_json, show
from cairn.components.replay.open_recording import open_recording
from cairn.components.replay.recording import OdometryStream, Recording, ScanStream
from cairn.errors import RecordingError
from cairn.planar.poses import Pose
from cairn.planar.scans import beams_of
from cairn.recording import commands
from cairn.recording.mcap_file import holds_mcap

app = typer.Typer(help="Recordings: what they hold; cut, merge and export them.")

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
    """Recordings: what they hold; cut, merge and export them."""


@app.command("info")
def info_of_recording(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="MCAP file, or a folder with the files of one run; or any other recording, as for "
            "`cairn recording show`.",
        ),
    ],
    json: Json = False,
) -> None:
    """Show the topics in a recording, its span, and its attached files.

    A whole MCAP file of any size takes no time, because only its index is read. One that was not
    closed, because the recorder was killed, is read as a whole.
    """
    if holds_mcap(file):
        commands.info(file, json)
    else:
        show_recording(file, json=json)


app.command("cut")(commands.cut)
app.command("merge")(commands.merge)
app.command("export")(commands.export)


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
        Path | None, typer.Option(metavar="FILE", help="Draw it to a PNG, PDF or SVG file.")
    ] = None,
    robot: Annotated[
        int | None, typer.Option(min=1, max=5, help="Robot of an MRCLAM data set.")
    ] = None,
    scan: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="Topic of scans, if a bag has several.")
    ] = None,
    odom: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="Topic of odometry, if a bag has several.")
    ] = None,
    truth: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="Topic of true poses in a bag.")
    ] = None,
    image_rate: Annotated[
        float | None,
        typer.Option(min=0.01, max=1000, help="Images per second, if not recorded [Hz]."),
    ] = None,
    json: Json = False,
) -> None:
    """Show the streams of a recording and its scanner, and draw its scans and path."""
    named = {"scan": scan, "odom": odom, "truth": truth}
    topics = {kind: topic for kind, topic in named.items() if topic is not None}
    recording = open_recording(file, robot, topics, image_rate_hz=image_rate)
    contents = contents_of(recording)
    if json:
        print_json(contents)
    else:
        show(contents["streams"], _COLUMNS, as_json=False)
        line(f"scanner: {_scanner_text(contents['scanner'])}")
        line(f"odometry: {'yes' if contents['odometry'] else 'none'}")
        line(f"true poses: {'yes' if contents['true_poses'] else 'none'}")
        for text in contents["notes"]:
            note(f"{file}: {text}")
    if out is not None:
        draw_recording(recording, file.name, out)
        note(f"{out} written")


def _scanner_text(scanner: dict[str, Any] | None) -> str:
    if scanner is None:
        return "none"
    return (
        f"{scanner['last_deg'] - scanner['first_deg']:.1f} deg "
        f"({scanner['first_deg']:.1f} to {scanner['last_deg']:.1f}), "
        f"{scanner['beams']} beams of {scanner['increment_deg']:.3f} deg, "
        f"{scanner['range_min_m']:g} to {scanner['range_max_m']:g} m"
    )


def contents_of(recording: Recording) -> dict[str, Any]:
    """Return streams, the scanner, whether there are odometry and true poses, and notes."""
    streams = {
        "scan": recording.scans(),
        "odom": recording.odometry(),
        "objects": recording.observations(),
        "truth": recording.truth(),
        "images": recording.images(),
    }
    rows = []
    for topic in recording.topics():
        stream = streams.get(topic.kind or "")
        timing = _timing(stream.stamps) if stream is not None else {"span_s": None, "rate_hz": None}
        rows.append(
            {
                "replayed_as": topic.kind,
                "topic": topic.topic,
                "type": topic.type,
                "count": topic.count,
                **timing,
            }
        )
    return {
        "streams": rows,
        "scanner": _scanner(recording),
        "odometry": streams["odom"] is not None,
        "true_poses": streams["truth"] is not None,
        "notes": list(recording.notes()),
    }


def _timing(stamps: Sequence[int]) -> dict[str, float | None]:
    span = (stamps[-1] - stamps[0]) / SECOND if stamps else 0.0
    return {"span_s": span, "rate_hz": (len(stamps) - 1) / span if span > 0 else None}


def _scanner(recording: Recording) -> dict[str, Any] | None:
    """Return the scanner as its first scan describes it."""
    scans = recording.scans()
    if scans is None:
        return None
    scan = scans.messages[0]
    return {
        "beams": int(scan.ranges.size),
        "first_deg": math.degrees(scan.angle_min),
        "last_deg": math.degrees(scan.angle_min + scan.angle_increment * (scan.ranges.size - 1)),
        "increment_deg": math.degrees(scan.angle_increment),
        "range_min_m": float(scan.range_min),
        "range_max_m": float(scan.range_max),
    }


Array = NDArray[np.float64]

_SINGLE_SCANS, _MAPPED_SCANS = 4, 400  # drawn separately, and together as a map
_COLORS = ("tab:blue", "tab:orange", "tab:green", "tab:red")
_AT_SCANNER: Pose = (0.0, 0.0, 0.0)


def rough_map(scans: ScanStream, odometry: OdometryStream) -> Array:
    """Return points (n, 2) [m] that evenly chosen scans hit, in the frame of the odometry."""
    points = [np.zeros((0, 2))]
    for number in _chosen(len(scans.stamps), _MAPPED_SCANS):
        stamp = scans.stamps[number]
        if odometry.stamps[0] <= stamp <= odometry.stamps[-1]:
            scan_points = beams_of(scans.messages[number], _AT_SCANNER).points()
            points.append(_transform(scan_points, _pose_at(odometry, stamp)))
    return np.concatenate(points)


def draw_recording(recording: Recording, title: str, file: Path) -> None:
    """Draw scans in the scanner's frame, and with odometry, scans and path in its frame.

    The scanner is assumed at the robot's origin: a recording does not hold its mount.
    """
    scans, odometry = recording.scans(), recording.odometry()
    if scans is None and odometry is None:
        raise RecordingError(
            f"{title} holds neither scans nor odometry: there is nothing to draw; view its "
            "images instead"
        )
    panels = (scans is not None) + (odometry is not None)
    figure = Figure(figsize=(7.5 * panels, 7.5), layout="constrained")
    axes = list(np.atleast_1d(figure.subplots(1, panels)))
    if scans is not None:
        _draw_scans(axes[0], scans)
    if odometry is not None:
        _draw_track(axes[-1], scans, odometry)
    for panel in axes:
        panel.set_aspect("equal", adjustable="datalim")
        panel.set_xlabel("x [m]")
        panel.set_ylabel("y [m]")
        panel.grid(alpha=0.25)
        panel.legend(loc="best", fontsize=8)
    figure.suptitle(title)
    try:
        # Without the software's name and the date, the same recording gives the same file.
        figure.savefig(file, dpi=110, metadata={"Software": None} if file.suffix == ".png" else {})
    except (OSError, ValueError) as error:
        raise RecordingError(f"{file} cannot be written: {error}") from error


def _draw_scans(axes: Axes, scans: ScanStream) -> None:
    for number, color in zip(_chosen(len(scans.stamps), _SINGLE_SCANS), _COLORS, strict=False):
        points = beams_of(scans.messages[number], _AT_SCANNER).points()
        seconds = (scans.stamps[number] - scans.stamps[0]) / SECOND
        axes.plot(*points.T, ".", color=color, markersize=3, label=f"scan at {seconds:.1f} s")
    axes.plot(0, 0, marker=(3, 0, -90), color="black", markersize=10, label="the scanner")
    axes.set_title("Scans in the scanner's frame")


def _draw_track(axes: Axes, scans: ScanStream | None, odometry: OdometryStream) -> None:
    if scans is not None:
        axes.plot(*rough_map(scans, odometry).T, ",", color="#505050", alpha=0.5)
    x, y, _ = odometry.poses.T
    axes.plot(x, y, color="tab:blue", linewidth=1.2, label="path by odometry")
    axes.plot(x[0], y[0], "o", color="tab:green", markersize=7, label="start")
    axes.plot(x[-1], y[-1], "s", color="tab:red", markersize=7, label="end")
    axes.set_title("By odometry: " + ("scans and path" if scans is not None else "path"))


def _chosen(count: int, most: int) -> list[int]:
    """Return at most `most` evenly spaced indices of a series, the first and last included."""
    return sorted({round(k) for k in np.linspace(0, count - 1, min(count, most)).tolist()})


def _pose_at(odometry: OdometryStream, stamp: int) -> Array:
    """Return the interpolated pose at a time; the heading is not wrapped."""
    after = min(max(int(np.searchsorted(odometry.stamps, stamp)), 1), len(odometry.stamps) - 1)
    pair = [after - 1, after] if after else [0, 0]
    poses = odometry.poses[pair]
    poses[:, 2] = np.unwrap(poses[:, 2])
    first, last = (odometry.stamps[k] for k in pair)
    share = (stamp - first) / (last - first) if last > first else 0.0
    pose: Array = poses[0] + share * (poses[1] - poses[0])
    return pose


def _transform(points: Array, pose: Array) -> Array:
    x, y, theta = pose
    cosine, sine = np.cos(theta), np.sin(theta)
    transformed: Array = points @ np.array([[cosine, sine], [-sine, cosine]]) + (x, y)
    return transformed
