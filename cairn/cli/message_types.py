"""Finds message classes by their ROS 2 name: ours, and those of installed plugins' ports."""

import importlib
import pkgutil
from collections.abc import Iterator
from typing import Any

from cairn import schemas
from cairn.deployment.plugins import installed_plugins
from cairn.deployment.problems import suggestion
from cairn.errors import CairnError
from cairn.schemas.message import fields_of, type_name


def known_messages() -> dict[str, type[Any]]:
    """All message classes by type name."""
    return _of_plugins() | _of_schemas()


def find_message(name: str) -> type[Any]:
    """The message class of a type name; `CairnError` with the nearest ones if there is none."""
    ours = _of_schemas()  # first, because plugins take their time to import
    if name in ours:
        return ours[name]
    known = _of_plugins() | ours
    if name not in known:
        raise CairnError(
            f"unknown message type {name}; {suggestion(name, sorted(known))} (`cairn schema list` "
            "lists all: Cairn's own and those of the ports of installed plugins)"
        )
    return known[name]


def _of_schemas() -> dict[str, type[Any]]:
    found: dict[str, type[Any]] = {}
    for module_info in pkgutil.iter_modules(schemas.__path__, "cairn.schemas."):
        module = importlib.import_module(module_info.name)
        for value in vars(module).values():
            if isinstance(value, type) and value.__module__ == module.__name__:
                try:
                    found[type_name(value)] = value
                except TypeError:
                    continue  # a class beside the messages
    return found


def _of_plugins() -> dict[str, type[Any]]:
    return {
        type_name(message): message
        for plugin in installed_plugins()
        for port in plugin.ports
        for message in _with_parts(port.message)
    }


def _with_parts(message: type[Any]) -> Iterator[type[Any]]:
    yield message
    for field in fields_of(message):
        if isinstance(field.element, type):
            yield from _with_parts(field.element)
