"""`cairn machines`: the machines of robots, how they see each other, and their clocks."""

from __future__ import annotations

from cairn.client import connect as connect_to
from cairn.client.connection import check_robot
from cairn.client.machines import described_links
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.terminal.output import show

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
    machine that sees it, and within which error this is known. Missing: topics that a lost machine
    publishes for that one.
    """
    with connect_to(connect, domain, robot) as client:
        found = client.connection.machine_statuses()
        nothing = "" if found else client.connection.elsewhere()
    check_robot(robot, found)
    rows = [
        {"robot": name, **link}
        for name, statuses in sorted(found.items())
        if not robot or name == robot
        for link in described_links(statuses)
    ]
    if not json:
        for row in rows:
            row["note"] = f"missing: {'; '.join(row['missing'])}" if row["missing"] else ""
    robots = {row["robot"] for row in rows}
    shown = {key: title for key, title in _COLUMNS.items() if key != "robot" or len(robots) > 1}
    show(rows, shown, as_json=json, nothing=f"no robot of several machines runs{nothing}")
