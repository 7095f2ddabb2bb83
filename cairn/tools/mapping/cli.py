"""`cairn map`: builds maps from recordings, saves live ones; the rest is the map builder's."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cairn import CairnError
from cairn.cli.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.cli.output import line, note, print_json
from cairn.client import connect as connect_to
from cairn.components.map_builder.cli import app, parse_mount, prepare
from cairn.components.replay.mrclam import MrclamRecording
from cairn.components.replay.open_recording import open_recording
from cairn.planar.map_file import write_map

if TYPE_CHECKING:
    from cairn.tools.mapping.build import BuiltMap, Progress

__all__ = ["app"]


class Base(StrEnum):
    """What odometry holds."""

    MEASURED = "measured"
    COMMANDED = "commanded"


@app.command()
def build(
    recording: Annotated[
        Path,
        typer.Argument(
            metavar="RECORDING",
            help="CARMEN log, ROS 1 bag, ROS 2 bag's folder, MCAP file or MRCLAM folder.",
        ),
    ],
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="Name of the map's files, without their endings.")
    ],
    extend: Annotated[
        Path | None,
        typer.Option(metavar="GRAPH", help="Graph of an earlier map that is extended."),
    ] = None,
    scanner: Annotated[
        str,
        typer.Option(
            metavar="X,Y,THETA",
            help="Pose of the scanner on the robot [m, rad].",
            show_default="as the recording says, else 0,0,0",
        ),
    ] = "",
    robot: Annotated[
        int | None, typer.Option(min=1, max=5, help="Robot of an MRCLAM data set.")
    ] = None,
    base: Annotated[
        Base | None,
        typer.Option(
            help="What odometry holds: what wheels measured, or the commanded velocities.",
            show_default="measured; commanded for MRCLAM",
        ),
    ] = None,
    scan: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="Topic of scans, if a bag has several.")
    ] = None,
    odom: Annotated[
        str | None, typer.Option(metavar="TOPIC", help="Topic of odometry, if a bag has several.")
    ] = None,
    scan_only: Annotated[
        bool, typer.Option("--scan-only", help="Use no odometry: for a robot that moves slowly.")
    ] = False,
    resolution: Annotated[
        float, typer.Option(min=0.01, max=1.0, help="Size of the grid map's cells [m].")
    ] = 0.05,
    reach: Annotated[
        float, typer.Option(min=0.5, help="Longer rays only show free space [m].")
    ] = 20.0,
    force: Annotated[bool, typer.Option("--force", help="Replace the map's files.")] = False,
    json: Json = False,
) -> None:
    """Build a map from a recording of odometry with scans, recognized objects, or both: SLAM.

    Writes OUT.yaml and OUT.pgm (grid map, if there are scans), OUT.cairn (visual map, if there are
    objects), OUT.graph (from which mapping can continue), OUT.tum (pose of the robot's base at each
    scan) and OUT.png (a picture).
    """
    from cairn.components.slam.graph_file import read_graph, write_graph
    from cairn.components.slam.landmarks import write_landmarks
    from cairn.components.slam.mapping import MEASURED
    from cairn.tools.mapping.build import COMMANDED, BuildSettings, build_map, write_trajectory
    from cairn.tools.mapping.picture import draw_built_map

    files = {ending: out.with_name(out.name + ending) for ending in _ENDINGS}
    existing = [file for file in files.values() if file.exists()]
    if existing and not force:
        raise CairnError(
            f"{existing[0]} exists already. Give another name, or --force to replace it."
        )
    named = {"scan": scan, "odom": odom}
    topics = {kind: topic for kind, topic in named.items() if topic is not None}
    opened = open_recording(recording, robot, topics)
    for text in opened.notes():
        note(f"{recording}: {text}")
    if base is None:
        base = Base.COMMANDED if isinstance(opened, MrclamRecording) else Base.MEASURED
    settings = BuildSettings(
        mount=parse_mount(scanner) if scanner else None,
        scan_only=scan_only,
        model=COMMANDED if base is Base.COMMANDED else MEASURED,
        resolution=resolution,
        reach=reach,
    )
    mapper = None
    if extend is not None:
        mapper = read_graph(extend)
        mapper.resume(here=False)
    with _shown_progress() as progress:
        built = build_map(opened, str(recording), settings, progress, mapper)
    for file in files.values():
        prepare(file)
        file.unlink(missing_ok=True)
    source = f"built from {recording.name}"
    if built.grid is not None:
        write_map(files[".yaml"], built.grid)
    if built.landmarks.landmarks:
        write_landmarks(files[".cairn"], source, built.landmarks.landmarks)
    write_graph(files[".graph"], built.mapper, source)
    write_trajectory(files[".tum"], built.stamps, built.poses)
    draw_built_map(built, f"{out.name}: map of {recording.name}", files[".png"])
    _print_result(built, [file for file in files.values() if file.exists()], json)
    if built.hint:
        note(built.hint)


@app.command()
def save(
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="Name of the map's files, without their endings.")
    ],
    force: Annotated[bool, typer.Option("--force", help="Replace the map's files.")] = False,
    json: Json = False,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Save the map that a robot is making: the deployment `mapping`.

    Writes OUT.yaml and OUT.pgm (grid map), and OUT.graph (from which mapping can continue). The
    robot goes on mapping.
    """
    from cairn.tools.mapping.live import print_saved, save_map

    with connect_to(connect, domain, robot, notify=note) as client:
        print_saved(save_map(client, out, force=force), as_json=json)


_ENDINGS = (".yaml", ".pgm", ".cairn", ".graph", ".tum", ".png")


def _print_result(built: BuiltMap, files: list[Path], as_json: bool) -> None:
    quality, landmarks = built.quality, built.landmarks
    width, height = built.grid.size_m if built.grid is not None else (0.0, 0.0)
    if as_json:
        written: dict[str, Any] = {"files": [str(file) for file in files]}
        objects = {
            "landmarks": len(landmarks.landmarks),
            "moved": [one.object_id for one in landmarks.moved],
            "uncertain": list(landmarks.uncertain),
            "sightings": landmarks.sightings,
            "outliers": landmarks.outliers,
        }
        print_json({**written, "width_m": width, "height_m": height, **asdict(quality), **objects})
        return
    if built.grid is None:
        line(f"{files[0]}: {quality.driven_m:.0f} m driven, without scans")
    else:
        cell = built.grid.frame.resolution
        line(f"{files[0]}: {width:.1f} m x {height:.1f} m, cells of {cell:g} m")
        line(f"  scans      {quality.scans}, of which {quality.keyframes} are in the map; "
             f"{quality.driven_m:.0f} m driven")  # fmt: skip
        if quality.left_out:
            line(f"  left out   {quality.left_out} scans: no place that they show was recognized")
        line(f"  fit        {quality.fit:.2f} of 1")
        line(f"  loops      {quality.loops} closed, {quality.loops_rejected} rejected; they differ "
             f"by {quality.loop_error_m:.3f} m, {quality.loop_error_deg:.2f} deg")  # fmt: skip
        line(f"  entropy    {quality.entropy_bit:.3f} bit per known cell")
        line(f"  conflicts  {100 * quality.conflicts:.0f} % of the cells that rays hit are free "
             "for most")  # fmt: skip
    if landmarks.sightings:
        line(f"  landmarks  {len(landmarks.landmarks)} from {landmarks.sightings} sightings, of "
             f"which {landmarks.outliers} contradict them")  # fmt: skip
    for moved in landmarks.moved:
        line(f"  moved      object {moved.object_id}: from ({moved.old[0]:.2f}, "
             f"{moved.old[1]:.2f}) m to ({moved.new[0]:.2f}, {moved.new[1]:.2f}) m")  # fmt: skip
    if landmarks.uncertain:
        line(f"  uncertain  {', '.join(map(str, landmarks.uncertain))}: seen too rarely")
    line(f"also written: {', '.join(file.name for file in files[1:])}")


@contextmanager
def _shown_progress() -> Iterator[Progress]:
    """Show the progress on the terminal, if stderr is one."""
    from rich.console import Console
    from rich.progress import Progress as Bars

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda _stage, _share: None
        return
    with Bars(console=console, transient=True) as bars:
        tasks: dict[str, Any] = {}

        def report(stage: str, share: float) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=1.0)
            bars.update(tasks[stage], completed=share)

        yield report
