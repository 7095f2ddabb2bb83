"""Finds message classes by their ROS 2 name, those of installed plugins included."""

import importlib
import pkgutil
from typing import Any

import schemas
from cairn.errors import CairnError
from schemas.message import type_name


def known_messages() -> dict[str, type[Any]]:
    """All message classes of the package `schemas` by type name."""
    found: dict[str, type[Any]] = {}
    for module_info in pkgutil.iter_modules(schemas.__path__, "schemas."):
        module = importlib.import_module(module_info.name)
        for value in vars(module).values():
            if isinstance(value, type) and value.__module__ == module.__name__:
                try:
                    found[type_name(value)] = value
                except TypeError:
                    continue  # a class beside the messages
    return found


def find_message(name: str, *candidates: type[Any]) -> type[Any]:
    """The message class of a type name, among ours and the `candidates`.

    Raises `CairnError` listing the known ones if there is none.
    """
    known = known_messages() | {type_name(message): message for message in candidates}
    if name not in known:
        raise CairnError(f"unknown message type {name}; known are {', '.join(sorted(known))}")
    return known[name]
