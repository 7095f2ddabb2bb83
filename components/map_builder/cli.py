"""`cairn map`: import visual maps and show them."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console
from rich.table import Table

from cairn.errors import CairnError
from components.map_builder.importing import altered, importer, write_map
from components.map_builder.objects import MapObject
from components.map_builder.store import MapStore, open_map

app = typer.Typer(help="Visual maps: import and show them.", no_args_is_help=True)


@app.command("import")
def import_map(
    source: Annotated[str, typer.Argument(help="Importer: `mrclam` or one installed.")],
    dataset: Annotated[Path, typer.Argument(help="What the importer reads, such as a folder.")],
    out: Annotated[Path, typer.Argument(help="Map file to write.")],
    displace: Annotated[
        list[str] | None,
        typer.Option(metavar="ID:DX,DY", help="Write an object this far [m] from its place."),
    ] = None,
    remove: Annotated[
        list[int] | None, typer.Option(metavar="ID", help="Leave an object out.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace a map file.")] = False,
) -> None:
    """Make a map file of surveyed objects."""
    if out.exists() and not force:
        raise CairnError(f"{out} exists already. Give another name, or --force to replace it.")
    moves = _displacements(displace or [])
    objects = altered(importer(source)(dataset), moves, remove or [])
    _make_room(out)
    write_map(out, f"imported by {source} from {dataset.name}", objects)
    moved = "".join(f", {key} displaced by ({dx:g}, {dy:g}) m" for key, (dx, dy) in moves.items())
    left_out = "".join(f", {key} left out" for key in remove or [])
    typer.echo(f"{out}: {len(objects)} objects{moved}{left_out}")


@app.command()
def show(
    file: Annotated[Path, typer.Argument(help="Map file.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    history: Annotated[bool, typer.Option("--history", help="Print every change too.")] = False,
) -> None:
    """Show the objects of a map file, where they stand and how far they are relied on."""
    with open_map(file, read_only=True) as store:
        if as_json:
            typer.echo(json.dumps(_as_json(store, history), indent=2))
            return
        console = Console()
        console.print(_objects_table(file, store))
        if history:
            console.print(_history_table(store))


def _displacements(given: list[str]) -> dict[int, tuple[float, float]]:
    moves: dict[int, tuple[float, float]] = {}
    for text in given:
        try:
            name, _, move = text.partition(":")
            dx, dy = (float(part) for part in move.split(","))
            object_id = int(name)
        except ValueError:
            raise CairnError(
                f"--displace {text}: write it as ID:DX,DY with metres, such as 8:1.5,0."
            ) from None
        if not (math.isfinite(dx) and math.isfinite(dy)):
            raise CairnError(f"--displace {text}: the distances must be finite.")
        if object_id in moves:
            raise CairnError(f"--displace names object {object_id} twice.")
        moves[object_id] = (dx, dy)
    return moves


def _make_room(out: Path) -> None:
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        for suffix in ("-wal", "-shm", "-journal"):
            out.with_name(out.name + suffix).unlink(missing_ok=True)
    except OSError as error:
        raise CairnError(f"{out} cannot be written: {error.strerror}.") from error


def _as_json(store: MapStore, history: bool) -> dict[str, Any]:
    shown: dict[str, Any] = {
        "version": store.version(),
        "objects": [_object_json(known) for known in store.objects()],
    }
    if history:
        names = ("version", "stamp_ns", "object_id", "kind", "reliability", "reason")
        shown["changes"] = [dict(zip(names, row, strict=True)) for row in store.history()]
    return shown


def _object_json(known: MapObject) -> dict[str, Any]:
    place, found = known.place, known.candidate
    return {
        "object_id": known.object_id,
        "name": known.name,
        "x": place.x if place else None,
        "y": place.y if place else None,
        "reliability": known.reliability,
        "state": known.state.name,
        "evidence_count": known.evidence_count,
        "candidate_x": found.place.x if found else None,
        "candidate_y": found.place.y if found else None,
        "candidate_reliability": found.reliability if found else None,
    }


def _objects_table(file: Path, store: MapStore) -> Table:
    objects = store.objects()
    table = Table(title=f"{file.name}: {len(objects)} objects, {store.version()} changes")
    for name in ("id", "name", "x [m]", "y [m]", "reliability", "state", "evidence", "candidate"):
        justify: Literal["left", "right"] = "left" if name in ("name", "state") else "right"
        table.add_column(name, justify=justify, no_wrap=True)
    for known in objects:
        place, found = known.place, known.candidate
        candidate = ""
        if found is not None:
            candidate = f"{found.place.x:.2f}, {found.place.y:.2f} ({found.reliability:.2f})"
        table.add_row(
            str(known.object_id),
            known.name,
            f"{place.x:.3f}" if place else "",
            f"{place.y:.3f}" if place else "",
            f"{known.reliability:.2f}",
            known.state.name,
            str(known.evidence_count),
            candidate,
        )
    return table


def _history_table(store: MapStore) -> Table:
    table = Table(title="changes")
    for name in ("version", "time (UTC)", "object", "kind", "reliability", "reason"):
        table.add_column(name, no_wrap=name != "reason")
    for version, stamp_ns, object_id, kind, reliability, reason in store.history():
        when = ""
        if stamp_ns:
            when = datetime.fromtimestamp(stamp_ns / 1e9, UTC).strftime("%Y-%m-%d %H:%M:%S")
        table.add_row(str(version), when, str(object_id), kind, f"{reliability:.2f}", reason)
    return table
