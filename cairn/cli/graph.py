"""`cairn graph`: the topics with their publishers and subscribers."""

from __future__ import annotations

from collections.abc import Sequence

from cairn.bus.keys import is_infrastructure
from cairn.cli.nodes import AllTopics, marked
from cairn.client import Topic
from cairn.client import connect as connect_to
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.terminal.output import note, print_problems, show

_MAX_ROWS = 1000
_MAX_NAMES = 50  # publishers or subscribers of one topic


def graph(
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    all_: AllTopics = False,
    json: Json = False,
) -> None:
    """List every topic with its message type, its publishers and its subscribers."""
    with connect_to(connect, domain, robot) as client:
        topics = client.topics()
        elsewhere = "" if topics else client.connection.elsewhere()
    rows = [
        {
            "topic": one.name,
            "type": one.type_name,
            "publishers": _listed(one.publishers, one, json=json),
            "subscribers": _listed(one.subscribers, one, json=json),
            "foreign": list(one.foreign),
            "problems": list(one.problems),
        }
        for one in topics
        if all_ or not is_infrastructure(one.name)
    ]
    if len(rows) > _MAX_ROWS:
        note(f"{len(rows) - _MAX_ROWS} topics are left out; choose a robot with --robot")
        del rows[_MAX_ROWS:]
    columns = ("topic", "type", "publishers", "subscribers")
    show(rows, columns, as_json=json, nothing=f"there is no topic{elsewhere}")
    print_problems(problem for row in rows for problem in row["problems"])


def _listed(nodes: Sequence[str], topic: Topic, *, json: bool) -> list[str]:
    foreign = () if json else topic.foreign
    names = [marked(_short(name, topic.name), name in foreign) for name in nodes[:_MAX_NAMES]]
    more = len(nodes) - len(names)
    return [*names, f"... and {more} more"] if more else names


def _short(node: str, topic: str) -> str:
    """Return the name of a node of the topic's own robot without the robot."""
    return node.removeprefix(f"/{topic.split('/')[1]}/")
