"""`cairn param list|get|set`: the parameters of a running component."""

import json as json_module
from typing import Annotated, Any

import typer
import yaml

from cairn.bus import keys
from cairn.bus.control import request
from cairn.cli.connection import (
    DEFAULT_CONNECT,
    Connect,
    Connection,
    Domain,
    Json,
    Robot,
    connected,
    resolve,
)
from cairn.cli.tables import line, show
from cairn.errors import CairnError

app = typer.Typer(help="Read and change the parameters of running components.")
Name = Annotated[str, typer.Argument(help="The component's name.", metavar="COMPONENT")]
_LIMIT_S = 5.0


@app.command("list")
def list_(
    component: Name,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: Robot = "",
    json: Json = False,
) -> None:
    """List a component's parameters with value, bounds and meaning."""
    with connected(connect, domain) as connection:
        parameters = _ask(connection, component, robot, "parameters", {})
    columns = ("name", "value", "type", "bounds", "description")
    rows = parameters if json else [_readable(parameter) for parameter in parameters]
    show(rows, columns, as_json=json, nothing=f"{component} has no parameters")


@app.command()
def get(
    component: Name,
    parameter: Annotated[str, typer.Argument(help="Its (dotted) name.", metavar="PARAMETER")],
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: Robot = "",
) -> None:
    """Print one parameter's value as JSON."""
    with connected(connect, domain) as connection:
        parameters = _ask(connection, component, robot, "parameters", {})
    values = {entry["name"]: entry["value"] for entry in parameters}
    inside = [name for name in values if name.startswith(f"{parameter}.")]
    if inside:
        raise CairnError(f"{component}: {parameter} is a group; it has {', '.join(inside)}")
    if parameter not in values:
        raise CairnError(f"{component} has no parameter {parameter}; it has {', '.join(values)}")
    line(json_module.dumps(values[parameter]))


@app.command("set")
def set_(
    component: Name,
    changes: Annotated[
        list[str], typer.Argument(help="Changes, made all or none.", metavar="NAME=VALUE...")
    ],
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: Robot = "",
) -> None:
    """Change parameters of a running component, all or none, until it is started anew.

    Values are YAML: 5 is a number, true a boolean, '"5"' a text.
    """
    values: dict[str, Any] = {}
    for change in changes:
        name, equals, value = change.partition("=")
        if not equals:
            raise CairnError(f"{change!r} is not a change; write NAME=VALUE")
        try:
            values[name] = yaml.safe_load(value)
        except (yaml.YAMLError, ValueError) as error:
            what = " ".join(str(error).split())
            raise CairnError(f"{name}: {value!r} is not a YAML value: {what}") from error
    with connected(connect, domain) as connection:
        _ask(connection, component, robot, "set_parameters", values)
    for name, value in values.items():
        line(f"{component}.{name} = {json_module.dumps(value)}")


def _readable(parameter: dict[str, Any]) -> dict[str, Any]:
    """For people: all digits of a value, and `Literal['a', 'b']` a choice bounded to a and b."""
    shown = {**parameter, "value": json_module.dumps(parameter["value"])}
    kind = str(parameter["type"])
    if not kind.startswith("Literal["):
        return shown
    choices = kind.removeprefix("Literal[").removesuffix("]").replace("'", "")
    return {**shown, "type": "choice", "bounds": choices}


def _ask(
    connection: Connection, component: str, robot: str, verb: str, arguments: dict[str, Any]
) -> Any:
    nodes = [entity.name for entity in connection.graph() if isinstance(entity, keys.NodeEntity)]
    full = resolve(nodes, component, robot)
    return request(connection.session, connection.domain, full, verb, arguments, timeout_s=_LIMIT_S)
