"""`cairn graph`: which component writes and reads which topic."""

from collections import defaultdict
from typing import Annotated

import typer

from cairn.bus import keys
from cairn.cli.connection import (
    DEFAULT_CONNECT,
    STATUS_TOPIC,
    Connect,
    Domain,
    Json,
    Robot,
    connected,
)
from cairn.cli.tables import show
from cairn.runtime.rosout import ROSOUT


def graph(
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: Robot = "",
    all_: Annotated[
        bool, typer.Option("--all", help="Also /rosout and component_status, which all write.")
    ] = False,
    json: Json = False,
) -> None:
    """List every topic with its message type, who writes it and who reads it."""
    with connected(connect, domain) as connection:
        endpoints = connection.endpoints()
    listed = [
        {
            **row,
            "writers": [_short(name, str(row["topic"])) for name in row["writers"]],
            "readers": [_short(name, str(row["topic"])) for name in row["readers"]],
        }
        for row in rows(endpoints, robot)
        if all_ or not _of_every_component(str(row["topic"]))
    ]
    show(listed, ("topic", "type", "writers", "readers"), as_json=json, nothing="there is no topic")


def rows(endpoints: list[keys.EndpointEntity], robot: str) -> list[dict[str, str | list[str]]]:
    """One row for each topic and message type, sorted; those of a `robot` alone if given."""
    ends: dict[tuple[str, str], dict[str, set[str]]] = defaultdict(
        lambda: {"MP": set(), "MS": set()}
    )
    for endpoint in endpoints:
        names = (endpoint.topic, endpoint.node.name)
        if endpoint.kind in ("MP", "MS") and (
            not robot or any(name.startswith(f"/{robot}/") for name in names)
        ):
            ends[endpoint.topic, endpoint.type_name][endpoint.kind].add(endpoint.node.name)
    return [
        {
            "topic": topic,
            "type": message,
            "writers": sorted(kinds["MP"]),
            "readers": sorted(kinds["MS"]),
        }
        for (topic, message), kinds in sorted(ends.items())
    ]


def _short(node: str, topic: str) -> str:
    """A node of the topic's own robot by its name alone."""
    own = f"/{topic.split('/')[1]}/"
    return node.removeprefix(own)


def _of_every_component(topic: str) -> bool:
    return topic == ROSOUT or topic.rpartition("/")[2] == STATUS_TOPIC
