"""`cairn map`: builds maps from recordings, saves live ones; the rest is the map builder's."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from cairn import CairnError
from cairn.client import connect as connect_to
from cairn.components.map_builder.cli import app, parse_mount
from cairn.components.replay_devices.mrclam import MrclamRecording
from cairn.components.replay_devices.open_recording import open_recording
from cairn.planar.map_file import write_map
from cairn.system.files import replacing_together
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.terminal.output import line, note, print_json
from cairn.tools.mapping.history_cli import history, rollback
from cairn.tools.mapping.target import map_files

if TYPE_CHECKING:
    from cairn.components.slam.mapping import Progress
    from cairn.tools.mapping.build import BuiltMap

__all__ = ["app"]

MapName = Annotated[
    Path, typer.Argument(metavar="OUT", help="Name of the map's files, or of one of them.")
]
Force = Annotated[bool, typer.Option("--force", help="Replace the map's files.")]


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
    out: MapName,
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
    force: Force = False,
    json: Json = False,
) -> None:
    """Build a map from a recording of odometry with scans, recognized objects, or both: SLAM.

    Writes OUT.yaml and OUT.pgm (grid map, if there are scans), OUT.cairn (visual map, if there are
    objects), OUT.graph (from which mapping can continue), OUT.tum (pose of the robot's base at each
    scan) and OUT.png (a picture).
    """
    from cairn.components.slam.graph_file import read_graph, write_graph
    from cairn.components.slam.landmarks import write_landmarks
    from cairn.planar.motion_model import COMMANDED, MEASURED
    from cairn.tools.mapping.build import BuildSettings, build_map, write_trajectory
    from cairn.tools.mapping.picture import draw_built_map

    files = map_files(out, _ENDINGS, force=force)
    mount = parse_mount(scanner) if scanner else None
    named = {"scan": scan, "odom": odom}
    topics = {kind: topic for kind, topic in named.items() if topic is not None}
    opened = open_recording(recording, robot, topics)
    if robot is not None and not isinstance(opened, MrclamRecording):
        raise CairnError(
            f"{recording} is not an MRCLAM data set, which has several robots; leave --robot out, "
            "or name the topics of one robot by --scan and --odom"
        )
    for text in opened.notes():
        note(f"{recording}: {text}")
    if base is None:
        base = Base.COMMANDED if isinstance(opened, MrclamRecording) else Base.MEASURED
    settings = BuildSettings(
        mount=mount,
        scan_only=scan_only,
        model=COMMANDED if base is Base.COMMANDED else MEASURED,
        resolution=resolution,
        reach=reach,
    )
    mapper = None
    if extend is not None:
        mapper = read_graph(extend, settings.model)
        mapper.resume(here=False)
    with _shown_progress() as progress:
        built = build_map(opened, str(recording), settings, progress, mapper)
    source = f"built from {recording.name}"
    with replacing_together(files) as parts:
        if built.grid is not None:
            write_map(parts[".yaml"], built.grid)
        if built.landmarks.landmarks:
            write_landmarks(parts[".cairn"], source, built.landmarks.landmarks)
        write_graph(parts[".graph"], built.mapper, source)
        write_trajectory(parts[".tum"], built.stamps, built.poses)
        draw_built_map(built, f"{files['.graph'].stem}: map of {recording.name}", parts[".png"])
    _print_result(built, [file for file in files.values() if file.exists()], json)
    if built.hint:
        note(built.hint)


@app.command()
def save(
    out: MapName,
    force: Force = False,
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


app.command()(history)
app.command()(rollback)


_ENDINGS = (".yaml", ".pgm", ".cairn", ".graph", ".tum", ".png")


def _print_result(built: BuiltMap, files: list[Path], as_json: bool) -> None:
    from cairn.tools.mapping.live import quality_lines

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
        line(f"  scans      {quality.scans}, {quality.keyframes} of them kept as keyframes; "
             f"{quality.driven_m:.0f} m driven")  # fmt: skip
        if quality.left_out:
            line(f"  left out   {quality.left_out} scans: no place that they show was recognized")
        line(f"  fit        {quality.fit:.2f} of 1 (good: above 0.8)")
        for text in quality_lines(quality):
            line(text)
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
    """Show the progress: as bars on a terminal, else as a line from time to time."""
    from rich.console import Console
    from rich.progress import Progress as Bars

    console = Console(stderr=True)
    if not console.is_terminal:
        yield ProgressLines(note)
        return
    with Bars(console=console, transient=True) as bars:
        tasks: dict[str, Any] = {}

        def report(stage: str, share: float, done: str) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=1.0)
            bars.update(tasks[stage], completed=share, description=f"{stage}: {done}")

        yield report


class ProgressLines:
    """Prints how far a long computation is, every 10 s: for logs, and pipes."""

    EVERY_S: Final = 10.0

    def __init__(
        self, output: Callable[[str], object], now: Callable[[], float] = time.monotonic
    ) -> None:
        """Print with `output`, by the clock `now` [s]."""
        self._output, self._now = output, now
        self._stage, self._began_s = "", 0.0
        self._next_s = now() + self.EVERY_S

    def __call__(self, stage: str, share: float, done: str) -> None:
        """Report a stage, its completed share, from 0 to 1, and what was done, in words."""
        now = self._now()
        if stage != self._stage:
            self._stage, self._began_s = stage, now
        if now < self._next_s:
            return
        self._next_s = now + self.EVERY_S
        left = ""
        if share > 0.0:
            left = f"; about {(now - self._began_s) * (1.0 - share) / share:.0f} s left of it"
        self._output(f"{stage}: {done}{left}")
