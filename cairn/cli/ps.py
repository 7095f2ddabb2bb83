"""`cairn ps`: every component, its state, process, load and losses."""

from typing import Any

import psutil

from cairn.cli.connection import DEFAULT_CONNECT, Connect, Domain, Json, Robot, connected
from cairn.cli.tables import show
from schemas.cairn_msgs import ComponentStatus

_COLUMNS = (
    "component", "plugin", "parent", "state", "pid", "placement", "restarts", "handler",
    "received", "dropped", "memory MiB", "cpu s", "reason",
)  # fmt: skip


def ps(
    connect: Connect = DEFAULT_CONNECT, domain: Domain = 0, robot: Robot = "", json: Json = False
) -> None:
    """List the components that run, with state, process, memory and messages dropped."""
    with connected(connect, domain) as connection:
        statuses = connection.statuses()
    rows = [
        _row(name, status)
        for name, status in sorted(statuses.items())
        if not robot or name.split("/")[1] == robot
    ]
    show(rows, _COLUMNS, as_json=json)


def _row(name: str, status: ComponentStatus) -> dict[str, Any]:
    handler = f"{status.handler} for {status.handler_s:.1f} s" if status.handler else ""
    inputs = [port for port in status.ports if port.direction == port.IN]
    row: dict[str, Any] = {
        "component": name,
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
        "memory MiB": None,
        "cpu s": None,
        "reason": status.reason,
    }
    try:
        process = psutil.Process(status.pid)
        row["memory MiB"] = round(process.memory_full_info().pss / 2**20, 1)
        times = process.cpu_times()
        row["cpu s"] = round(times.user + times.system, 2)
    except (psutil.Error, AttributeError):
        pass  # on another machine, of another user, or just ended: its process cannot be read
    return row
