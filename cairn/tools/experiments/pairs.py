"""Puts pairs of localizer and map builder beside those that drive, on the same sensor data."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cairn import CairnError
from cairn.deployment.load import load_deployment
from cairn.deployment.model import ChildSpec, Deployment
from cairn.deployment.plugins import load_plugin
from cairn.runtime.ports import PortSpec, ports_of
from cairn.tools.experiments.methods import Method

WORLD, LOCALIZER, MAP_BUILDER = "world", "localizer", "map_builder"
# What a localizer reads that drives by scans alone: nobody writes it.
_UNSEEN = "unseen_objects"
# Of those that drive alone: files of the grid map, and of the pose to go on from.
_OF_THE_DRIVER = frozenset({"resume_file", "grid_file", "grid_copy"})
_GRID = frozenset({"map", "map_updates"})

Events = tuple[Mapping[str, Any], ...]


@dataclass(frozen=True)
class Plan:
    """What is run: a deployment, what is laid over it, and what pairs there are.

    `driving` is the method of the pair that drives; None: it drives by scans alone. `shadows` get
    the same data and have no say. `events` replace those of the deployment's world; None: they
    stay.
    """

    deployment: Path
    overlays: tuple[Path, ...]
    sets: tuple[str, ...]
    driving: Method | None
    shadows: tuple[Method, ...]
    events: Events | None = None

    @property
    def methods(self) -> tuple[Method, ...]:
        """The methods that there will be a series of."""
        return (*((self.driving,) if self.driving else ()), *self.shadows)


def series_file(folder: Path, name: str) -> Path:
    """Where the series of the method of that name goes, or that of the `WORLD`."""
    return folder / f"{name}.jsonl"


def plain(plan: Plan) -> Deployment:
    """The deployment as it is given, without pairs beside those that drive."""
    return load_deployment(plan.deployment, plan.overlays, plan.sets)


def planned(plan: Plan, series: Path, scratch: Path) -> Deployment:
    """The deployment with its pairs and their observers, which write to the folder `series`.

    `scratch` is for files. Raises `CairnError` if the deployment is wrong, or lacks what the
    experiments are about.
    """
    given = plain(plan)
    localizer, map_builder = _member(given, LOCALIZER), _member(given, MAP_BUILDER)
    _member(given, WORLD)
    sightings = localizer.topics.get("objects", "objects")
    added = {
        "world_observer": _observer(
            "experiment_world_observer",
            series_file(series, WORLD),
            {"recognized_objects": sightings},
        )
    }
    if plan.driving is not None:
        file = series_file(series, plan.driving.name)
        added[f"{plan.driving.name}_observer"] = _observer("experiment_pair_observer", file, {})
    for method in plan.shadows:
        added |= _shadow(method, localizer, map_builder, series, scratch)
    overlay = scratch / "pairs.yaml"
    overlay.write_text(json.dumps({"components": added}, indent=1), encoding="utf-8")
    sets = (*plan.sets, f"settings.report={scratch}", *_changes(plan))
    return load_deployment(plan.deployment, (*plan.overlays, overlay), sets)


def _member(deployment: Deployment, name: str) -> ChildSpec:
    try:
        return deployment.member(name).spec
    except KeyError:
        raise CairnError(
            f"the deployment has no component {name}, which the experiments need; name one like "
            "deploy/sim.yaml with --deployment FILE"
        ) from None


def _changes(plan: Plan) -> Iterator[str]:
    """What `--set` would be given for the pair that drives and for the world."""
    if plan.driving is None:
        yield f"components.{LOCALIZER}.topics.objects={_UNSEEN}"
    else:
        for name, value in plan.driving.localizer.items():
            yield f"components.{LOCALIZER}.parameters.{name}={json.dumps(value)}"
        for name, value in plan.driving.map_builder.items():
            yield f"components.{MAP_BUILDER}.parameters.{name}={json.dumps(value)}"
    if plan.events is not None:
        yield f"components.{WORLD}.parameters.events={json.dumps(plan.events)}"


def _observer(plugin: str, file: Path, topics: Mapping[str, str]) -> dict[str, Any]:
    return {"plugin": plugin, "parameters": {"file": str(file)}, "topics": dict(topics)}


def _shadow(
    method: Method, localizer: ChildSpec, map_builder: ChildSpec, series: Path, files: Path
) -> dict[str, Any]:
    """A pair and its observer; what the pair tells goes on topics of its own."""
    name = method.name
    told = _outputs(localizer) | _outputs(map_builder)
    observer = _observer("experiment_pair_observer", series_file(series, name), {})
    observer["topics"] = {port: f"{name}/{port}" for port in _ports(observer["plugin"])}
    kept_in = {"working_copy": str(files / f"{name}.cairn")}
    return {
        # The grid map is that of the pair that drives: only what becomes of objects is compared.
        f"{name}_{LOCALIZER}": _copy(localizer, method.localizer, told - _GRID, name),
        f"{name}_{MAP_BUILDER}": _copy(map_builder, {**method.map_builder, **kept_in}, told, name),
        f"{name}_observer": observer,
    }


def _copy(
    spec: ChildSpec, parameters: Mapping[str, Any], own: set[str], name: str
) -> dict[str, Any]:
    """The same component with other parameters, and those ports on topics below `name`."""
    kept = {key: value for key, value in spec.parameters.items() if key not in _OF_THE_DRIVER}
    topics = {port: f"{name}/{port}" for port in _ports(spec.plugin) if port in own}
    return {
        "plugin": spec.plugin,
        "parameters": kept | dict(parameters),
        "topics": spec.topics | topics,
    }


def _outputs(spec: ChildSpec) -> set[str]:
    return {port for port, its in _ports(spec.plugin).items() if its.direction == "out"}


def _ports(plugin: str) -> dict[str, PortSpec]:
    return ports_of(load_plugin(plugin))


def changed_at(plan: Plan) -> float:
    """When [s] the first event of the plan's world comes due; `CairnError` if it has none."""
    events = plan.events
    if events is None:
        events = tuple(_member(plain(plan), WORLD).parameters.get("events", ()))
    if not events:
        raise CairnError(
            "nothing is changed in the world of the deployment; give its component world an event, "
            "as deploy/experiment.yaml does"
        )
    return min(float(event["at"]) for event in events)
