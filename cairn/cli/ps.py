"""`cairn ps`: the components that run, with state, counts of messages and memory."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any

import psutil

from cairn.cli.nodes import note_on, uses
from cairn.client import NodeInfo
from cairn.client import connect as connect_to
from cairn.client.connection import check_robot
from cairn.client.graph import read_nodes
from cairn.client.machines import components_of_lost, machine_of_router
from cairn.schemas.cairn_msgs import ComponentStatus, MachineLink
from cairn.schemas.std_msgs import Header
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.terminal.output import note, show

_COLUMNS = {
    "robot": "robot", "tree": "component", "machine": "machine", "state": "state", "pid": "pid",
    "restarts": "restarts",
    "received": "recv", "dropped": "dropped", "invalid": "invalid", "refused": "refused",
    "memory_mib": "MiB", "cpu_s": "CPU s", "note": "note",
}  # fmt: skip
_SLOW_HANDLER_S = 1.0  # shown when it runs longer, as in the console
_MAX_ROWS = 1000
_GRAPH_LIMIT_S = 1.0  # a robot's is read in some ms
_MAX_INPUTS = 50  # that a lost machine misses
_MAX_DEPTH = 50  # of the tree of components


def ps(
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    json: Json = False,
) -> None:
    """List the components: state, process, counts of messages, memory; and foreign nodes.

    Dropped: lost on the way, or in favor of newer ones. Invalid: broke their definition or a limit.
    Refused: came to an exclusive port from a publisher that is not entitled. MiB is the memory that
    the process adds (PSS), shared by the components in it.
    """
    with connect_to(connect, domain, robot) as client:
        statuses = client.connection.read_statuses()
        nodes = read_nodes(client.connection, patience_s=_GRAPH_LIMIT_S)
        several = any(one.machine for one in statuses.answered.values())
        machines = client.connection.machine_statuses() if several else {}
        router = client.connection.router_process()
        nothing = "" if statuses.answered or nodes else client.connection.elsewhere()
    answered, silent = statuses.answered, statuses.silent
    names = [*answered, *silent]
    check_robot(robot, (full.split("/")[1] for full in names))
    found = {
        full: answered.get(full)
        for full in sorted(names)
        if not robot or full.split("/")[1] == robot
    }
    tree = list(itertools.islice(_as_tree(found), _MAX_ROWS))
    by_robot: dict[str, list[ComponentStatus]] = {}
    for full, one in answered.items():
        by_robot.setdefault(full.split("/")[1], []).append(one)
    own = {name: machine_of_router(of_robot, router) for name, of_robot in by_robot.items()}
    lost = {
        f"/{name}/{component}": machine
        for name, of_robot in machines.items()
        for component, machine in components_of_lost(of_robot).items()
    }
    rows = [
        _row(full, answered[full], depth, own)
        if full in answered
        else _row_of_absent(full, depth, silent, lost)
        for full, depth in tree
    ]
    robots = {row["robot"] for row in rows}
    shared = {one.name: note_on(one, short=True) for one in nodes if not one.is_unique}
    for row in rows:
        row["note"] = "; ".join(filter(None, (row["note"], shared.get(row["component"]))))
    prefix = f"/{robot}/" if robot else "/"
    foreign = [one for one in nodes if one.is_foreign and one.name.startswith(prefix)]
    left_out = max(0, len(foreign) - (_MAX_ROWS - len(rows)))
    rows += [_row_of_foreign(one) for one in foreign[: len(foreign) - left_out]]
    if statuses.left_out:
        note(f"{statuses.left_out} more announced components do not answer; they are left out")
    if left_out:
        note(f"{left_out} foreign nodes are left out; `cairn node list` has all")
    if len(tree) == _MAX_ROWS:
        note(f"only the first {_MAX_ROWS} components are listed; choose a robot with --robot")
    hidden = {"robot"} if len(robots) < 2 else set()
    if not any(row.get("machine") for row in rows):
        hidden.add("machine")
    shown = {key: title for key, title in _COLUMNS.items() if key not in hidden}
    for status in itertools.chain.from_iterable(machines.values()):
        for link in status.links:
            if not link.is_up:
                note(_described_link(status.machine, link))
    if json:
        rows = [
            {
                **{key: value for key, value in row.items() if key not in ("tree", "note")},
                "unique": row["component"] not in shared,
            }
            for row in rows
        ]
    show(rows, shown, as_json=json, nothing=f"no component runs{nothing}")


def _as_tree(statuses: Mapping[str, ComponentStatus | None]) -> Iterator[tuple[str, int]]:
    """Yield full name and depth of each component, below its supervisor in the order of start.

    Those that are not loaded are among them, and those without a status, as they do not answer.
    """
    left = dict(statuses)

    def below(full: str, depth: int) -> Iterator[tuple[str, int]]:
        yield full, depth
        status = left.pop(full, None)
        children = () if status is None or depth == _MAX_DEPTH else status.children
        for child in children:
            below_it = f"{full.rpartition('/')[0]}/{child}"
            own = statuses.get(below_it)
            # One that a root started for a parent on another machine stands below that parent.
            if own is None or status is None or own.parent == status.component:
                yield from below(below_it, depth + 1)

    for full, status in statuses.items():
        if status is not None and not status.parent and full in left:
            yield from below(full, 0)
    for full in statuses:  # those whose supervisor does not answer
        if full in left:
            yield from below(full, 0)


def _described_link(machine: str, link: MachineLink) -> str:
    missing = "; ".join(link.inputs[:_MAX_INPUTS]) or "nothing"
    return (
        f"machine {link.machine} cannot be reached from {machine}, for {link.silent_s:.1f} s; "
        f"missing there: {missing}"
    )


def _row(
    full: str,
    status: ComponentStatus,
    depth: int,
    own: Mapping[str, str | None] = MappingProxyType({}),
) -> dict[str, Any]:
    """Return the row of a component; `own` has each robot's machine on this computer, or None."""
    handler = f"{status.handler} for {status.handler_s:.1f} s" if status.handler else ""
    busy = f"in {handler}" if status.handler_s >= _SLOW_HANDLER_S else ""
    inputs = [port for port in status.ports if port.direction == port.IN]
    return {
        "component": full,
        "robot": full.split("/")[1],
        "tree": "  " * depth + status.component,
        "machine": status.machine,
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
        "refused": sum(port.refused for port in inputs),
        "reason": status.reason,
        "note": "; ".join(filter(None, (busy, status.reason))),
        **_load(status.pid if own.get(full.split("/")[1]) == status.machine else None),
    }


def _row_of_absent(
    full: str,
    depth: int,
    silent: Mapping[str, int | None],
    lost: Mapping[str, str] = MappingProxyType({}),
) -> dict[str, Any]:
    robot, _, name = full.removeprefix("/").rpartition("/")
    row = dict.fromkeys(_row(full, ComponentStatus(header=Header(), component=name), depth))
    state = "lost" if full in lost else "no answer" if full in silent else "not loaded"
    pid = silent.get(full)
    return {
        **row,
        "component": full,
        "robot": robot,
        "tree": "  " * depth + name,
        "machine": lost.get(full, ""),
        "state": state,
        "pid": pid,
        "note": _note_on(pid),
    }


def _row_of_foreign(one: NodeInfo) -> dict[str, Any]:
    return {**_row_of_absent(one.name, 0, {}), "robot": "", "tree": one.name, "state": "foreign",
            "note": note_on(one), **uses(one)}  # fmt: skip


def _note_on(pid: int | None) -> str:
    """Return what is known of a process that does not answer."""
    try:
        stopped = pid is not None and psutil.Process(pid).status() == psutil.STATUS_STOPPED
    except psutil.Error:
        return ""
    return "its process was stopped by a signal such as SIGSTOP" if stopped else ""


def _load(pid: int | None) -> dict[str, float | None]:
    try:
        if pid is None:  # on another computer
            raise psutil.NoSuchProcess(0)
        process = psutil.Process(pid)
        times = process.cpu_times()
        memory = process.memory_full_info().pss / 2**20
    except (psutil.Error, AttributeError):
        # On another machine, of another user, or just ended: its process cannot be read.
        return {"memory_mib": None, "cpu_s": None}
    return {"memory_mib": round(memory, 1), "cpu_s": round(times.user + times.system, 2)}
