"""`cairn ps|graph|topic|logs`: what runs, and what passes on the bus."""

from __future__ import annotations

import itertools
import json as json_module
import queue
import statistics
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from typing import Annotated, Any

import psutil
import typer
import yaml

from cairn.bus.codec import to_plain
from cairn.cli.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.cli.output import line, note, print_json, show
from cairn.cli.plugins import find_message
from cairn.client import connect as connect_to
from cairn.client.connection import STATUS_TOPIC, attachment_of, check_robot
from cairn.errors import CairnError
from cairn.runtime.rosout import ROSOUT, render
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.message import InvalidMessage
from cairn.schemas.rcl_interfaces import Log
from cairn.schemas.std_msgs import Header

_COLUMNS = {
    "robot": "robot", "tree": "component", "state": "state", "pid": "pid", "restarts": "restarts",
    "received": "recv", "dropped": "dropped", "invalid": "invalid", "refused": "refused",
    "memory_mib": "MiB", "cpu_s": "CPU s", "note": "note",
}  # fmt: skip
_MAX_ROWS = 1000
_MAX_NAMES = 50  # publishers or subscribers of one topic
_MAX_DEPTH = 50  # of the tree of components
_SHOWN = 36  # elements of a sequence: a covariance is complete

topic = typer.Typer(help="List, print and time the messages on the bus.")
TopicName = Annotated[str, typer.Argument(help="As in `pose` or `/robot/pose`.", metavar="TOPIC")]


def ps(
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    json: Json = False,
) -> None:
    """List the components: state, process, counts of messages, memory.

    Dropped: lost on the way, or in favor of newer ones. Invalid: broke their definition or a limit.
    Refused: came to an exclusive port from a publisher that is not entitled. MiB is the memory that
    the process adds (PSS), shared by the components in it.
    """
    with connect_to(connect, domain, robot) as client:
        statuses = client.connection.read_statuses()
    answered, silent = statuses.answered, statuses.silent
    names = [*answered, *silent]
    check_robot(robot, (full.split("/")[1] for full in names))
    found = {
        full: answered.get(full)
        for full in sorted(names)
        if not robot or full.split("/")[1] == robot
    }
    tree = list(itertools.islice(_as_tree(found), _MAX_ROWS))
    rows = [
        _row(full, answered[full], depth)
        if full in answered
        else _row_of_absent(full, depth, silent)
        for full, depth in tree
    ]
    if statuses.left_out:
        note(f"{statuses.left_out} more announced components do not answer; they are left out")
    if len(tree) == _MAX_ROWS:
        note(f"only the first {_MAX_ROWS} components are listed; choose a robot with --robot")
    robots = {row["robot"] for row in rows}
    shown = {key: title for key, title in _COLUMNS.items() if key != "robot" or len(robots) > 1}
    if json:
        rows = [
            {key: value for key, value in row.items() if key not in ("tree", "note")}
            for row in rows
        ]
    show(rows, shown, as_json=json, nothing="no component runs")


def graph(
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    all_: Annotated[
        bool,
        typer.Option("--all", help="Also /rosout and component_status, which all publish."),
    ] = False,
    json: Json = False,
) -> None:
    """List every topic with its message type, its publishers and its subscribers."""
    with connect_to(connect, domain, robot) as client:
        topics = client.topics()
    rows = [
        {
            "topic": one.name,
            "type": one.type_name,
            "publishers": _listed(one.publishers, one.name),
            "subscribers": _listed(one.subscribers, one.name),
        }
        for one in topics
        if all_ or not (one.name == ROSOUT or one.name.rpartition("/")[2] == STATUS_TOPIC)
    ]
    if len(rows) > _MAX_ROWS:
        note(f"{len(rows) - _MAX_ROWS} topics are left out; choose a robot with --robot")
        del rows[_MAX_ROWS:]
    columns = ("topic", "type", "publishers", "subscribers")
    show(rows, columns, as_json=json, nothing="there is no topic")


@topic.command("list")
def list_topics(
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    json: Json = False,
) -> None:
    """List the topics with message type and numbers of publishers and subscribers."""
    with connect_to(connect, domain, robot) as client:
        topics = client.topics()
    rows = [
        {
            "topic": one.name,
            "type": one.type_name,
            "publishers": len(one.publishers),
            "subscribers": len(one.subscribers),
        }
        for one in topics
    ]
    columns = ("topic", "type", "publishers", "subscribers")
    show(rows, columns, as_json=json, nothing="there is no topic")


@topic.command("echo")
def echo_topic(
    topic: TopicName,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    count: Annotated[
        int | None, typer.Option(min=1, help="Stop after this number of messages.")
    ] = None,
    full: Annotated[
        bool, typer.Option("--full", help="Print long sequences completely, as JSON always does.")
    ] = False,
    wait: Annotated[
        float, typer.Option(min=0.1, help="Give up after this time without a message [s].")
    ] = 10.0,
    json: Annotated[bool, typer.Option("--json", help="Print one line of JSON each.")] = False,
) -> None:
    """Print the messages of a topic, the latched one first."""
    with connect_to(connect, domain, robot) as client:
        endpoint = client.find_topic(topic)
        message = find_message(endpoint.type_name)
        printed = 0
        with client.subscribe(endpoint.topic, message, timeout_s=wait) as messages:
            while count is None or printed < count:
                try:
                    value = to_plain(messages.next(), None if full or json else _SHOWN)
                except InvalidMessage as error:
                    value = {"invalid": str(error)}
                printed += 1
                if json:
                    line(json_module.dumps(value))
                else:
                    line(yaml.safe_dump(value, sort_keys=False, default_flow_style=None) + "---")


@topic.command("hz")
def measure_topic(
    topic: TopicName,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    seconds: Annotated[float, typer.Option(min=0.5, help="How long to measure [s].")] = 5.0,
    json: Json = False,
) -> None:
    """Measure a topic's rate, jitter, size and losses from the raw messages."""
    with connect_to(connect, domain, robot) as client:
        endpoint = client.find_topic(topic)
        arrivals: list[float] = []
        sizes: list[int] = []
        last: dict[bytes, int] = {}
        lost = 0
        with client.connection.listen(endpoint.data_key) as samples:
            end = time.monotonic() + seconds
            while (left := end - time.monotonic()) > 0:
                try:
                    sample = samples.get(timeout=left)
                except queue.Empty:
                    break
                arrivals.append(time.monotonic())
                sizes.append(len(sample.payload))
                sent = attachment_of(sample)
                if sent is not None:
                    lost += max(0, sent.sequence - last.get(sent.gid, sent.sequence - 1) - 1)
                    last[sent.gid] = sent.sequence
    if not arrivals:
        raise CairnError(f"no message on {endpoint.topic} within {seconds:g} s")
    gaps = [after - before for before, after in itertools.pairwise(arrivals)]
    mean = statistics.fmean(gaps) if gaps else 0.0
    result = {
        "topic": endpoint.topic,
        "messages": len(arrivals),
        "hz": round(1 / mean, 3) if mean > 0 else 0.0,
        "period_ms": round(mean * 1e3, 3),
        "jitter_ms": round(statistics.pstdev(gaps) * 1e3, 3) if gaps else 0.0,
        "longest_ms": round(max(gaps, default=0.0) * 1e3, 3),
        "bytes": round(statistics.fmean(sizes)) if sizes else 0,
        "lost": lost,
    }
    if json:
        print_json(result)
    else:
        titles = {key: key.replace("_", " ") for key in result}
        show([result], titles, as_json=False)


def logs(
    component: Annotated[str, typer.Argument(help="Only this component.", metavar="NAME")] = "",
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    follow: Annotated[
        bool, typer.Option("--follow", "-f", help="Go on with new messages until Ctrl-C.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print one line of JSON each.")] = False,
) -> None:
    """Print the last log messages of the running components in order of time."""
    with (
        connect_to(connect, domain, robot, notify=note) as client,
        # The subscription comes first, so that no message is missed in between.
        client.follow_logs(component) if follow else nullcontext() as messages,
    ):
        history = client.logs(component)
        for entry in history:
            line(render(entry, as_json=json))
        if component and not history:
            note(
                f"{component} has logged nothing since it was started; earlier messages are in "
                f"logs/{component}.log of the run's folder, which `cairn up` names"
            )
        printed = set(map(_identity, history))
        while messages is not None:
            try:
                entry = messages.next()
            except InvalidMessage:
                continue  # of a foreign node
            if _identity(entry) not in printed:
                line(render(entry, as_json=json))


def _identity(entry: Log) -> tuple[object, ...]:
    return (entry.stamp.sec, entry.stamp.nanosec, entry.name, entry.msg)


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
            yield from below(f"{full.rpartition('/')[0]}/{child}", depth + 1)

    for full, status in statuses.items():
        if status is not None and not status.parent and full in left:
            yield from below(full, 0)
    for full in statuses:  # those whose supervisor does not answer
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
        "refused": sum(port.refused for port in inputs),
        "reason": status.reason,
        "note": "; ".join(filter(None, (handler, status.reason))),
        **_load(status.pid),
    }


def _row_of_absent(full: str, depth: int, silent: Mapping[str, int | None]) -> dict[str, Any]:
    robot, _, name = full.removeprefix("/").rpartition("/")
    row = dict.fromkeys(_row(full, ComponentStatus(header=Header(), component=name), depth))
    state = "no answer" if full in silent else "not loaded"
    pid = silent.get(full)
    return {**row, "component": full, "robot": robot, "tree": "  " * depth + name,
            "state": state, "pid": pid, "note": _note_on(pid)}  # fmt: skip


def _note_on(pid: int | None) -> str:
    """Return what is known of a process that does not answer."""
    try:
        stopped = pid is not None and psutil.Process(pid).status() == psutil.STATUS_STOPPED
    except psutil.Error:
        return ""
    return "its process was stopped by a signal such as SIGSTOP" if stopped else ""


def _load(pid: int) -> dict[str, float | None]:
    try:
        process = psutil.Process(pid)
        times = process.cpu_times()
        memory = process.memory_full_info().pss / 2**20
    except (psutil.Error, AttributeError):
        # On another machine, of another user, or just ended: its process cannot be read.
        return {"memory_mib": None, "cpu_s": None}
    return {"memory_mib": round(memory, 1), "cpu_s": round(times.user + times.system, 2)}


def _listed(nodes: Sequence[str], topic: str) -> list[str]:
    names = [_short(name, topic) for name in nodes[:_MAX_NAMES]]
    more = len(nodes) - len(names)
    return [*names, f"... and {more} more"] if more else names


def _short(node: str, topic: str) -> str:
    """Return the name of a node of the topic's own robot without the robot."""
    return node.removeprefix(f"/{topic.split('/')[1]}/")
