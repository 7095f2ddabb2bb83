"""`cairn ps`: every component, its state, process, load and losses."""

from collections.abc import Iterator
from typing import Any

import psutil

from cairn.cli.connection import (
    DEFAULT_CONNECT,
    Connect,
    Domain,
    Json,
    Robot,
    check_robot,
    connected,
)
from cairn.cli.tables import show
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.std_msgs import Header

_COLUMNS = {
    "robot": "robot", "tree": "component", "state": "state", "pid": "pid", "restarts": "restarts",
    "received": "received", "dropped": "dropped", "memory_mib": "MiB", "cpu_s": "CPU s",
    "note": "note",
}  # fmt: skip


def ps(
    connect: Connect = DEFAULT_CONNECT, domain: Domain = 0, robot: Robot = "", json: Json = False
) -> None:
    """List the components: state, process, messages received and dropped, memory.

    MiB is the memory that the process adds (PSS), shared by the components in it.
    """
    with connected(connect, domain) as connection:
        statuses = connection.statuses()
    check_robot(robot, (full.split("/")[1] for full in statuses))
    found = {
        full: status
        for full, status in sorted(statuses.items())
        if not robot or full.split("/")[1] == robot
    }
    rows = [
        _row(full, found[full], depth) if full in found else _row_of_absent(full, depth)
        for full, depth in _as_tree(found)
    ]
    robots = {row["robot"] for row in rows}
    shown = {key: title for key, title in _COLUMNS.items() if key != "robot" or len(robots) > 1}
    if json:
        rows = [
            {key: value for key, value in row.items() if key not in ("tree", "note")}
            for row in rows
        ]
    show(rows, shown, as_json=json, nothing="no component runs")


def _as_tree(statuses: dict[str, ComponentStatus]) -> Iterator[tuple[str, int]]:
    """Full name and depth of each component, each below its supervisor in the order of start.

    Those that are not loaded are among them.
    """
    left = dict(statuses)

    def below(full: str, depth: int) -> Iterator[tuple[str, int]]:
        yield full, depth
        status = left.pop(full, None)
        for child in status.children if status is not None else ():
            yield from below(f"{full.rpartition('/')[0]}/{child}", depth + 1)

    for full, status in statuses.items():
        if not status.parent and full in left:
            yield from below(full, 0)
    for full in statuses:  # whose supervisor is not heard of
        if full in left:
            yield from below(full, 0)


def _row(full: str, status: ComponentStatus, depth: int) -> dict[str, Any]:
    handler = f"{status.handler} for {status.handler_s:.1f} s" if status.handler else ""
    inputs = [port for port in status.ports if port.direction == port.IN]
    return {
        "component": full,
        "robot": full.split("/")[1],
        "tree": "  " * depth + status.component,
        "plugin": status.plugin,
        "parent": status.parent,
        "state": status.state,
        "pid": status.pid,
        "placement": status.placement,
        "restarts": status.restarts,
        "handler": handler,
        "received": sum(port.messages for port in inputs),
        "dropped": sum(port.dropped for port in inputs),
        "invalid": sum(port.invalid for port in inputs),
        "reason": status.reason,
        "note": "; ".join(filter(None, (handler, status.reason))),
        **_load(status.pid),
    }


def _row_of_absent(full: str, depth: int) -> dict[str, Any]:
    _, robot, name = full.split("/")
    row = dict.fromkeys(_row(full, ComponentStatus(header=Header(), component=name), depth))
    return {**row, "component": full, "robot": robot, "tree": "  " * depth + name,
            "state": "not loaded"}  # fmt: skip


def _load(pid: int) -> dict[str, float | None]:
    try:
        process = psutil.Process(pid)
        times = process.cpu_times()
        memory = process.memory_full_info().pss / 2**20
    except (psutil.Error, AttributeError):
        # On another machine, of another user, or just ended: its process cannot be read.
        return {"memory_mib": None, "cpu_s": None}
    return {"memory_mib": round(memory, 1), "cpu_s": round(times.user + times.system, 2)}
