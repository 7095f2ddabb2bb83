"""`cairn plugins`: the component classes that exist."""

from __future__ import annotations

from inspect import getdoc
from typing import Annotated, Any

import typer
from pydantic import BaseModel

from cairn.deployment.plugins import installed_plugins, load_plugin
from cairn.runtime.parameters import bounds_text
from cairn.runtime.ports import ports_of
from cairn.runtime.topic_ports import In, Out
from cairn.schemas.message import type_name
from cairn.system.kernel_compilation import deferred_compilation
from cairn.terminal.options import Json
from cairn.terminal.output import line, print_json, show


def plugins(
    plugin: Annotated[
        str,
        typer.Argument(
            help="Show the ports and parameters of this one; package.module:Class works too.",
            metavar="PLUGIN",
        ),
    ] = "",
    json: Json = False,
) -> None:
    """List the installed plugins, or show one with its ports and parameters.

    For a plugin that cannot be imported, the reason is listed.
    """
    if plugin:
        _show_one(plugin, as_json=json)
        return
    with deferred_compilation():  # nothing waits for kernels, because no component runs
        plugins = installed_plugins()
    rows = [
        {
            "plugin": found.name,
            "summary": found.error or found.summary,
            "reads": [_port(port) for port in found.ports if port.direction == "in"],
            "writes": [_port(port) for port in found.ports if port.direction == "out"],
            "class": found.target,
            "package": found.package,
            "usable": not found.error,
        }
        for found in plugins
    ]
    show(rows, ("plugin", "package", "summary"), as_json=json, nothing="no plugin is installed")


def _show_one(reference: str, *, as_json: bool) -> None:
    with deferred_compilation():
        cls = load_plugin(reference)
    ports = [_port(port) for port in ports_of(cls).values()]
    parameters: list[dict[str, Any]] = [
        {
            "parameter": name,
            "default": "required" if field.is_required() else field.get_default(),
            "bounds": bounds_text(field),
            "description": field.description or "",
        }
        for name, field in cls.config_class().model_fields.items()
    ]
    text = getdoc(cls) or ""
    if as_json:
        print_json(
            {"plugin": reference, "text": text, "ports": ports, "parameters": _plain(parameters)}
        )
        return
    line(f"{reference}: {text}\n")
    show(ports, ("port", "direction", "type", "qos"), as_json=False, nothing="no ports")
    line("")
    shown = ("parameter", "default", "bounds", "description")
    rows = [row | {"default": _default_text(row["default"])} for row in parameters]
    show(rows, shown, as_json=False, nothing="no parameters")


def _default_text(default: object) -> object:
    """Return a default with all its digits: tables print two, which is too coarse for radians.

    For a group of parameters, return those that it sets.
    """
    if isinstance(default, BaseModel):
        given = ((name, getattr(default, name)) for name in type(default).model_fields)
        return " ".join(f"{name}={value}" for name, value in given if value not in (None, {}, ()))
    return f"{default:.7g}" if isinstance(default, float) else default


def _plain(parameters: list[dict[str, Any]]) -> list[dict[str, Any]]:
    simple = str | int | float | bool | None
    return [
        {key: value if isinstance(value, simple) else str(value) for key, value in row.items()}
        for row in parameters
    ]


def _port(port: In[Any] | Out[Any]) -> dict[str, str]:
    is_optional = isinstance(port, In) and port.optional
    qos = f"{port.qos.reliability}, {port.qos.durability}, depth {port.qos.depth}"
    return {
        "port": port.name,
        "direction": f"{port.direction}, optional" if is_optional else port.direction,
        "type": type_name(port.interface),
        "qos": qos.replace("_", " "),
    }
