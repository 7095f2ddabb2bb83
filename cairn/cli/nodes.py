"""`cairn node`: the nodes on the bus, those of ROS 2 included; how lists mark foreign nodes."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Annotated, Any

import typer

from cairn.bus.keys import is_infrastructure
from cairn.client import Endpoint, NodeInfo
from cairn.client import connect as connect_to
from cairn.client.connection import resolve
from cairn.terminal import completion
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.terminal.output import line, print_json, show

NODE_SERVICES = frozenset({
    "describe_parameters", "get_parameters", "get_parameter_types", "list_parameters",
    "set_parameters", "set_parameters_atomically", "get_type_description", "change_state",
    "get_state", "get_available_states", "get_available_transitions", "get_transition_graph",
    "list_nodes", "load_node", "unload_node",
})  # fmt: skip
"""Services that every component has: lists leave them out unless they are asked for."""

AllTopics = Annotated[
    bool, typer.Option("--all", help="Also those that every component has, such as /rosout.")
]

_VERBS = {
    "publishes": ("publisher",),
    "subscribes": ("subscriber",),
    "serves": ("service server", "action server"),
    "calls": ("service client", "action client"),
}
_FEW = 4  # names that a list shows of each kind

node = typer.Typer(help="The nodes on the bus: components, and nodes of ROS 2.")


@node.command("list")
def list_nodes(
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    json: Json = False,
) -> None:
    """List the nodes: the components, and foreign ones such as those of ROS 2."""
    with connect_to(connect, domain, robot) as client:
        nodes = client.nodes()
        elsewhere = "" if nodes else client.connection.elsewhere()
    rows = [
        {
            "node": one.name,
            "foreign": one.is_foreign,
            "kind": "foreign" if one.is_foreign else "component",
            **{key: names if json else len(names) for key, names in uses(one).items()},
            "note": note_on(one, short=True),
        }
        for one in nodes
    ]
    show(
        rows,
        ("node", "kind", *_VERBS, "note"),
        as_json=json,
        nothing=f"there is no node{elsewhere}",
    )


@node.command("info")
def show_node(
    name: Annotated[
        str,
        typer.Argument(
            help="As `cairn node list` has it.",
            metavar="NAME",
            autocompletion=completion.nodes,
        ),
    ],
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    all_: Annotated[
        bool,
        typer.Option("--all", help="Also what every component has, such as get_parameters."),
    ] = False,
    json: Json = False,
) -> None:
    """Print what a node publishes, subscribes, serves and calls, with types and QoS.

    If several nodes have the name, all are printed; JSON is a list.
    """
    with connect_to(connect, domain, robot) as client:
        nodes = client.nodes()
    full = resolve((one.name for one in nodes), name, robot)
    found: list[dict[str, Any]] = [
        {
            "node": one.name,
            "namespace": one.namespace,
            "foreign": one.is_foreign,
            "note": note_on(one, short=True),
            "endpoints": [_row(end) for end in one.endpoints if all_ or not _is_of_every_node(end)],
        }
        for one in nodes
        if one.name == full
    ]
    if json:
        print_json(found)
        return
    for info in found:
        title = marked(info["node"], info["foreign"])
        line("; ".join(filter(None, (title, info["note"]))))
        columns = ("role", "name", "type", "qos")
        show(info["endpoints"], columns, as_json=False, nothing="it has no endpoint")


def marked(name: str, is_foreign: bool) -> str:
    """Return the name of a node as lists show it."""
    return f"{name} (foreign)" if is_foreign else name


def marked_all(names: Iterable[str], foreign: Collection[str]) -> list[str]:
    """Return the names of nodes as lists show them, of which those in `foreign` are foreign."""
    return [marked(name, name in foreign) for name in names]


def uses(one: NodeInfo) -> dict[str, list[str]]:
    """Return the names of what a node uses, without what every node has."""
    return {
        verb: [
            end.name for end in one.endpoints if end.role in roles and not _is_of_every_node(end)
        ]
        for verb, roles in _VERBS.items()
    }


def note_on(one: NodeInfo, *, short: bool = False) -> str:
    """Return what a list says about a node: that its name is not unique; what it uses."""
    parts = [] if one.is_unique else ["another node has this name"]
    if not short:
        parts += [f"{verb} {_counted(names)}" for verb, names in uses(one).items() if names]
    return "; ".join(parts)


def _counted(names: list[str]) -> str:
    """Return a few names, and the number of further ones."""
    few = ", ".join(names[:_FEW])
    return f"{few} and {len(names) - _FEW} more" if len(names) > _FEW else few


def _is_of_every_node(end: Endpoint) -> bool:
    if end.role in ("publisher", "subscriber"):
        return is_infrastructure(end.name)
    return end.name.rpartition("/")[2] in NODE_SERVICES


def _row(end: Endpoint) -> dict[str, Any]:
    of_topic = end.role in ("publisher", "subscriber")
    return {
        "role": end.role,
        "name": end.name,
        "type": end.type_name,
        "hash": end.type_hash,
        "qos": str(end.qos) if of_topic else "",
    }
