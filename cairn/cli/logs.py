"""`cairn logs`: what the components have to say, as they keep it on /rosout."""

from contextlib import nullcontext
from typing import Annotated

import typer

from cairn.bus import keys
from cairn.bus.codec import Codec
from cairn.cli.connection import (
    DEFAULT_CONNECT,
    Connect,
    Domain,
    Robot,
    check_robot,
    connected,
    resolve,
)
from cairn.cli.tables import line, note
from cairn.runtime.rosout import ROSOUT, render
from cairn.schemas.message import InvalidMessage
from cairn.schemas.rcl_interfaces import Log


def logs(
    component: Annotated[str, typer.Argument(help="Only this component.", metavar="NAME")] = "",
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: Robot = "",
    follow: Annotated[bool, typer.Option("--follow", "-f", help="Go on as they come.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print a line of JSON each.")] = False,
) -> None:
    """Print the last log messages of the running components in order of time."""
    codec = Codec()
    key = keys.message_key(domain, ROSOUT, Log, codec)
    with connected(connect, domain) as connection:
        writers = [
            end for end in connection.endpoints() if end.kind == "MP" and end.topic == ROSOUT
        ]
        check_robot(robot, (end.node.name.split("/")[1] for end in writers))
        if component:
            resolve([end.node.name for end in writers], component, robot)
        # Listening begins first, so that nothing is missed in between.
        with connection.listen(key, latched=True) if follow else nullcontext() as samples:
            kept, complete = connection.kept(key)
            seen = dict.fromkeys(sample.payload.to_bytes() for sample in kept)  # each once
            history = [entry for payload in seen for entry in _decoded(codec, payload)]
            printed = [
                _print(entry, component, robot, json=json)
                for entry in sorted(history, key=lambda log: (log.stamp.sec, log.stamp.nanosec))
            ]
            if not complete:
                note(
                    "a component does not answer; what it said stands in logs/ of the run's folder"
                )
            if component and not any(printed):
                note(
                    f"{component} has logged nothing since it was started; what it said before "
                    f"that stands in logs/{component}.log of the run's folder, which `cairn up` "
                    "names"
                )
            while samples is not None:
                payload = samples.get().payload.to_bytes()
                if payload in seen:
                    continue
                for entry in _decoded(codec, payload):
                    _print(entry, component, robot, json=json)


def _decoded(codec: Codec, payload: bytes) -> list[Log]:
    try:
        return [codec.decode(Log, payload)]
    except InvalidMessage:
        return []  # a foreign node's log that is not valid is not ours to print


def _print(entry: Log, component: str, robot: str, *, json: bool) -> bool:
    of_robot, _, name = entry.name.partition(".")
    if (component and component != name) or (robot and robot != of_robot):
        return False
    line(render(entry, as_json=json))
    return True
