"""Types of messages, services and actions by name: defined ones, and those of plugins' ports."""

from __future__ import annotations

from difflib import get_close_matches
from typing import Any

from cairn.deployment.plugins import installed_plugins
from cairn.deployment.problems import suggestion
from cairn.errors import CairnError
from cairn.schemas.definitions import DefinitionError, full_type_name
from cairn.schemas.interfaces import find_message as find_defined_message
from cairn.schemas.interfaces import interface, interface_type_names
from cairn.schemas.message import Action, Service, classes_in, type_name
from cairn.system.kernel_compilation import deferred_compilation


def find_type(name: str) -> type[Any]:
    """Return the class of a message, service or action; `CairnError` if there is none.

    A name without its package will do if only one has it. The plugins, which take time, are
    imported only for a type that is not known without them.
    """
    full = full_type_name(name) if "/" in name else _with_package(name)
    try:
        return interface(full)
    except DefinitionError as error:
        known = messages_of_plugins()
        if full in known:
            return known[full]
        names = sorted({*interface_type_names(), *known})
        if full in names:  # its file is wrong
            raise
        raise CairnError(
            f"unknown type {name}; {suggestion(full, names)} (`cairn schema list` lists all: those "
            "of ROS 2 and Cairn, of imported packages, and of the ports of installed plugins)"
        ) from error


def _with_package(name: str) -> str:
    names = sorted({*interface_type_names(), *messages_of_plugins()})
    found = [full for full in names if full.rpartition("/")[2] == name]
    if len(found) > 1:
        raise CairnError(f"{name}: several packages have it: {', '.join(found)}; give one of these")
    if not found:
        close = get_close_matches(name, dict.fromkeys(full.rpartition("/")[2] for full in names))
        found = [full for full in names if full.rpartition("/")[2] in close]
        guess = f"did you mean {' or '.join(found)}?" if found else "give it with its package"
        raise CairnError(f"unknown type {name}; {guess} (`cairn schema list` lists all)")
    return found[0]


def find_message(name: str) -> type[Any]:
    """Return the message class of a type name; `CairnError` with similar names if there is none."""
    found = find_type(name)
    if issubclass(found, Service | Action):
        raise CairnError(f"{name} is not a message, but a service or action")
    return found


def messages_of_plugins() -> dict[str, type[Any]]:
    """Return the messages of the ports of plugins that no definition or class of ours describes."""
    with deferred_compilation():
        found = installed_plugins(of_cairn=False)
    messages = {
        type_name(message): message
        for plugin in found
        for port in plugin.ports
        for message in classes_in(port.interface)
    }
    return {name: one for name, one in messages.items() if find_defined_message(name) is None}
