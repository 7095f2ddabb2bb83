"""`cairn stop|load|unload|restart|param`: change a running deployment."""

from __future__ import annotations

import getpass
import json as json_module
import os
from dataclasses import asdict
from typing import Annotated, Any

import typer

from cairn.client import Parameter
from cairn.client import connect as connect_to
from cairn.deployment.problems import suggestion
from cairn.errors import CairnError
from cairn.terminal import completion
from cairn.terminal.fields import yaml_value
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.terminal.output import line, note, show

param = typer.Typer(help="Read and change the parameters of running components.")

Child = Annotated[
    str,
    typer.Argument(
        help="Name of the component.", metavar="NAME", autocompletion=completion.components
    ),
]
Component = Annotated[
    str,
    typer.Argument(
        help="Name of the component.", metavar="COMPONENT", autocompletion=completion.components
    ),
]


def stop(
    release: Annotated[
        bool, typer.Option("--release", help="Release the emergency stop; goals go on.")
    ] = False,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Engage the emergency stop at the velocity gate, or release it.

    The exit status is 1 if the gate does not confirm it within a second.
    """
    with connect_to(connect, domain, robot, notify=note) as client:
        if release:
            client.release_stop()
            line("emergency stop released")
        else:
            user = os.environ.get("CAIRN_USER") or getpass.getuser()
            status = client.stop(f"requested by user {user} (cairn stop)")
            line(f"{status.reason}; release it with `cairn stop --release`")


def load(
    name: Child, connect: Connect = DEFAULT_CONNECT, domain: Domain = 0, robot: RobotName = ""
) -> None:
    """Start a component that is not loaded: one with `load: on_request`, or one that has ended."""
    with connect_to(connect, domain, robot, notify=note) as client:
        line(f"{name}: {client.load(name)}")


def unload(
    name: Child, connect: Connect = DEFAULT_CONNECT, domain: Domain = 0, robot: RobotName = ""
) -> None:
    """Stop a component and leave it stopped; the others go on."""
    with connect_to(connect, domain, robot, notify=note) as client:
        line(f"{name}: {client.unload(name)}")


def restart(
    name: Child, connect: Connect = DEFAULT_CONNECT, domain: Domain = 0, robot: RobotName = ""
) -> None:
    """Stop a component and start it again; the others go on."""
    with connect_to(connect, domain, robot, notify=note) as client:
        line(f"{name}: {client.restart(name)}")


@param.command("list")
def list_parameters(
    component: Component,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    json: Json = False,
) -> None:
    """List a component's parameters with value, bounds and meaning."""
    with connect_to(connect, domain, robot) as client:
        parameters = client.parameters(component).values()
    columns = ("name", "value", "type", "bounds", "description")
    rows = [asdict(one) if json else _readable(one) for one in parameters]
    show(rows, columns, as_json=json)


@param.command("get")
def get_parameter(
    component: Component,
    parameter: Annotated[
        str,
        typer.Argument(
            help="Its (dotted) name.",
            metavar="PARAMETER",
            autocompletion=completion.parameters,
        ),
    ],
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Print the value of one parameter as JSON."""
    with connect_to(connect, domain, robot) as client:
        parameters = client.parameters(component)
    inside = [name for name in parameters if name.startswith(f"{parameter}.")]
    if inside:
        raise CairnError(f"{component}: {parameter} is a group; it has {', '.join(inside)}")
    if parameter not in parameters:
        remedy = suggestion(parameter, parameters)
        raise CairnError(f"{component} has no parameter {parameter}; {remedy}")
    line(json_module.dumps(parameters[parameter].value))


@param.command("set")
def set_parameters(
    component: Component,
    changes: Annotated[
        list[str],
        typer.Argument(
            help="Changes, made all or none.",
            metavar="NAME=VALUE...",
            autocompletion=completion.assignments,
        ),
    ],
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
) -> None:
    """Change parameters of a running component, all or none, until it is restarted.

    Values are YAML: 5 is a number, true a boolean, '"5"' a text.
    """
    values: dict[str, Any] = {}
    for change in changes:
        name, equals, value = change.partition("=")
        if not equals:
            raise CairnError(f"{change!r} is not a change; write NAME=VALUE")
        values[name] = yaml_value(name, value)
    with connect_to(connect, domain, robot) as client:
        client.set_parameters(component, values)
    for name, value in values.items():
        line(f"{component}.{name} = {json_module.dumps(value)}")


def _readable(parameter: Parameter) -> dict[str, Any]:
    """Return a row for people: all digits, and `Literal['a', 'b']` as a choice of a and b."""
    shown = {**asdict(parameter), "value": json_module.dumps(parameter.value)}
    if not parameter.type.startswith("Literal["):
        return shown
    choices = parameter.type.removeprefix("Literal[").removesuffix("]").replace("'", "")
    return {**shown, "type": "choice", "bounds": choices}
