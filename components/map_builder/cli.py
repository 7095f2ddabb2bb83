"""`cairn map`: imports maps, shows them, and explains the state of objects."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from cairn import CairnError
from cairn.components.map_builder.evidence_chain import (
    describe_state,
    find_landmark,
    history_of,
    object_row,
    step_rows,
    summarize,
    time_text,
)
from cairn.components.map_builder.importing import (
    alter,
    endings_of,
    import_grid,
    import_models,
    importer,
)
from cairn.components.map_builder.zone_cli import ZONE_COLUMNS, zone_row
from cairn.planar.grid import FREE, FREE_TO, OCCUPIED_FROM, UNKNOWN
from cairn.planar.map_file import read_map as read_grid
from cairn.planar.map_file import write_map as write_grid
from cairn.planar.zones import read_zones
from cairn.system.files import replacing_together
from cairn.terminal.output import line, note, print_json
from cairn.terminal.output import show as show_rows
from cairn.visual_map.landmark_store import open_landmarks
from cairn.visual_map.landmarks import LandmarkRecord
from cairn.visual_map.new_map import write_map

DEFAULT_MAP = Path("visual_map.cairn")
VisualMapFile = Annotated[
    Path, typer.Option("--map", envvar="CAIRN_VISUAL_MAP", help="The visual map.")
]

# As of the parameter group `Mount`.
_FARTHEST_MOUNT_M = 5.0

app = typer.Typer(help="Visual maps and grid maps: import and show them.", no_args_is_help=True)

_OBJECT_COLUMNS = {
    "object_id": "id",
    "name": "name",
    "x": "x [m]",
    "y": "y [m]",
    "reliability": "reliability",
    "state": "state",
    "evidence_count": "evidence",
    "candidate_x": "candidate x [m]",
    "candidate_y": "y [m]",
    "candidate_reliability": "its reliability",
}
CHANGE_COLUMNS = {
    "version": "version",
    "time": "time (UTC)",
    "object_id": "object",
    "kind": "kind",
    "reliability": "reliability",
    "reason": "reason",
}


@app.command("import")
def import_map(
    source: Annotated[
        str, typer.Argument(help="Importer: `mrclam`, `carmen`, `world` or an installed one.")
    ],
    dataset: Annotated[Path, typer.Argument(help="The folder or file that the importer reads.")],
    out: Annotated[
        Path,
        typer.Argument(
            metavar="MAP",
            help="Map to write: a grid map if it ends in .yaml, else a visual map. Without an "
            "ending: MAP.yaml, MAP.cairn, or both, as the importer makes.",
        ),
    ],
    displace: Annotated[
        list[str] | None,
        typer.Option(metavar="ID:DX,DY", help="Displace an object by this much [m]."),
    ] = None,
    remove: Annotated[
        list[int] | None, typer.Option(metavar="ID", help="Remove an object.")
    ] = None,
    resolution: Annotated[
        float, typer.Option(min=0.005, max=1.0, help="Size of a grid map's cells [m].")
    ] = 0.05,
    reach: Annotated[
        float, typer.Option(min=0.5, help="Longer rays only show free space [m].")
    ] = 20.0,
    scanner: Annotated[
        str, typer.Option(metavar="X,Y,THETA", help="Pose of the scanner on the robot [m, rad].")
    ] = "0,0,0",
    force: Annotated[bool, typer.Option("--force", help="Replace a map file.")] = False,
) -> None:
    """Make a visual map of surveyed objects, or a grid map of a survey or of scans with poses."""
    files = [out]
    if not out.suffix:
        files = [out.with_name(out.name + ending) for ending in endings_of(source)]
    replaced = {file.suffix: file for file in files}
    if grid_file := replaced.get(".yaml"):  # a graph beside it would be that of another map
        replaced |= {ending: grid_file.with_suffix(ending) for ending in (".pgm", ".graph")}
    for file in replaced.values():
        if file.exists() and not force:
            raise CairnError(f"{file} exists already. Give another name, or --force to replace it.")
    moves = _parse_displacements(displace or [])
    written: list[str] = []
    with replacing_together(replaced) as parts:
        for file in files:
            if file == grid_file:
                grid = import_grid(source, dataset, resolution, parse_mount(scanner), reach)
                write_grid(parts[".yaml"], grid)
                (width, height), cell = grid.size_m, grid.frame.resolution
                text = f"{width:.1f} m x {height:.1f} m, cells of {cell:g} m"
            else:
                objects, text = _altered(source, dataset, moves, remove or [])
                models = import_models(source, dataset)
                origin = f"imported by {source} from {dataset.name}"
                write_map(parts[file.suffix], origin, objects, models=models)
            written.append(f"{file}: {text}")
    for text in written:
        line(text)


@app.command()
def show(
    file: Annotated[Path, typer.Argument(help="Map file.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    history: Annotated[bool, typer.Option("--history", help="Print every change too.")] = False,
) -> None:
    """Show the objects of a visual map, or the size and the cells of a grid map (.yaml)."""
    if file.suffix in (".yaml", ".yml"):
        if history:
            raise CairnError(f"{file} is a grid map, which has no history; leave out --history")
        _show_grid(file, as_json)
        return
    with open_landmarks(file, read_only=True) as store:
        objects = [object_row(landmark) for landmark in store.landmarks()]
        changes = [change_row(*change) for change in store.history()] if history else []
        version = store.version()
    if as_json:
        shown = {"version": version, "objects": objects}
        print_json({**shown, "changes": changes} if history else shown)
        return
    line(f"{file.name}: {len(objects)} objects, {version} changes")
    show_rows(objects, _OBJECT_COLUMNS, as_json=False, nothing="the map has no objects")
    if history:
        line("")
        show_rows(changes, CHANGE_COLUMNS, as_json=False, nothing="the map has no changes")


@app.command()
def why(
    called: Annotated[str, typer.Argument(metavar="OBJECT", help="Its number or name.")],
    file: VisualMapFile = DEFAULT_MAP,
    last: Annotated[int, typer.Option(min=1, help="Number of newest steps.")] = 30,
    whole: Annotated[
        bool, typer.Option("--all", help="Every step, each piece of evidence separately.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, every step.")] = False,
) -> None:
    """Explain the state of an object in the visual map by its chain of evidence."""
    with open_landmarks(file, read_only=True) as store:
        landmark = find_landmark(store, called)
        chain = history_of(store, landmark)
    if as_json:
        shown_object = {"object": object_row(landmark), "now": describe_state(landmark)}
        print_json({**shown_object, "steps": step_rows(chain)})
        return
    line(f"object {landmark.object_id} ({landmark.name}) {describe_state(landmark)}")
    shown = chain if whole else summarize(chain)
    if not whole and len(shown) > last:
        line(f"... {len(shown) - last} earlier steps; show more with --last N or --all")
        shown = shown[-last:]
    for step in shown:
        times = f" ({step.times} times)" if step.times > 1 else ""
        line(f"{time_text(step.stamp_ns) or 'initially':>29}  {step.text}{times}")


@app.command()
def zones(
    file: Annotated[Path, typer.Argument(help="Zones file, such as MAP.zones.geojson.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Check a zones file and list its zones."""
    try:
        found = read_zones(file)
    except FileNotFoundError as error:
        raise CairnError(f"{file}: no such file; give a zones file") from error
    if not as_json:
        line(f"{file.name}: {len(found)} {'zone' if len(found) == 1 else 'zones'}")
    show_rows([zone_row(zone) for zone in found], ZONE_COLUMNS, as_json=as_json, nothing="no zones")


def _altered(
    source: str, dataset: Path, moves: dict[int, tuple[float, float]], remove: list[int]
) -> tuple[list[LandmarkRecord], str]:
    """Return an importer's objects, some displaced by (dx, dy) [m], some removed; and a summary."""
    objects = alter(importer(source)(dataset), moves, remove)
    moved = "".join(f", {key} displaced by ({dx:g}, {dy:g}) m" for key, (dx, dy) in moves.items())
    removed = "".join(f", {key} removed" for key in remove)
    return objects, f"{len(objects)} objects{moved}{removed}"


def _show_grid(file: Path, as_json: bool) -> None:
    grid = read_grid(file, note)
    values, (width, height), (x, y, theta) = grid.values, grid.size_m, grid.frame.origin
    shares = {
        "free": float(np.mean((values >= FREE) & (values <= FREE_TO))),
        "occupied": float(np.mean(values >= OCCUPIED_FROM)),
        "unknown": float(np.mean(values == UNKNOWN)),
    }
    if as_json:
        rows, columns = values.shape
        size = {"width_m": width, "height_m": height, "columns": columns, "rows": rows}
        origin = {"x": x, "y": y, "theta": theta}
        print_json({"resolution": grid.frame.resolution, **size, "origin": origin, **shares})
        return
    line(f"{file.name}: {width:.2f} m x {height:.2f} m, cells of {grid.frame.resolution:g} m")
    line(f"its origin is at ({x:.2f}, {y:.2f}) m, rotated by {theta:.3f} rad")
    line(", ".join(f"{kind} {100 * share:.1f} %" for kind, share in shares.items()))


def _parse_displacements(given: list[str]) -> dict[int, tuple[float, float]]:
    moves: dict[int, tuple[float, float]] = {}
    for text in given:
        try:
            name, _, move = text.partition(":")
            dx, dy = (float(part) for part in move.split(","))
            object_id = int(name)
        except ValueError:
            raise CairnError(
                f"--displace {text}: write it as ID:DX,DY with meters, such as 8:1.5,0."
            ) from None
        if not (math.isfinite(dx) and math.isfinite(dy)):
            raise CairnError(f"--displace {text}: the distances must be finite.")
        if object_id in moves:
            raise CairnError(f"--displace names object {object_id} twice.")
        moves[object_id] = (dx, dy)
    return moves


def parse_mount(text: str) -> tuple[float, float, float]:
    """Return the pose that the option `--scanner` gives as X,Y,THETA [m, rad]."""
    try:
        x, y, theta = (float(part) for part in text.split(","))
    except ValueError:
        raise CairnError(f"--scanner {text}: write it as X,Y,THETA, such as 0.1,0,0.") from None
    if not (abs(x) <= _FARTHEST_MOUNT_M and abs(y) <= _FARTHEST_MOUNT_M and abs(theta) <= math.tau):
        raise CairnError(
            f"--scanner {text}: X and Y are at most {_FARTHEST_MOUNT_M:g} m from the robot's "
            "center, and THETA is a number of radians, such as 1.57 for 90 degrees to the left; "
            "correct them"
        )
    return x, y, theta


def change_row(
    version: int, stamp_ns: int, object_id: int, kind: str, reliability: float, reason: str
) -> dict[str, Any]:
    """Return a change of a visual map as a row of `CHANGE_COLUMNS`."""
    return {
        "version": version,
        "time": time_text(stamp_ns),
        "stamp_ns": stamp_ns,
        "object_id": object_id,
        "kind": kind.lower(),
        "reliability": reliability,
        "reason": reason,
    }
