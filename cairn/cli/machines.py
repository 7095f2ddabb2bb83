"""`cairn machines`: the machines of robots, how they see each other, and their clocks."""

from __future__ import annotations

import math
from typing import Any

from cairn.cli.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.cli.output import show
from cairn.client import connect as connect_to
from cairn.client.connection import check_robot
from cairn.schemas.cairn_msgs import MachineLink

_COLUMNS = {
    "robot": "robot", "machine": "machine", "seen_from": "seen from", "state": "state",
    "silent_s": "silent s", "clock_offset_ms": "clock ms", "clock_error_ms": "within ms",
    "note": "note",
}  # fmt: skip


def machines(
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    json: Json = False,
) -> None:
    """List the machines of robots as each of them sees the others.

    Silent: since when nothing of it has arrived. Clock: how far its clock is ahead of that of the
    machine that sees it, and within which error this is known.
    """
    with connect_to(connect, domain, robot) as client:
        found = client.connection.machine_statuses()
        nothing = "" if found else client.connection.elsewhere()
    check_robot(robot, found)
    rows = [
        _row(name, status.machine, link)
        for name, statuses in sorted(found.items())
        if not robot or name == robot
        for status in sorted(statuses, key=lambda one: one.machine)
        for link in status.links
    ]
    robots = {row["robot"] for row in rows}
    shown = {key: title for key, title in _COLUMNS.items() if key != "robot" or len(robots) > 1}
    show(rows, shown, as_json=json, nothing=f"no robot of several machines runs{nothing}")


def _row(robot: str, seen_from: str, link: MachineLink) -> dict[str, Any]:
    return {
        "robot": robot,
        "machine": link.machine,
        "seen_from": seen_from,
        "state": "up" if link.is_up else "lost",
        "silent_s": round(link.silent_s, 2),
        "clock_offset_ms": _milliseconds(link.clock_offset),
        "clock_error_ms": _milliseconds(link.clock_error),
        "note": f"missing: {'; '.join(link.inputs)}" if link.inputs else "",
    }


def _milliseconds(seconds: float) -> float | None:
    return None if math.isnan(seconds) else round(1000 * seconds, 3)
