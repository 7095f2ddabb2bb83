"""`cairn service` and `cairn action`: list and use the services and actions on the bus.

Below `cairn service` are also the commands that run a deployment as a service of systemd.
"""

from __future__ import annotations

import json as json_module
from typing import Annotated, Any

import typer
import yaml

from cairn.bus.actions import STATUS_TEXT
from cairn.bus.codec import to_plain
from cairn.cli import systemd_service
from cairn.cli.nodes import NODE_SERVICES, marked_all
from cairn.client import ServiceInfo
from cairn.client import connect as connect_to
from cairn.client.connection import resolve
from cairn.errors import CairnError
from cairn.schemas.action_msgs.msg import GoalStatus
from cairn.schemas.interfaces import interface
from cairn.terminal.fields import message_of, plain_values
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.terminal.output import line, print_json, print_problems, show

service = typer.Typer(
    help="The services on the bus (list, call); a robot as a service of systemd (install, status, "
    "uninstall)."
)
service.command("install")(systemd_service.install)
service.command("status")(systemd_service.status)
service.command("uninstall")(systemd_service.uninstall)
action = typer.Typer(help="The actions on the bus.")

Fields = Annotated[
    str,
    typer.Argument(
        help="Fields, YAML or JSON, as in '{data: true}'; those that are not given have their "
        "defaults.",
        metavar="[FIELDS]",
    ),
]


@service.command("list")
def list_services(
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    all_: Annotated[
        bool,
        typer.Option("--all", help="Also those that every component has, such as get_parameters."),
    ] = False,
    json: Json = False,
) -> None:
    """List the services with their types, servers and clients."""
    with connect_to(connect, domain, robot) as client:
        found = client.services()
    shown = [one for one in found if all_ or one.name.rpartition("/")[2] not in NODE_SERVICES]
    nothing = "no service is provided"
    if found and not shown:
        nothing = f"only the {len(found)} services that every component has: --all lists them"
    _show(shown, "service", nothing, as_json=json)


@service.command("call")
def call_service(
    name: Annotated[str, typer.Argument(metavar="SERVICE", help="As `cairn service list` has it.")],
    fields: Fields = "{}",
    timeout: Annotated[float, typer.Option(min=0.01, help="Limit for the answer [s].")] = 5.0,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    json: Json = False,
) -> None:
    """Call a service and print the response."""
    values = plain_values(name, fields)
    with connect_to(connect, domain, robot) as client:
        found = _find(client.services(), name, robot)
        kind = interface(found.type_name)
        request = message_of(kind.Request, values)
        response = client.call(found.name, kind, request, timeout_s=timeout)
    _print(response, as_json=json)


@action.command("list")
def list_actions(
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    json: Json = False,
) -> None:
    """List the actions with their types, servers and clients."""
    with connect_to(connect, domain, robot) as client:
        found = client.actions()
    _show(found, "action", "no action is provided", as_json=json)


@action.command("send")
def send_goal(
    name: Annotated[str, typer.Argument(metavar="ACTION", help="As `cairn action list` has it.")],
    fields: Fields = "{}",
    feedback: Annotated[
        bool, typer.Option("--feedback", "-f", help="Print the feedback, too.")
    ] = False,
    timeout: Annotated[
        float, typer.Option(min=0.01, help="Limit for the acceptance of the goal [s].")
    ] = 5.0,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: RobotName = "",
    json: Json = False,
) -> None:
    """Send a goal, and print the result when it has ended; Ctrl-C cancels it.

    Exit status 0 if the goal succeeds, 1 if not.
    """
    values = plain_values(name, fields)
    with connect_to(connect, domain, robot) as client:
        found = _find(client.actions(), name, robot)
        kind = interface(found.type_name)
        goal = message_of(kind.Goal, values)
        with client.send_goal(found.name, kind, goal, timeout_s=timeout) as sent:
            try:
                if not json:
                    line(f"goal {sent.id} accepted; Ctrl-C cancels")
                for one in sent:
                    if feedback:
                        _print(one, as_json=json)
                status, result = sent.result()
            except KeyboardInterrupt:
                sent.cancel()
                raise
    if json:
        print_json({"goal": sent.id, "status": STATUS_TEXT[status], "result": to_plain(result)})
    else:
        line(f"{STATUS_TEXT[status]}:")
        _print(result, as_json=False)
    if status != GoalStatus.STATUS_SUCCEEDED:
        raise CairnError(f"the goal was {STATUS_TEXT[status]}")


def _find(found: list[ServiceInfo], name: str, robot: str) -> ServiceInfo:
    served = {one.name: one for one in found if one.servers}
    return served[resolve(served, name, robot)]


def _show(found: list[ServiceInfo], kind: str, nothing: str, *, as_json: bool) -> None:
    rows = [
        {
            kind: one.name,
            "type": one.type_name,
            "servers": one.servers if as_json else marked_all(one.servers, one.foreign),
            "clients": one.clients if as_json else marked_all(one.clients, one.foreign),
            "foreign": one.foreign,
            "problems": one.problems,
        }
        for one in found
    ]
    show(rows, (kind, "type", "servers", "clients"), as_json=as_json, nothing=nothing)
    print_problems(problem for one in found for problem in one.problems)


def _print(message: Any, *, as_json: bool) -> None:
    value = to_plain(message)
    if as_json:
        line(json_module.dumps(value))
    else:
        line(yaml.safe_dump(value, sort_keys=False, default_flow_style=None).rstrip())
