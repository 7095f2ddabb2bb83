"""`cairn graph`: which component writes and reads which topic."""

from collections import defaultdict

from cairn.bus import rmw
from cairn.cli.connection import DEFAULT_CONNECT, Connect, Domain, Json, connected
from cairn.cli.tables import show


def graph(connect: Connect = DEFAULT_CONNECT, domain: Domain = 0, json: Json = False) -> None:
    """List every topic with its message type, who writes it and who reads it."""
    with connected(connect, domain) as connection:
        endpoints = connection.endpoints()
    show(rows(endpoints), ("topic", "type", "writers", "readers"), as_json=json)


def rows(endpoints: list[rmw.EndpointEntity]) -> list[dict[str, object]]:
    """One row for each topic and message type, sorted."""
    ends: dict[tuple[str, str], dict[str, set[str]]] = defaultdict(
        lambda: {"MP": set(), "MS": set()}
    )
    for endpoint in endpoints:
        if endpoint.kind in ("MP", "MS"):
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
