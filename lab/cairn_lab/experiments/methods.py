"""The compared methods, and a deployment in which all of them run on the same sensor data.

One localizer and one map builder drive the robot. Each further method is a shadow: a localizer and
a map builder that read the same sensors and publish below the method's name, where nothing that
drives the robot reads.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cairn import CairnError
from cairn.deployment.load import load_deployment
from cairn.deployment.model import Deployment
from cairn.deployment.plugins import load_plugin
from cairn.runtime.child_spec import ChildSpec
from cairn.runtime.ports import ports_of
from cairn.runtime.topic_ports import In, Out

WORLD, LOCALIZER, MAP_BUILDER = "world", "localizer", "map_builder"
# The topic that a localizer reads when the robot is driven by scans alone: it has no publisher.
_NO_OBJECTS = "no_objects"
# Parameters of the driving components that shadows do not have: files of the grid map, and of the
# pose to start from.
_DRIVING_ONLY = frozenset({"resume_file", "grid_file", "grid_copy"})
_GRID = frozenset({"map", "map_updates"})

Events = tuple[Mapping[str, Any], ...]


@dataclass(frozen=True)
class Method:
    """Parameters of a localizer and a map builder; `title` is the method's name in reports.

    With the parameters `comparison` and `rule` they are those of `comparison.py`.
    """

    name: str
    title: str
    localizer: Mapping[str, Any] = field(default_factory=dict)
    map_builder: Mapping[str, Any] = field(default_factory=dict)

    @property
    def plugins(self) -> dict[str, str]:
        """The plugins that replace those of the deployment, by the name of the component."""
        module, plugins = "cairn_lab.experiments.comparison", {}
        if "comparison" in self.localizer:
            plugins[LOCALIZER] = f"{module}:ComparisonLocalizer"
        if "rule" in self.map_builder:
            plugins[MAP_BUILDER] = f"{module}:ComparisonMapBuilder"
        return plugins


OURS = Method("ours", "ours (likelihood ratio)", {"mode": "lr"})
PAPER_RULE = Method(
    "paper_rule", "paper, literal", {"comparison": "paper_rule"}, {"rule": "paper_rule"}
)
PAPER = Method("paper", "paper, clamped", {"mode": "paper"})
CHI_SQUARE = Method("chi_square", "chi-square gate", {"comparison": "chi_square"})
PERSISTENCE = Method("persistence", "persistence filter", {"mode": "lr"}, {"rule": "persistence"})
NO_UPDATE = Method("no_update", "no update", {"mode": "lr"}, {"update_objects": False})

# A filter that trusts each object fully, as the paper's seems to: its behavior when the map is
# wrong.
_CERTAIN = {"mode": "lr", "fusion": "certain", "independence": 1.0}
OURS_CERTAIN = Method("certain", "ours, certain fusion", _CERTAIN)
NO_UPDATE_CERTAIN = Method(
    "certain_no_update", "no update, certain fusion", _CERTAIN, {"update_objects": False}
)

ABLATION = (OURS, PAPER_RULE, PAPER, CHI_SQUARE, PERSISTENCE, NO_UPDATE)


@dataclass(frozen=True)
class ExperimentSetup:
    """A deployment with its overlays and changes (`--set`), and the methods in it.

    `driving` is the method of the localizer and map builder that drive the robot; None: scans alone
    do. `shadows` are the other methods. `events` replace those of the deployment's world; None:
    they stay.
    """

    deployment: Path
    overlays: tuple[Path, ...]
    sets: tuple[str, ...]
    driving: Method | None
    shadows: tuple[Method, ...]
    events: Events | None = None

    @property
    def methods(self) -> tuple[Method, ...]:
        """The methods whose series are recorded."""
        return (*((self.driving,) if self.driving else ()), *self.shadows)


def series_file(folder: Path, name: str) -> Path:
    """Return the file of the series of a method, or of the `WORLD`, by its name."""
    return folder / f"{name}.jsonl"


def base_deployment(setup: ExperimentSetup) -> Deployment:
    """Return the deployment without shadows and observers."""
    return load_deployment(setup.deployment, setup.overlays, setup.sets)


def experiment_deployment(setup: ExperimentSetup, series: Path, scratch: Path) -> Deployment:
    """Return the deployment with its shadows, and observers that write to the folder `series`.

    `scratch` is a folder for other files. Raises `CairnError` if the deployment is wrong or lacks a
    component that the experiments need.
    """
    base = base_deployment(setup)
    localizer, map_builder = _member(base, LOCALIZER), _member(base, MAP_BUILDER)
    _member(base, WORLD)
    objects = localizer.topics.get("objects", "objects")
    added = {
        "world_observer": _observer(
            "experiment_world_observer",
            series_file(series, WORLD),
            {"recognized_objects": objects},
        )
    }
    if setup.driving is not None:
        file = series_file(series, setup.driving.name)
        added[f"{setup.driving.name}_observer"] = _observer("experiment_method_observer", file, {})
    for method in setup.shadows:
        added |= _shadow(method, localizer, map_builder, series, scratch)
    overlay = scratch / "methods.yaml"
    overlay.write_text(json.dumps({"components": added}, indent=1), encoding="utf-8")
    sets = (*setup.sets, f"settings.report={scratch}", *_changes(setup))
    return load_deployment(setup.deployment, (*setup.overlays, overlay), sets)


def first_event_s(setup: ExperimentSetup) -> float:
    """Return the time [s] of the first event of the world; `CairnError` if there is no event."""
    events = setup.events
    if events is None:
        events = tuple(_member(base_deployment(setup), WORLD).parameters.get("events", ()))
    if not events:
        raise CairnError(
            f"{setup.deployment}: nothing changes in the world of this deployment; give its "
            "component world an event, as deploy/experiment.yaml does"
        )
    return min(float(event["at"]) for event in events)


def _member(deployment: Deployment, name: str) -> ChildSpec:
    try:
        return deployment.member(name).spec
    except KeyError:
        raise CairnError(
            f"the deployment has no component {name}, which the experiments need; name one like "
            "deploy/sim.yaml with --deployment FILE"
        ) from None


def _changes(setup: ExperimentSetup) -> Iterator[str]:
    """Yield the changes, as for `--set`, of the driving components and of the world."""
    if setup.driving is None:
        yield f"components.{LOCALIZER}.topics.objects={_NO_OBJECTS}"
    else:
        for name, plugin in setup.driving.plugins.items():
            yield f"components.{name}.plugin={plugin}"
        for name, value in setup.driving.localizer.items():
            yield f"components.{LOCALIZER}.parameters.{name}={json.dumps(value)}"
        for name, value in setup.driving.map_builder.items():
            yield f"components.{MAP_BUILDER}.parameters.{name}={json.dumps(value)}"
    if setup.events is not None:
        yield f"components.{WORLD}.parameters.events={json.dumps(setup.events)}"


def _observer(plugin: str, file: Path, topics: Mapping[str, str]) -> dict[str, Any]:
    return {"plugin": plugin, "parameters": {"file": str(file)}, "topics": dict(topics)}


def _shadow(
    method: Method, localizer: ChildSpec, map_builder: ChildSpec, series: Path, files: Path
) -> dict[str, Any]:
    """Return a shadow and its observer; the shadow publishes on topics of its own."""
    name = method.name
    outputs = _outputs(localizer) | _outputs(map_builder)
    observer = _observer("experiment_method_observer", series_file(series, name), {})
    observer["topics"] = {port: f"{name}/{port}" for port in _ports(observer["plugin"])}
    map_builder_parameters = {
        **method.map_builder,
        "working_copy": str(files / f"{name}.cairn"),
    }
    return {
        # All share the grid map of the driving map builder: only the visual maps are compared.
        f"{name}_{LOCALIZER}": _copy(
            localizer, method.plugins.get(LOCALIZER), method.localizer, outputs - _GRID, name
        ),
        f"{name}_{MAP_BUILDER}": _copy(
            map_builder, method.plugins.get(MAP_BUILDER), map_builder_parameters, outputs, name
        ),
        f"{name}_observer": observer,
    }


def _copy(
    spec: ChildSpec, plugin: str | None, parameters: Mapping[str, Any], own: set[str], name: str
) -> dict[str, Any]:
    """Return the same component, or another plugin, with other parameters.

    The ports `own` use topics below `name`.
    """
    shared = {key: value for key, value in spec.parameters.items() if key not in _DRIVING_ONLY}
    topics = {port: f"{name}/{port}" for port in _ports(spec.plugin) if port in own}
    return {
        "plugin": plugin or spec.plugin,
        "parameters": shared | dict(parameters),
        "topics": spec.topics | topics,
    }


def _outputs(spec: ChildSpec) -> set[str]:
    return {name for name, port in _ports(spec.plugin).items() if port.direction == "out"}


def _ports(plugin: str) -> dict[str, In[Any] | Out[Any]]:
    return ports_of(load_plugin(plugin))
