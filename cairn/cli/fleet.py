"""`cairn fleet`: the robots on the bus, and whether what they share has reached all of them."""

from __future__ import annotations

from typing import Any

from cairn.client import connect as connect_to
from cairn.client.fleet import FleetRobot, read_fleet
from cairn.schemas.cairn_msgs import SharedCells, SharedLandmarks
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json
from cairn.terminal.output import show

_COLUMNS = {
    "robot": "robot", "state": "state", "health": "health", "mission": "mission",
    "map": "map", "version": "version", "landmarks": "landmarks", "grid": "grid",
    "cells": "cells", "shared": "shared", "rejected": "rejected",
}  # fmt: skip
_DIGEST = 8  # characters of a map's digest that a table shows
_FEW = 3  # robots or components that a cell names


def fleet(connect: Connect = DEFAULT_CONNECT, domain: Domain = 0, json: Json = False) -> None:
    """List the robots: state, health of the pose, mission, map, and what they share.

    Map and grid are the digests of the visual map and the grid map from which a robot started:
    robots share what they find out about the same map. Cells counts those that have changed since.
    Shared says whether a robot has all that other robots have found out. Rejected counts the
    contributions of others that it did not accept.
    """
    with connect_to(connect, domain) as client:
        robots = read_fleet(client.connection)
        elsewhere = "" if robots else client.connection.elsewhere()
    rows = [_row(one, in_full=json) for one in robots]
    show(rows, _COLUMNS, as_json=json, nothing=f"there is no robot{elsewhere}")


def _row(one: FleetRobot, *, in_full: bool) -> dict[str, Any]:
    shared, cells = one.shared, one.cells
    digits = None if in_full else _DIGEST
    rejected = [each.rejected for each in (shared, cells) if each is not None]
    row: dict[str, Any] = {
        "robot": one.name,
        "state": _state(one),
        "health": None if one.health is None else round(one.health, 2),
        "mission": one.mission,
        "map": "" if shared is None else shared.map[:digits],
        "version": None if shared is None else shared.map_version,
        "landmarks": None if shared is None else shared.landmarks,
        "grid": "" if cells is None else cells.map[:digits],
        "cells": None if cells is None else cells.cells,
        "shared": _sync(one) if rejected else "no",
        "rejected": sum(rejected) if rejected else None,
    }
    if in_full:
        row |= {
            "health_reason": one.health_reason,
            "mission_reason": one.mission_reason,
            "not_active": list(one.failing),
            "behind": dict(one.behind),
            "cells_behind": list(one.cells_behind),
            "contributors": _contributors(shared),
            "cell_contributors": _contributors(cells),
        }
    return row


def _state(one: FleetRobot) -> str:
    if not one.failing:
        return "active"
    names = [full.rpartition("/")[2] for full in one.failing]
    return f"not active: {_listed(names)}"


def _contributors(shared: SharedLandmarks | SharedCells | None) -> list[dict[str, Any]]:
    known = () if shared is None else shared.contributors
    return [{"robot": one.robot, "newest": one.newest, "count": one.count} for one in known]


def _sync(one: FleetRobot) -> str:
    lacks = []
    if one.behind:
        behind = [f"{name} by {count}" for name, count in one.behind.items()]
        lacks.append(f"behind {_listed(behind)}")
    if one.cells_behind:
        lacks.append(f"cells behind {_listed(list(one.cells_behind))}")
    return "; ".join(lacks) or "in sync"


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _FEW} more" if len(names) > _FEW else ""
    return ", ".join(names[:_FEW]) + more
