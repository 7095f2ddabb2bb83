"""What a recording keeps of a run besides messages: deployment, parameters, versions, seed."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from cairn.deployment.exclusive_topics import ports_in
from cairn.deployment.model import Deployment
from cairn.deployment.plugins import PluginError, load_plugin
from cairn.schemas.interfaces import find_message
from cairn.schemas.message import classes_in, type_name

_PACKAGES = {
    "cairn": "cairn-robotics", "zenoh": "eclipse-zenoh", "numpy": "numpy", "numba": "numba",
}  # fmt: skip


def run_attachments(
    deployment: Deployment, parameters: Mapping[str, Any], *, seed: int, lockstep: bool
) -> dict[str, bytes]:
    """Return the attachments of a recording of that deployment, by name.

    `parameters` are those of each component, by their names.
    """
    run = {
        "robot": deployment.robot.name,
        "domain": deployment.domain,
        "seed": seed,
        "lockstep": lockstep,
        "clock": deployment.clock,
    }
    return {
        "deployment.json": as_json(deployment.model_dump(mode="json")),
        "parameters.json": as_json(parameters),
        "run.json": as_json(run),
        "versions.json": as_json(versions()),
    }


def versions() -> dict[str, str]:
    """Return the versions of what a run depends on."""
    found: dict[str, str] = {}
    for name, package in _PACKAGES.items():
        with suppress(PackageNotFoundError):  # an extra that is not installed
            found[name] = version(package)
    return {**found, "python": sys.version.partition(" ")[0]}


def as_json(value: Mapping[str, Any]) -> bytes:
    """Return a value as an attachment."""
    return json.dumps(value, indent=2).encode()


def started_parameters(deployment: Deployment) -> dict[str, Any]:
    """Return the parameters with which each component starts, with their defaults.

    This imports the plugins, which the process of a component has done before.
    """
    found: dict[str, Any] = {}
    for member in deployment.members():
        try:
            config = load_plugin(member.spec.plugin).config_class()
        except PluginError:  # its own start reports why
            continue
        found[member.name] = config.model_validate(member.spec.parameters).model_dump(mode="json")
    return found


class MessageClasses:
    """Finds message classes: those with definitions, then those of a deployment's plugins' ports.

    The plugins are imported with the first message of another type.
    """

    def __init__(self, deployment: Deployment | None) -> None:
        self._of_plugins: dict[str, type[Any]] = {}
        self._deployment = deployment

    def find(self, name: str) -> type[Any] | None:
        """Return the message class of a type name; None if it is not known."""
        known = find_message(name)
        if known is None and self._deployment is not None:
            for _, _, port in ports_in(self._deployment):
                for message in classes_in(port.interface):
                    self._of_plugins.setdefault(type_name(message), message)
            self._deployment = None
        return known or self._of_plugins.get(name)
