"""`cairn map`: builds maps from recordings, saves live ones; the rest is the map builder's."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from cairn import CairnError
from cairn.client import connect as connect_to
from cairn.components.map_builder.cli import (
    CHANGE_COLUMNS,
    app,
    change_row,
    parse_mount,
)
from cairn.components.map_builder.evidence_chain import time_text
from cairn.components.replay_devices.mrclam import MrclamRecording
from cairn.components.replay_devices.open_recording import open_recording
from cairn.planar.map_file import read_map, write_map
from cairn.system.files import replacing_together
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.terminal.output import line, note, print_json
from cairn.terminal.output import show as show_rows
from cairn.tools.mapping.target import map_files
from cairn.visual_map.landmark_store import open_landmarks

if TYPE_CHECKING:
    from cairn.components.slam.graph_history import GraphLog
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


@app.command()
def history(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="Graph of a map (.graph), or visual map (.cairn)."),
    ],
    json: Json = False,
) -> None:
    """Show what changed in a map, and when."""
    if file.suffix == ".cairn":
        with open_landmarks(file, read_only=True) as store:
            rows = [change_row(*change) for change in store.history()]
            version = store.version()
        if json:
            print_json({"version": version, "changes": rows})
            return
        show_rows(rows, CHANGE_COLUMNS, as_json=False, nothing="the map has no changes")
        return
    from cairn.components.slam.graph_history import read_log

    log = read_log(file)
    rows = [
        {"version": version, "time": time_text(change.stamp_ns), **vars(change)}
        for version, change in log.changes
    ]
    if json:
        print_json({"version": log.version, "oldest": log.oldest, "changes": rows})
        return
    line(f"{file.name}: version {log.version}; `cairn map rollback` can return to versions from "
         f"{log.oldest} on")  # fmt: skip
    show_rows(rows, _GRAPH_COLUMNS, as_json=False, nothing="the map has no changes")


@app.command()
def rollback(
    file: Annotated[Path, typer.Argument(metavar="GRAPH", help="Graph of a map (.graph).")],
    when: Annotated[
        str,
        typer.Argument(
            metavar="TIME",
            help="Time in UTC, such as '2026-05-04 10:00', or the number of a version.",
        ),
    ],
    json: Json = False,
) -> None:
    """Return to the map of an earlier time; this is a change, too, so it can be undone.

    Changes GRAPH, and writes the grid map (.yaml, .pgm) of that time beside it. Obstacles that were
    drawn by hand into the grid map stay.
    """
    from cairn.components.slam.graph_history import copy_at_rest, draw_state, read_log
    from cairn.tools.mapping.hand_drawn import drawn_by_hand, with_obstacles

    version = _version_at(file, read_log(file), when)
    files = {".graph": file} | {end: file.with_suffix(end) for end in (".yaml", ".pgm")}
    before = read_map(files[".yaml"]) if files[".yaml"].exists() else None
    with replacing_together(files) as parts, copy_at_rest(file, parts[".graph"]) as graph:
        resolution = before.frame.resolution if before else 0.05
        try:
            grid = draw_state(graph.state(version), resolution).grid()
        except ValueError as error:
            raise CairnError(f"{file}: version {version} cannot be drawn: {error}") from error
        drawn = drawn_by_hand(before or grid, graph.seen_surfaces())
        write_map(parts[".yaml"], with_obstacles(grid, drawn))
        new = graph.rollback(version, time.time_ns(), f"returned to version {version}")
        graph.seal()
    if json:
        written = list(map(str, files.values()))
        kept = {"obstacles_kept": len(drawn)}
        print_json({"version": new, "returned_to": version, "files": written, **kept})
        return
    line(f"{file}: version {new}, which is the map of version {version}")
    if len(drawn):
        line(f"  kept       {len(drawn)} obstacle cells that no scan has seen, drawn by hand")
    line(f"also written: {files['.yaml'].name}, {files['.pgm'].name}")


_GRAPH_COLUMNS = {
    "version": "version",
    "time": "time (UTC)",
    "kind": "kind",
    "x": "x [m]",
    "y": "y [m]",
    "width": "width [m]",
    "height": "height [m]",
    "added": "cells added",
    "removed": "removed",
    "reason": "reason",
}


def _version_at(file: Path, log: GraphLog, when: str) -> int:
    """Return the version of the map that an argument names by its number or by a time."""
    times = {version: time_text(change.stamp_ns) for version, change in log.changes}
    oldest = f"version {log.oldest}" + (f" of {times[log.oldest]}" if log.oldest in times else "")
    if when.isdecimal():
        version = int(when)
        if not log.oldest <= version <= log.version:
            raise CairnError(
                f"{file}: version {when} is not kept; the oldest is {oldest}, the newest "
                f"{log.version}"
            )
        return version
    try:
        at = datetime.fromisoformat(when)
    except ValueError:
        raise CairnError(
            f"{when} is not a time; write it as '2026-05-04 10:00' (UTC), or give the number of a "
            "version that `cairn map history` lists"
        ) from None
    if at.tzinfo is None:
        at = at.replace(tzinfo=UTC)
    found = log.version_at(round(at.timestamp() * 1e9))
    if found is None:
        raise CairnError(f"{file}: the map of {when} is not kept any more; the oldest is {oldest}")
    return found


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
