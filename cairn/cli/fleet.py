"""`cairn fleet`: the robots on the bus, and whether what they share has reached all of them."""

from __future__ import annotations

from typing import Any

from cairn.cli.options import DEFAULT_CONNECT, Connect, Domain, Json
from cairn.cli.output import show
from cairn.client import connect as connect_to
from cairn.client.fleet import FleetRobot, read_fleet

_COLUMNS = {
    "robot": "robot", "state": "state", "health": "health", "mission": "mission",
    "map": "map", "version": "version", "landmarks": "landmarks", "shared": "shared",
    "rejected": "rejected",
}  # fmt: skip
_DIGEST = 8  # characters of a map's digest that a table shows
_FEW = 3  # robots or components that a cell names


def fleet(connect: Connect = DEFAULT_CONNECT, domain: Domain = 0, json: Json = False) -> None:
    """List the robots: state, health of the pose, mission, map, and what they share.

    Map is the digest of the visual map from which a robot started: robots share what they find out
    about the same map. Shared says whether a robot has all that other robots have found out.
    Rejected counts the contributions of others that it did not accept.
    """
    with connect_to(connect, domain) as client:
        robots = read_fleet(client.connection)
        elsewhere = "" if robots else client.connection.elsewhere()
    rows = [_row(one, in_full=json) for one in robots]
    show(rows, _COLUMNS, as_json=json, nothing=f"there is no robot{elsewhere}")


def _row(one: FleetRobot, *, in_full: bool) -> dict[str, Any]:
    shared = one.shared
    row: dict[str, Any] = {
        "robot": one.name,
        "state": _state(one),
        "health": None if one.health is None else round(one.health, 2),
        "mission": one.mission,
        "map": "" if shared is None else shared.map if in_full else shared.map[:_DIGEST],
        "version": None if shared is None else shared.map_version,
        "landmarks": None if shared is None else shared.landmarks,
        "shared": "no" if shared is None else _sync(one),
        "rejected": None if shared is None else shared.rejected,
    }
    if in_full:
        row |= {
            "health_reason": one.health_reason,
            "mission_reason": one.mission_reason,
            "not_active": list(one.failing),
            "behind": dict(one.behind),
            "contributors": []
            if shared is None
            else [
                {"robot": each.robot, "newest": each.newest, "count": each.count}
                for each in shared.contributors
            ],
        }
    return row


def _state(one: FleetRobot) -> str:
    if not one.failing:
        return "active"
    names = [full.rpartition("/")[2] for full in one.failing]
    return f"not active: {_listed(names)}"


def _sync(one: FleetRobot) -> str:
    if not one.behind:
        return "in sync"
    return f"behind {_listed([f'{name} by {count}' for name, count in one.behind.items()])}"


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _FEW} more" if len(names) > _FEW else ""
    return ", ".join(names[:_FEW]) + more
