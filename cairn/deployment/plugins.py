"""Plugins: find component classes by entry point of an installed package or as module:Class."""

import importlib
import importlib.util
import json
import sys
import traceback
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import Distribution, EntryPoint, distributions, entry_points
from inspect import getdoc
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cairn.deployment.problems import suggestion
from cairn.errors import CairnError
from cairn.runtime.ports import ports_of
from cairn.runtime.topic_ports import In, Out
from cairn.system.extras import missing_library

if TYPE_CHECKING:
    from cairn.runtime.component import Component

GROUP = "cairn.components"


class PluginError(CairnError):
    """A plugin does not exist, cannot be imported, or is not a component; with the remedy."""

    def __init__(self, found: str, remedy: str) -> None:
        super().__init__(f"{found}; {remedy}")
        self.found = found
        self.remedy = remedy


@dataclass(frozen=True)
class Plugin:
    """An installed plugin; `error` says why its class cannot be used, "" if it can."""

    name: str
    target: str
    package: str
    summary: str = ""
    ports: tuple[In[Any] | Out[Any], ...] = ()
    error: str = ""


def installed_plugins(*, of_cairn: bool = True) -> list[Plugin]:
    """Return all installed plugins sorted by name, also those that cannot be imported.

    Without those `of_cairn`, only the packages of others are imported.
    """
    points = sorted(_entry_points(), key=lambda point: point.name)
    return [_listed(point) for point in points if of_cairn or not point.value.startswith("cairn.")]


def load_plugin(reference: str) -> "type[Component]":
    """Return the component class for an entry point's name or `package.module:Class`.

    Raises `PluginError` if there is none, if two packages offer it, if its module cannot be
    imported, which names the extra of Cairn that it needs, or if it is not a subclass of
    `Component`.
    """
    return _component(find_plugin(reference), reference)


def find_plugin(reference: str) -> str:
    """Return `package.module:Class` for a reference to a plugin; nothing is imported.

    An entry point's name is looked up in the metadata of the installed packages. Raises
    `PluginError` if there is none of that name, or if two packages offer it. A reference that is a
    class already is returned as it is.
    """
    if ":" in reference:
        return reference
    points = _entry_points()
    offers = {point.value: point for point in points if point.name == reference}
    if not offers:
        raise PluginError(
            f"there is no plugin {reference}",
            f"{suggestion(reference, sorted({point.name for point in points}))} "
            "(`cairn plugins` lists all; package.module:Class names a class directly)",
        )
    if len(offers) > 1:
        packages = ", ".join(_package(point) for point in offers.values())
        raise PluginError(
            f"{len(offers)} packages offer a plugin {reference}: {packages}",
            f"name the class directly: {' or '.join(offers)}",
        )
    return next(iter(offers))


def plugin_distribution(reference: str) -> Distribution | None:
    """Return the installed package of a plugin; None for a module that belongs to none.

    Raises `PluginError` as `find_plugin`.
    """
    target = find_plugin(reference)
    for point in _entry_points():
        if point.value == target and point.dist is not None:
            return point.dist
    package = target.partition(":")[0].partition(".")[0]
    spec = importlib.util.find_spec(package)
    places = [] if spec is None else [spec.origin, *(spec.submodule_search_locations or ())]
    for found in distributions():
        names = {Path(file).parts[0] for file in found.files or ()}
        direct = json.loads(found.read_text("direct_url.json") or "{}")
        folder = direct.get("url", "").removeprefix("file://")
        if names & {package, f"{package}.py"} or (
            direct.get("dir_info", {}).get("editable")
            and any(place and Path(place).is_relative_to(folder) for place in places)
        ):
            return found
    return None


def plugin_modules(document: object) -> list[str]:
    """Return the modules of all plugins named in a deployment's plain data, without importing them.

    Any data is accepted; the check of the deployment reports what is wrong with it.
    """
    targets = {point.name: point.value for point in _entry_points()}
    found: dict[str, None] = {}
    waiting = [document]
    while waiting:
        data = waiting.pop()
        if not isinstance(data, dict):
            continue
        plugin = data.get("plugin")
        if isinstance(plugin, str) and ":" in targets.get(plugin, plugin):
            found[targets.get(plugin, plugin).partition(":")[0]] = None
        waiting.extend(data.values())
    return list(found)


def _component(target: str, name: str) -> "type[Component]":
    from cairn.runtime.component import Component

    module_name, _, class_name = target.partition(":")
    try:
        module = _imported(module_name)
    except PluginError as error:
        missing = missing_library(error.__cause__) if error.__cause__ is not None else None
        if missing is None:
            raise
        library, command = missing
        raise PluginError(f"{name} needs {library}, which is not installed", command) from error
    found = getattr(module, class_name, None)
    if found is None:
        classes = [name for name, value in vars(module).items() if _is_component(value, Component)]
        raise PluginError(
            f"{module_name} has no class {class_name}", suggestion(class_name, classes)
        )
    if not _is_component(found, Component):
        raise PluginError(
            f"{target} is not a component",
            "derive the class from cairn.Component",
        )
    component: type[Component] = found
    return component


def _imported(name: str) -> object:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and (name == error.name or name.startswith(f"{error.name}.")):
            raise PluginError(
                f"there is no module {name}",
                "correct the name, install the package that holds it, or put the folder of a "
                "single file on PYTHONPATH",
            ) from error
        raise _not_importable(name, error) from error
    except (Exception, SystemExit) as error:  # importing a plugin's module may raise anything
        raise _not_importable(name, error) from error


def _not_importable(name: str, error: BaseException) -> PluginError:
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if not frame.filename.startswith("<") and "importlib" not in frame.filename
    ]
    place = f" at {frames[-1].filename}:{frames[-1].lineno}" if len(frames) > 1 else ""
    return PluginError(
        f"the module {name} cannot be imported: {type(error).__name__}: {error}{place}",
        "correct the module, or install what it needs",
    )


def _listed(point: EntryPoint) -> Plugin:
    try:
        cls = _component(point.value, point.name)
        ports = tuple(ports_of(cls).values())
    except CairnError as error:
        return Plugin(point.name, point.value, _package(point), error=str(error))
    summary = (getdoc(cls) or "").partition("\n")[0]
    return Plugin(point.name, point.value, _package(point), summary, ports)


def _entry_points() -> tuple[EntryPoint, ...]:
    return _entry_points_on(tuple(sys.path))


@lru_cache(maxsize=1)
def _entry_points_on(_path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """Return the entry points of packages on a path; cached, because this reads many files."""
    return tuple(entry_points(group=GROUP))


def _package(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else "unknown"


def _is_component(found: object, base: type) -> bool:
    return isinstance(found, type) and issubclass(found, base) and found is not base
