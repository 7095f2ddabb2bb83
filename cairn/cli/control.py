"""`cairn load|unload|restart`: orders to the supervisor of a component."""

from typing import Annotated

import typer

from cairn.bus.control import request
from cairn.cli.connection import DEFAULT_CONNECT, Connect, Connection, Domain, Robot, connected
from cairn.cli.tables import line
from cairn.errors import CairnError

Name = Annotated[str, typer.Argument(help="The component's name.", metavar="NAME")]
_LIMIT_S = 90.0  # beyond what a component takes to stop and to start, unless it is given more


def load(
    name: Name, connect: Connect = DEFAULT_CONNECT, domain: Domain = 0, robot: Robot = ""
) -> None:
    """Load a component of the deployment that is not loaded: on order, unloaded or ended."""
    _order("load", name, connect, domain, robot)


def unload(
    name: Name, connect: Connect = DEFAULT_CONNECT, domain: Domain = 0, robot: Robot = ""
) -> None:
    """Stop a component and leave it unloaded; the others go on."""
    _order("unload", name, connect, domain, robot)


def restart(
    name: Name, connect: Connect = DEFAULT_CONNECT, domain: Domain = 0, robot: Robot = ""
) -> None:
    """Stop a component and start it anew; the others go on."""
    _order("restart", name, connect, domain, robot)


def _order(verb: str, name: str, connect: str, domain: int, robot: str) -> None:
    with connected(connect, domain) as connection:
        supervisor = _supervisor(connection, name, robot)
        state = request(
            connection.session, domain, supervisor, verb, {"name": name}, timeout_s=_LIMIT_S
        )
    line(f"{name}: {state}")


def _supervisor(connection: Connection, name: str, robot: str) -> str:
    """The supervisor that has a child of that name: each of them knows its own."""
    known: dict[str, str] = {}
    for node, status in connection.statuses().items():
        of_robot = node.split("/")[1]
        if robot and of_robot != robot:
            continue
        for child in status.children:
            known[f"/{of_robot}/{child}"] = node
    owners = [node for full, node in known.items() if full.rpartition("/")[2] == name]
    if len(owners) == 1:
        return owners[0]
    if owners:
        raise CairnError(f"several robots have a component {name}; give --robot")
    listed = ", ".join(sorted(known)) or "none"
    raise CairnError(f"no supervisor has a component {name}; they have: {listed}")
