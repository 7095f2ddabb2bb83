"""`cairn logs`: the last log messages of the running components, and new ones."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Annotated

import typer

from cairn.client import connect as connect_to
from cairn.runtime.rosout import render
from cairn.schemas.message import InvalidMessage
from cairn.schemas.rcl_interfaces import Log
from cairn.terminal import completion
from cairn.terminal.options import DEFAULT_CONNECT, Connect, Domain, RobotName
from cairn.terminal.output import line, note


def logs(
    component: Annotated[
        str,
        typer.Argument(
            help="Only this component.", metavar="NAME", autocompletion=completion.components
        ),
    ] = "",
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
