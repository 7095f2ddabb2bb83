"""`cairn plugins`: the component classes that deployments can name."""

from inspect import getdoc
from typing import Annotated, Any

import typer
from pydantic import BaseModel

from cairn.cli.connection import Json
from cairn.cli.tables import line, print_json, show
from cairn.deployment.plugins import installed_plugins, load_plugin
from cairn.runtime.parameters import bounds_text
from cairn.runtime.ports import PortSpec, ports_of
from cairn.schemas.message import type_name


def plugins(
    plugin: Annotated[
        str,
        typer.Argument(
            help="Show this one's ports and parameters; package.module:Class too.",
            metavar="PLUGIN",
        ),
    ] = "",
    json: Json = False,
) -> None:
    """List the installed plugins, or show one with its ports and parameters.

    One that cannot be imported says why.
    """
    if plugin:
        _show_one(plugin, as_json=json)
        return
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
        for found in installed_plugins()
    ]
    show(rows, ("plugin", "package", "summary"), as_json=json, nothing="no plugin is installed")


def _show_one(reference: str, *, as_json: bool) -> None:
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
    told = [row | {"default": _told(row["default"])} for row in parameters]
    show(told, shown, as_json=False, nothing="no parameters")


def _told(default: object) -> object:
    """A default as it is: a table's figures have two places, which is no resolution [rad].

    Of a group, what it sets.
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


def _port(port: PortSpec) -> dict[str, str]:
    qos = f"{port.qos.reliability}, {port.qos.durability}, depth {port.qos.depth}"
    return {
        "port": port.name,
        "direction": port.direction + (", optional" if port.optional else ""),
        "type": type_name(port.message),
        "qos": qos.replace("_", " "),
    }
