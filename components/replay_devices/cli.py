"""`cairn recording`: shows what a recording holds, as a table and a drawing, and tools on it.

What reads images or draws is imported where it is used: those libraries may not be installed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from cairn import SECOND
from cairn.components.replay_devices.record_times import quality_text
from cairn.components.replay_devices.recorded_frames import read_frames
from cairn.components.replay_devices.recording import (
    Recording,
    ScannerMount,
    poses_at,
)
from cairn.components.replay_devices.scanner_mount import FrameLink
from cairn.planar.mount_estimation import MountYaw, estimate_mount_yaw
from cairn.planar.poses import wrap
from cairn.recording import commands
from cairn.recording.mcap_file import holds_mcap
from cairn.recording.reader import McapRecording
from cairn.schemas.sensor_msgs import LaserScan
from cairn.terminal.options import Json
from cairn.terminal.output import line, note, print_json, show

_CLEARLY_RAD = math.radians(5.0)  # a mount that is off by less is not worth a hint

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

    A whole MCAP file of any size takes little time, because only its index is read, and for the
    scanner's mount the messages about the robot's frames. One that was not closed, because the
    recorder was killed, is read as a whole. Of other recordings it shows what `cairn recording
    show` does: also how good the times are.
    """
    if holds_mcap(file):
        commands.info(file, json, details_of)
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
    """Show the streams of a recording, its scanner and mount, and how good its times are.

    With --out, draw its scans and path.
    """
    from cairn.components.replay_devices.open_recording import open_recording

    named = {"scan": scan, "odom": odom, "truth": truth}
    topics = {kind: topic for kind, topic in named.items() if topic is not None}
    recording = open_recording(file, robot, topics, image_rate_hz=image_rate)
    contents = contents_of(recording)
    if json:
        print_json(contents)
    else:
        show(contents["streams"], _COLUMNS, as_json=False)
        line(f"scanner: {_scanner_text(contents['scanner'])}")
        if contents["scanner"] is not None:
            line(f"mount: {_mount_text(contents['mount'])}")
        if contents["yaw_by_motion"] is not None:
            line(f"yaw by motion: {_yaw_text(contents['yaw_by_motion'])}")
        line(f"odometry: {'yes' if contents['odometry'] else 'none'}")
        line(f"true poses: {'yes' if contents['true_poses'] else 'none'}")
        for kind, text in contents["times"].items():
            line(f"times of {kind}: {text['summary']}")
        for text in contents["notes"]:
            note(f"{file}: {text}")
    if out is not None:
        from cairn.components.replay_devices.drawing import draw_recording

        draw_recording(recording, file.name, out)
        note(f"{out} written")


def details_of(recording: McapRecording) -> commands.Details:
    """Return scanner, mount and frames of an MCAP recording, as a map is built with them."""
    frames = read_frames(recording)
    scanner = None if frames.scan is None else _scanner_row(frames.scan)
    mount = None if frames.mount is None else _mount_row(frames.mount)
    lines = []
    if frames.scan_topic:
        lines = [
            f"scanner: {_scanner_text(scanner)}, frame {frames.scanner} on {frames.scan_topic}",
            f"mount: {_mount_text(mount) if mount else 'neither in tf_static nor described'}",
        ]
    odometry = None
    if frames.odometry is not None:
        odometry = {"frame": frames.odometry[0], "in": frames.odometry[1]}
        lines.append(f"odometry: frame {odometry['frame']} in {odometry['in']}")
    links = [_link_row(link) for link in frames.links]
    if links:
        lines.append(f"frames: {', '.join(_link_text(link) for link in links)}")
    values = {"scanner": scanner, "mount": mount, "odometry": odometry, "frames": links}
    return commands.Details(values, lines, frames.notes)


def _link_row(link: FrameLink) -> dict[str, Any]:
    x, y, z = link.matrix[:3, 3].tolist()
    return {"frame": link.child, "on": link.parent, "x_m": x, "y_m": y, "z_m": z,
            "source": link.source}  # fmt: skip


def _link_text(link: dict[str, Any]) -> str:
    return f"{link['frame']} on {link['on']} ({link['x_m']:g}, {link['y_m']:g}, {link['z_m']:g}) m"


def _scanner_text(scanner: dict[str, Any] | None) -> str:
    if scanner is None:
        return "none"
    return (
        f"{scanner['last_deg'] - scanner['first_deg']:.1f} deg "
        f"({scanner['first_deg']:.1f} to {scanner['last_deg']:.1f}), "
        f"{scanner['beams']} beams of {scanner['increment_deg']:.3f} deg, "
        f"{scanner['range_min_m']:g} to {scanner['range_max_m']:g} m"
    )


def _mount_text(mount: dict[str, Any] | None) -> str:
    if mount is None:
        return "not in the recording"
    turned = ", upside down" if mount["upside_down"] else ""
    return (
        f"x {mount['x_m']:.3f} m, y {mount['y_m']:.3f} m, yaw {mount['yaw_deg']:.1f} deg{turned} "
        f"on {mount['base']}, by {mount['source']}"
    )


def _yaw_text(estimate: dict[str, float]) -> str:
    return f"{estimate['yaw_deg']:.1f} deg, standard deviation {estimate['deviation_deg']:.1f} deg"


def contents_of(recording: Recording) -> dict[str, Any]:
    """Return streams, the scanner and its mount, quality of times, and notes.

    A note says if the robot's motion contradicts the mount.
    """
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
    mount = recording.mount()
    estimate = _yaw_by_motion(recording)
    notes = list(recording.notes())
    if estimate is not None and (contradiction := _contradiction(mount, estimate)):
        notes.append(contradiction)
    return {
        "streams": rows,
        "scanner": _scanner(recording),
        "mount": None if mount is None else _mount_row(mount),
        "yaw_by_motion": None if estimate is None else _yaw_row(estimate),
        "odometry": streams["odom"] is not None,
        "true_poses": streams["truth"] is not None,
        "times": {
            kind: {**asdict(quality), "summary": quality_text(quality)}
            for kind, quality in recording.time_quality().items()
        },
        "notes": notes,
    }


def _mount_row(mount: ScannerMount) -> dict[str, Any]:
    x, y, yaw = mount.pose
    return {
        "x_m": x,
        "y_m": y,
        "yaw_deg": math.degrees(yaw),
        "upside_down": mount.upside_down,
        "base": mount.base,
        "source": mount.source,
    }


def _yaw_row(estimate: MountYaw) -> dict[str, float]:
    return {
        "yaw_deg": math.degrees(estimate.yaw),
        "deviation_deg": math.degrees(estimate.deviation),
    }


def _yaw_by_motion(recording: Recording) -> MountYaw | None:
    """Return the scanner's yaw by scans and odometry; None if these do not determine it."""
    scans, odometry = recording.scans(), recording.odometry()
    if scans is None or odometry is None:
        return None
    first, last = odometry.stamps[0], odometry.stamps[-1]
    chosen = [k for k, stamp in enumerate(scans.stamps) if first <= stamp <= last]
    poses = poses_at(odometry, [scans.stamps[k] for k in chosen])
    return estimate_mount_yaw([scans.messages[k] for k in chosen], poses)


def _contradiction(mount: ScannerMount | None, estimate: MountYaw) -> str | None:
    """Return a hint if the yaw by motion is clearly another one than the mount's, or than 0."""
    known = 0.0 if mount is None else mount.pose[2]
    if abs(wrap(estimate.yaw - known)) < max(_CLEARLY_RAD, 3.0 * estimate.deviation):
        return None
    assumed = (
        "0 deg, which is assumed without a mount"
        if mount is None
        else (f"{math.degrees(known):.1f} deg, as by {mount.source}")
    )
    return (
        f"the robot's motion shows that the scanner's yaw is {_yaw_text(_yaw_row(estimate))}, and "
        f"not {assumed}: check the mount before you replay or map this recording"
    )


def _timing(stamps: Sequence[int]) -> dict[str, float | None]:
    span = (stamps[-1] - stamps[0]) / SECOND if stamps else 0.0
    return {"span_s": span, "rate_hz": (len(stamps) - 1) / span if span > 0 else None}


def _scanner(recording: Recording) -> dict[str, Any] | None:
    """Return the scanner as its first scan describes it."""
    scans = recording.scans()
    return None if scans is None else _scanner_row(scans.messages[0])


def _scanner_row(scan: LaserScan) -> dict[str, Any]:
    return {
        "beams": int(scan.ranges.size),
        "first_deg": math.degrees(scan.angle_min),
        "last_deg": math.degrees(scan.angle_min + scan.angle_increment * (scan.ranges.size - 1)),
        "increment_deg": math.degrees(scan.angle_increment),
        "range_min_m": float(scan.range_min),
        "range_max_m": float(scan.range_max),
    }
