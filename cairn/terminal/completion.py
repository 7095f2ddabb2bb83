"""What completes the arguments of commands in a shell: names of deployments and of a running robot.

The error about a missing argument lists the same names. Nothing is imported before it is needed.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import typer

from cairn.errors import CairnError

if TYPE_CHECKING:
    from cairn.client import Robot

_LIMIT_S = 1.0
"""A robot that does not answer within this time has no names to complete."""

_FRAMES_S = 0.25
"""How long frames are collected: transforms of slow publishers are not waited for."""


def deployments(incomplete: str) -> list[str]:
    """Return the shipped deployments, by name."""
    from cairn.deployment.shipped import shipped

    return _matching((one.name for one in shipped() if not one.is_overlay), incomplete)


def overlays(incomplete: str) -> list[str]:
    """Return the shipped overlays, by name."""
    from cairn.deployment.shipped import shipped

    return _matching((one.name for one in shipped() if one.is_overlay), incomplete)


def topics(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the topics of the running robot."""

    def read(robot: Robot) -> list[str]:
        from cairn.bus.keys import is_infrastructure

        return [one.name for one in robot.topics() if not is_infrastructure(one.name)]

    return _matching(_short_names(_asked(ctx, read)), incomplete)


def components(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the components of the running robot, also those that are not loaded."""

    def read(robot: Robot) -> list[str]:
        statuses = robot.connection.statuses()
        children = [
            f"{full.rpartition('/')[0]}/{child}"
            for full, status in statuses.items()
            for child in status.children
        ]
        return [*statuses, *children]

    return _matching(_short_names(_asked(ctx, read)), incomplete)


def nodes(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the nodes on the bus of the running robot, those of ROS 2 included."""
    return _matching(
        _short_names(_asked(ctx, lambda robot: [one.name for one in robot.nodes()])), incomplete
    )


def places(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the named places on the map of the running robot."""

    def read(robot: Robot) -> list[str]:
        from cairn.schemas.cairn_nav_msgs import Zone, Zones

        zones = robot.latest("zones", Zones, timeout_s=_LIMIT_S).zones
        return sorted(zone.name for zone in zones if zone.kind == Zone.PLACE)

    return _matching(_asked(ctx, read), incomplete)


def zones(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the zones on the map of the running robot."""

    def read(robot: Robot) -> list[str]:
        from cairn.schemas.cairn_nav_msgs import Zones

        return sorted(zone.name for zone in robot.latest("zones", Zones, timeout_s=_LIMIT_S).zones)

    return _matching(_asked(ctx, read), incomplete)


def frames(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the frames of the running robot."""

    def read(robot: Robot) -> list[str]:
        with robot.transforms() as transforms:
            transforms.await_transforms(_LIMIT_S / 2)
            time.sleep(_FRAMES_S)  # further topics
            return list(transforms.buffer.frames())

    return _matching(_asked(ctx, read), incomplete)


def parameters(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the parameters of the component that is given before."""
    component = ctx.params.get("component")
    if not isinstance(component, str):
        return []
    return _matching(_asked(ctx, lambda robot: list(robot.parameters(component))), incomplete)


def assignments(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the parameters of the component that is given before, each with a `=`."""
    return [f"{name}=" for name in parameters(ctx, incomplete)]


def interface_types(incomplete: str) -> list[str]:
    """Return the known types of messages, services and actions."""
    from cairn.schemas.interfaces import interface_type_names

    return _matching(interface_type_names(), incomplete)


def fields(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return the fields of the topic that is given before."""
    return _fields(ctx, incomplete, numeric=False)


def numbers(ctx: typer.Context, incomplete: str) -> list[str]:
    """Return those fields of the topic that is given before which are numbers."""
    return _fields(ctx, incomplete, numeric=True)


def _fields(ctx: typer.Context, incomplete: str, *, numeric: bool) -> list[str]:
    topic = ctx.params.get("topic")
    if not isinstance(topic, str):
        return []

    def read(robot: Robot) -> list[str]:
        from cairn.deployment.message_types import find_message
        from cairn.terminal.fields import field_paths

        paths = field_paths(find_message(robot.find_topic(topic).type_name))
        return [path.text for path in paths if path.is_numeric or not numeric]

    return _matching(_asked(ctx, read), incomplete)


def _asked(ctx: typer.Context, read: Callable[[Robot], list[str]]) -> list[str]:
    """Return what a function reads of the running robot; nothing if there is no answer in time."""
    given = ctx.params
    endpoint = given.get("connect") or os.environ.get("CAIRN_CONNECT", "")
    domain = given.get("domain")
    found: list[str] = []

    def ask() -> None:
        from cairn.client import connect

        def ignore(_: str) -> None:
            """Print nothing: the shell shows only names."""

        try:
            name = str(given.get("robot") or "")
            with connect(str(endpoint), domain, name, notify=ignore) as robot:
                found.extend(read(robot))
        except (CairnError, OSError):
            return  # no robot runs, or it is one that this user may not ask

    thread = threading.Thread(target=ask, name="completion", daemon=True)
    thread.start()
    thread.join(_LIMIT_S)
    return [] if thread.is_alive() else found


def _short_names(full: Iterable[str]) -> list[str]:
    """Return `pose` instead of `/robot/pose` if there is one robot."""
    names = sorted(set(full))
    robots = {name.split("/")[1] for name in names if name.count("/") > 1}
    if len(robots) != 1:
        return names
    return sorted({name.removeprefix(f"/{next(iter(robots))}/") for name in names})


def _matching(names: Iterable[Any], incomplete: str) -> list[str]:
    return [name for name in names if name.startswith(incomplete)]
