"""`cairn map history|rollback`: what changed in a map, and the return to an earlier one."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cairn import CairnError
from cairn.components.map_builder.cli import CHANGE_COLUMNS, change_row
from cairn.components.map_builder.evidence_chain import time_text
from cairn.planar.map_file import read_map, write_map
from cairn.system.files import replacing_together
from cairn.terminal.options import Json
from cairn.terminal.output import line, print_json
from cairn.terminal.output import show as show_rows
from cairn.visual_map.landmark_store import open_landmarks

if TYPE_CHECKING:
    from cairn.components.slam.graph_history import GraphLog

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
