"""`cairn topic`: list, print, publish, plot and time the messages on the bus."""

from __future__ import annotations

import csv
import io
import itertools
import json as json_module
import queue
import statistics
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import typer
import yaml

from cairn.bus import keys
from cairn.bus.codec import to_plain
from cairn.cli.nodes import AllTopics, marked
from cairn.cli.topic_plot import plot_topic
from cairn.client import NoMessageError, Robot, Subscription
from cairn.client import connect as connect_to
from cairn.deployment.message_types import find_message
from cairn.errors import CairnError
from cairn.schemas.builtin_interfaces import from_ns
from cairn.schemas.cairn_msgs import PortStatus
from cairn.schemas.message import InvalidMessage, fields_of, repairs_of, type_name
from cairn.schemas.std_msgs import Header
from cairn.terminal import completion
from cairn.terminal.fields import FieldPath, field_path, message_of, plain_values
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.terminal.output import line, note, print_json, print_problems, show

_SHOWN = 36  # elements of a sequence: a covariance is complete
_CHECKED_S = 1.5  # how long a publisher is watched whose messages do not arrive
_MAX_HZ = 1000.0
_LEAST_READS = 3  # of the statuses
_REFUSAL_S = 1.0  # statuses are published four times a second

topic = typer.Typer(help="List, print, publish, plot and time messages.")
TopicName = Annotated[
    str,
    typer.Argument(
        help="As in `pose` or `/robot/pose`.",
        metavar="TOPIC",
        autocompletion=completion.topics,
    ),
]
Count = Annotated[int | None, typer.Option(min=1, help="Stop after this number of messages.")]
Wait = Annotated[
    float, typer.Option(min=0.1, help="Give up after this time without a message [s].")
]


@topic.command("list")
def list_topics(
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    all_: AllTopics = False,
    json: Json = False,
) -> None:
    """List the topics with message type and numbers of publishers and subscribers."""
    with connect_to(connect, domain, robot) as client:
        topics = client.topics()
        elsewhere = "" if topics else client.connection.elsewhere()
    rows: list[dict[str, Any]] = [
        {
            "topic": one.name,
            "type": one.type_name,
            "publishers": len(one.publishers),
            "subscribers": len(one.subscribers),
            "foreign": list(one.foreign),
            "problems": list(one.problems),
        }
        for one in topics
        if all_ or not keys.is_infrastructure(one.name)
    ]
    columns = ["topic", "type", "publishers", "subscribers"]
    if any(row["foreign"] for row in rows):
        columns.append("foreign")
    show(rows, columns, as_json=json, nothing=f"there is no topic{elsewhere}")
    print_problems(problem for row in rows for problem in row["problems"])


@topic.command("info")
def show_topic(
    topic: TopicName,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    json: Json = False,
) -> None:
    """Print the publishers and subscribers of a topic, with types and QoS, and what mismatches."""
    with connect_to(connect, domain, robot) as client:
        found = client.topic_info(topic)
    rows = [
        {
            "role": end.role,
            "node": end.node if json else marked(end.node, end.is_foreign),
            "foreign": end.is_foreign,
            "type": end.type_name,
            "hash": end.type_hash,
            "qos": str(end.qos),
        }
        for end in found.endpoints
    ]
    if json:
        problems = list(found.problems)
        print_json({"topic": found.name, "endpoints": rows, "problems": problems})
        return
    line(found.name)
    show(rows, ("role", "node", "type", "qos"), as_json=False)
    print_problems(found.problems)


@topic.command("echo")
def echo_topic(
    topic: TopicName,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    field: Annotated[
        list[str] | None,
        typer.Option(
            "--field",
            "-f",
            help="Print only this field, one row per message; several give the columns of CSV. As "
            "in pose.position.x, ranges[0], ranges[0:100:10] or points[:].x.",
            metavar="PATH",
            autocompletion=completion.fields,
        ),
    ] = None,
    count: Count = None,
    full: Annotated[
        bool, typer.Option("--full", help="Print long sequences completely, as JSON always does.")
    ] = False,
    wait: Wait = 10.0,
    json: Annotated[bool, typer.Option("--json", help="Print one line of JSON each.")] = False,
) -> None:
    """Print the messages of a topic, or fields of them, the latched one first."""
    with connect_to(connect, domain, robot) as client:
        endpoint = client.find_topic(topic)
        message = find_message(endpoint.type_name)
        paths = [field_path(message, text) for text in field or ()]
        if len(paths) > 1 and not json:
            line(_csv_row(path.text for path in paths))
        printed = 0
        noted: set[str] = set()
        with client.subscribe(endpoint.topic, message, timeout_s=wait) as messages:
            while count is None or printed < count:
                try:
                    received = _next(client, messages)
                except InvalidMessage as error:
                    printed += 1
                    _print_invalid(error, is_row=bool(paths), as_json=json)
                    continue
                printed += 1
                if new := [text for text in repairs_of(received) if text not in noted]:
                    noted.update(new)
                    note(f"repaired, as components receive it: {'; '.join(new)}")
                if paths:
                    _print_fields(received, paths, as_json=json)
                    continue
                value = to_plain(received, None if full or json else _SHOWN)
                if json:
                    line(json_module.dumps(value))
                else:
                    line(_document(value))


@topic.command("pub")
def publish_topic(
    topic: TopicName,
    fields: Annotated[
        str,
        typer.Argument(
            help="Fields of the message, YAML or JSON, as in '{linear: {x: 0.1}}'; those that are "
            "not given have their defaults, and the stamp of the header is the time of sending.",
            metavar="[FIELDS]",
        ),
    ] = "{}",
    type_: Annotated[
        str,
        typer.Option(
            "--type", help="Message type, if the topic is used with several.", metavar="TYPE"
        ),
    ] = "",
    rate: Annotated[
        float | None,
        typer.Option(min=0.001, max=_MAX_HZ, help="Publish again and again [Hz], until Ctrl-C."),
    ] = None,
    count: Count = None,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Publish a message on a topic that a component subscribes to, once or at a rate."""
    values = plain_values(topic, fields)
    with connect_to(connect, domain, robot) as client:
        message = find_message(type_ or client.find_topic(topic).type_name)
        refused = _Refusals(client)
        is_stamped = _is_stamped(message, values)
        made = message_of(message, values)
        total = count if count is not None else 1 if rate is None else None
        period_s = 1.0 / rate if rate is not None else 0.0
        sent, full, began = 0, topic, time.monotonic()
        try:
            while total is None or sent < total:
                time.sleep(max(0.0, began + sent * period_s - time.monotonic()))
                if is_stamped:
                    made = message_of(message, _stamped(values))
                full = client.publish(topic, made)
                sent += 1
        finally:
            if sent:
                what = f"{sent} messages" if sent > 1 else "a message"
                line(f"published {what} of type {type_name(message)} on {full}")
        refused.check(full)


@topic.command("plot")
def plot(
    topic: TopicName,
    fields: Annotated[
        list[str],
        typer.Argument(
            help="Numbers, plotted over time, as in pose.position.x; or sequences of numbers, "
            "plotted over their indices, as in ranges.",
            metavar="FIELD...",
            autocompletion=completion.numbers,
        ),
    ],
    seconds: Annotated[
        float, typer.Option(min=1.0, max=3600.0, help="Time that the plot spans [s].")
    ] = 30.0,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    wait: Wait = 10.0,
) -> None:
    """Plot fields of a topic in the terminal, live; q ends it.

    If the output is not a terminal, one plot is printed after --seconds.
    """
    with connect_to(connect, domain, robot) as client:
        endpoint = client.find_topic(topic)
        message = find_message(endpoint.type_name)
        paths = [field_path(message, text) for text in fields]
        for path in paths:
            if not path.is_numeric:
                raise CairnError(
                    f"{path.text} is not a number; `cairn topic plot {topic}` lists the numbers"
                )
        if len({path.is_sequence for path in paths}) > 1:
            raise CairnError(
                "numbers are plotted over time, sequences over their indices: plot them apart"
            )
        with client.subscribe(endpoint.topic, message, timeout_s=wait) as messages:
            first = _next(client, messages)
            plot_topic(messages, first, paths, seconds)


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
        before = _published(client, endpoint.topic)
        with client.connection.listen(endpoint.data_key) as samples:
            end = time.monotonic() + seconds
            while (left := end - time.monotonic()) > 0:
                try:
                    sample = samples.get(timeout=left)
                except queue.Empty:
                    break
                arrivals.append(time.monotonic())
                sizes.append(len(sample.payload))
                sent = keys.Attachment.of(sample)
                if sent is not None:
                    lost += max(0, sent.sequence - last.get(sent.gid, sent.sequence - 1) - 1)
                    last[sent.gid] = sent.sequence
        if not arrivals:
            reason = _reason(client, endpoint.topic, before)
            raise CairnError(f"no message on {endpoint.topic} within {seconds:g} s{reason}")
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


def _next(client: Robot, messages: Subscription[Any]) -> Any:
    """Return the next message; the error after the time limit names the reason if it is known."""
    try:
        return messages.next()
    except NoMessageError as error:
        before = _published(client, messages.topic)
        try:
            return messages.next(_CHECKED_S)
        except NoMessageError:
            raise CairnError(f"{error}{_reason(client, messages.topic, before)}") from error


def _reason(client: Robot, topic: str, before: int) -> str:
    """Return why nothing arrives of a topic of which `before` messages had been published."""
    unheard = _published(client, topic) - before
    if unheard <= 0:
        return ""
    several = any(one.machine for one in client.connection.statuses().values())
    who = "this machine (its `role` in the deployment) or, " if several else ""
    return (
        f", although {unheard} more have been published: {who}over the network, your role may not "
        "read this topic"
    )


def _published(client: Robot, topic: str) -> int:
    """Return how many messages the components have published on a topic."""
    ports = _ports(client)
    return sum(one.messages for one in ports if one.topic == topic and one.direction == one.OUT)


def _ports(client: Robot) -> list[PortStatus]:
    statuses = client.connection.statuses().values()
    return [port for status in statuses for port in status.ports]


class _Refusals:
    """Finds out whether exclusive inputs have refused what was published."""

    def __init__(self, client: Robot) -> None:
        self._client = client
        self._before = self._counted()

    def check(self, topic: str) -> None:
        """Raise `CairnError` if messages on a topic that components publish, too, were refused."""
        deadline, reads = time.monotonic() + _REFUSAL_S, 0
        while topic in self._published and (
            reads < _LEAST_READS or time.monotonic() < deadline  # reading takes long if all is busy
        ):
            reads += 1
            if self._counted()[topic] > self._before[topic]:
                raise CairnError(
                    f"{topic}: refused: its input accepts messages of one component only "
                    "(exclusive); use a topic that is meant for other programs, which no component "
                    "publishes (`cairn graph`)"
                )

    def _counted(self) -> Counter[str]:
        ports = _ports(self._client)
        self._published = {one.topic for one in ports if one.direction == one.OUT}
        counted: Counter[str] = Counter()
        for one in ports:
            if one.direction == one.IN:
                counted[one.topic] += one.refused
        return counted


def _print_fields(message: Any, paths: Sequence[FieldPath], *, as_json: bool) -> None:
    values = [_plain_or_none(path.value(message)) for path in paths]
    if as_json:
        line(json_module.dumps(dict(zip((path.text for path in paths), values, strict=True))))
    elif len(values) > 1:
        line(_csv_row(map(_cell, values)))
    else:
        line(_cell(values[0]))


def _plain_or_none(value: Any) -> Any:
    """Return a value of a field for people and JSON; None for an element that does not exist."""
    return None if value is None else to_plain(value)


def _cell(value: Any) -> str:
    match value:
        case None:
            return ""
        case str():
            return value
        case _:
            return json_module.dumps(value)


def _csv_row(cells: Any) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="").writerow(list(cells))
    return text.getvalue()


def _print_invalid(error: InvalidMessage, *, is_row: bool, as_json: bool) -> None:
    value = {"invalid": str(error)}
    if as_json:
        line(json_module.dumps(value))
    elif is_row:
        note(f"invalid message: {error}")
    else:
        line(_document(value))


def _document(value: Any) -> str:
    return yaml.safe_dump(value, sort_keys=False, default_flow_style=None) + "---"


def _is_stamped(message: type[Any], values: Mapping[str, Any]) -> bool:
    """Return whether messages have a header whose stamp is not given."""
    header = values.get("header") or {}
    has_header = any(one.name == "header" and one.element is Header for one in fields_of(message))
    return has_header and isinstance(header, Mapping) and "stamp" not in header


def _stamped(values: Mapping[str, Any]) -> dict[str, Any]:
    stamp = from_ns(time.time_ns())
    header = {**(values.get("header") or {}), "stamp": to_plain(stamp)}
    return {**values, "header": header}
