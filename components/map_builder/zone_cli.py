"""`cairn zone`: lists, adds and removes zones on the map of a running robot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from cairn import CairnError
from cairn.client import connect as connect_to
from cairn.planar.zones import feature_of, points_of, read_zones, zone_of
from cairn.schemas.cairn_nav_msgs import ZONE_KINDS, Zone
from cairn.terminal import completion
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.terminal.output import line, note, print_json
from cairn.terminal.output import show as show_rows

app = typer.Typer(help="Zones on the map of a running robot.", no_args_is_help=True)

ZONE_COLUMNS = {
    "name": "name",
    "kind": "kind",
    "x": "x [m]",
    "y": "y [m]",
    "points": "points",
    "property": "property",
}
_MAP_BUILDER = "map_builder"
_LIMIT_S = 10.0


class ZoneKind(StrEnum):
    """The kinds of zones, as typed."""

    KEEPOUT = "keepout"
    SLOW = "slow"
    LANE = "lane"
    PLACE = "place"


@app.command("list")
def list_zones(
    json: Json = False,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """List the zones on the map, with their middle."""
    answer = _request("zones", {}, connect, domain, robot)
    rows = [zone_row(zone_of(feature)) for feature in answer["features"]]
    show_rows(rows, ZONE_COLUMNS, as_json=json, nothing="the map has no zones")


@app.command("add", context_settings={"ignore_unknown_options": True})
def add_zone(
    name: Annotated[str, typer.Argument(help="Its name; no two zones have the same.")],
    kind: Annotated[ZoneKind, typer.Argument(help="What it is.")],
    points: Annotated[
        list[str],
        typer.Argument(
            metavar="X,Y...",
            help="In meters in the map: the corners of a keepout or slow zone, the points of a "
            "lane, or the position of a place.",
        ),
    ],
    speed: Annotated[float | None, typer.Option(help="Of a slow zone [m/s].")] = None,
    width: Annotated[float | None, typer.Option(help="Of a lane [m].")] = None,
    heading: Annotated[
        str | None, typer.Option(help="At a place, in radians, or as 90deg.")
    ] = None,
    replace: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Replace the zone of this name.",
            autocompletion=completion.zones,
        ),
    ] = None,
    json: Json = False,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Add a zone; the robot obeys it within a second."""
    given = {
        "speed": speed,
        "width": width,
        "heading": None if heading is None else _angle(heading),
    }
    properties = {key: value for key, value in given.items() if value is not None}
    positions = [_position(text) for text in points]
    geometry: dict[str, Any] = {"type": "Polygon", "coordinates": [[*positions, positions[0]]]}
    if kind is ZoneKind.LANE:
        geometry = {"type": "LineString", "coordinates": positions}
    elif kind is ZoneKind.PLACE:
        if len(positions) > 1:
            raise CairnError(f"place {name}: give one position X,Y, not {len(positions)}")
        geometry = {"type": "Point", "coordinates": positions[0]}
    feature = {
        "type": "Feature",
        "properties": {"zone": kind.value, "name": name, **properties},
        "geometry": geometry,
    }
    arguments: dict[str, Any] = {"feature": feature_of(zone_of(feature))}
    if replace is not None:
        arguments["replace"] = replace
    _report(_request("add_zone", arguments, connect, domain, robot), as_json=json)


@app.command("remove")
def remove_zone(
    name: Annotated[str, typer.Argument(help="Its name.", autocompletion=completion.zones)],
    json: Json = False,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Remove a zone."""
    _report(_request("remove_zone", {"name": name}, connect, domain, robot), as_json=json)


@app.command("load")
def load_zones(
    file: Annotated[Path, typer.Argument(help="Zones file; `cairn map zones` checks it.")],
    json: Json = False,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Replace all zones by those of a file."""
    try:
        features = [feature_of(zone) for zone in read_zones(file)]
    except FileNotFoundError as error:
        raise CairnError(f"{file}: no such file; give a zones file") from error
    _report(_request("set_zones", {"features": features}, connect, domain, robot), as_json=json)


def zone_row(zone: Zone) -> dict[str, Any]:
    """Return a zone as a row of a table; its position is the middle of its points."""
    x, y = points_of(zone).mean(axis=0).tolist()
    shown = ""
    if zone.kind == Zone.SLOW:
        shown = f"{zone.speed:g} m/s"
    elif zone.kind == Zone.LANE:
        shown = f"{zone.width:g} m wide"
    elif zone.kind == Zone.PLACE and not math.isnan(zone.heading):
        shown = f"{math.degrees(zone.heading):.0f} deg"
    return {
        "name": zone.name,
        "kind": ZONE_KINDS[zone.kind],
        "x": round(x, 3),
        "y": round(y, 3),
        "points": zone.points.size // 2,
        "property": shown,
    }


def _request(verb: str, arguments: Mapping[str, Any], connect: str, domain: int, robot: str) -> Any:
    missing = "it keeps the zones; `cairn load map_builder` starts it, or the first goal"
    with connect_to(connect, domain, robot, notify=note) as client:
        return client.request_plugin(
            _MAP_BUILDER, verb, arguments, missing=missing, timeout_s=_LIMIT_S
        )


def _report(answer: Mapping[str, Any], *, as_json: bool) -> None:
    if as_json:
        print_json(answer)
    else:
        count = answer["zones"]
        zones = "1 zone" if count == 1 else f"{count} zones"
        line(f"the map has {zones} (version {answer['version']})")
    if not answer["saved"]:
        note(
            f"{answer['file']} is not saved yet, and a restart would lose the change: `cairn ps` "
            "has the reason"
        )


def _position(text: str) -> list[float]:
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise CairnError(f"{text}: write a position as X,Y, such as 1.5,2") from None
    return [x, y]


def _angle(text: str) -> float:
    digits = text.strip().removesuffix("deg")
    try:
        value = float(digits)
    except ValueError:
        raise CairnError(f"--heading {text}: {digits!r} is not a number") from None
    return math.radians(value) if digits != text.strip() else value
