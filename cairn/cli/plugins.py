"""`cairn plugins`: the component classes that deployments can name."""

from cairn.cli.connection import Json
from cairn.cli.tables import show
from cairn.deployment.plugins import installed
from schemas.message import type_name


def plugins(json: Json = False) -> None:
    """List the installed plugins with their ports; one that cannot be imported says why."""
    rows = [
        {
            "plugin": plugin.name,
            "summary": plugin.error or plugin.summary,
            "reads": [_port(p.name, p.message) for p in plugin.ports if p.direction == "in"],
            "writes": [_port(p.name, p.message) for p in plugin.ports if p.direction == "out"],
            "class": plugin.target,
            "package": plugin.package,
            "usable": not plugin.error,
        }
        for plugin in installed()
    ]
    show(rows, ("plugin", "summary", "reads", "writes", "package"), as_json=json)


def _port(name: str, message: type) -> str:
    return f"{name} ({type_name(message)})"
