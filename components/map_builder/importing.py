"""What an importer of maps is: a plugin that reads surveyed objects, or cells, or posed scans."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from cairn import CairnError
from cairn.components.map_builder.counting import build_map
from cairn.components.map_builder.objects import Change, Kind, MapObject
from cairn.components.map_builder.place import Place
from cairn.components.map_builder.store import create_map
from cairn.files import replacing
from cairn.planar.grid import OccupancyCells
from cairn.planar.poses import Pose
from cairn.schemas.cairn_msgs import VisualMap
from cairn.schemas.sensor_msgs import LaserScan
from cairn.vision.object_model import ObjectModel
from cairn.visual_map.object_models import add_views

IMPORTERS_GROUP = "cairn.visual_map_importers"
"""Entry points of this group are functions from a path to the `VisualMap` found there."""

GRID_IMPORTERS_GROUP = "cairn.grid_map_importers"
"""Entry points of this group are functions from a path and a size of cells [m] to the grid map."""

POSED_SCANS_GROUP = "cairn.posed_scan_importers"
"""Entry points of this group are functions from a path to scans and where they were taken."""

TAUGHT_GROUP = "cairn.object_model_importers"
"""Entry points of this group are functions from a path to the `TaughtObject`s found there."""

_GRIDS = (GRID_IMPORTERS_GROUP, POSED_SCANS_GROUP)

Importer = Callable[[Path], VisualMap]
PosedScans = Iterator[tuple[Pose, LaserScan]]


def importer(name: str) -> Importer:
    """The importer of visual maps of that name; `CairnError` names those there are."""
    loaded: Importer = _loaded(name, IMPORTERS_GROUP, "visual maps")
    return loaded


def taught_by(name: str, path: Path) -> Sequence[ObjectModel]:
    """What the objects look like that the importer of that name finds; none if it cannot tell."""
    if name not in entry_points(group=TAUGHT_GROUP).names:
        return ()
    read: Callable[[Path], Sequence[ObjectModel]] = _loaded(name, TAUGHT_GROUP, "taught objects")
    return read(path)


def imported_grid(
    name: str, path: Path, resolution: float, mount: Pose, reach: float
) -> OccupancyCells:
    """The grid map that the importer of that name finds at `path`, or that its scans draw.

    Raises `CairnError` if there is no such importer, or nothing to draw a map of.
    """
    if name in entry_points(group=GRID_IMPORTERS_GROUP).names:
        read: Callable[[Path, float], OccupancyCells]
        read = _loaded(name, GRID_IMPORTERS_GROUP, "grid maps")
        return read(path, resolution)
    scans: Callable[[Path], PosedScans] = _loaded(name, POSED_SCANS_GROUP, "grid maps")
    try:
        return build_map(scans(path), resolution, mount, reach)
    except ValueError as error:
        raise CairnError(f"{path}: {error}, so no map can be drawn of it") from error


def _loaded(name: str, group: str, what: str) -> Any:
    points = entry_points(group=group)
    if name not in points.names:
        _refuse_other_kind(name, group)
        groups = _GRIDS if group in _GRIDS else (group,)
        names = {known for one in groups for known in entry_points(group=one).names}
        known = ", ".join(sorted(names)) or "none is installed"
        raise CairnError(f"there is no importer {name!r} of {what}; known: {known}.")
    return points[name].load()


def _refuse_other_kind(name: str, group: str) -> None:
    """Say so if the importer is one of the other kind of maps."""
    grids = {known for g in _GRIDS for known in entry_points(group=g).names}
    if group == IMPORTERS_GROUP and name in grids:
        raise CairnError(
            f"{name} makes grid maps only, which are written as .yaml: give MAP a name that ends "
            "in .yaml."
        )
    if group in _GRIDS and name in entry_points(group=IMPORTERS_GROUP).names:
        raise CairnError(
            f"{name} makes visual maps only: give MAP a name that does not end in .yaml, such as "
            "map.cairn."
        )


def altered(
    found: VisualMap, displaced: Mapping[int, tuple[float, float]], removed: Sequence[int]
) -> list[MapObject]:
    """The map's objects, some moved by (dx, dy) [m], some left out.

    Raises `CairnError` for an object that the map does not hold or that is named twice.
    """
    known = {o.object_id for o in found.objects}
    for object_id in (*displaced, *removed):
        if object_id not in known:
            raise CairnError(
                f"the map holds no object {object_id}; it holds "
                f"{', '.join(map(str, sorted(known)))}."
            )
    both = sorted(set(displaced) & set(removed))
    if both:
        raise CairnError(f"object {both[0]} cannot be both displaced and removed.")
    objects = []
    for o in found.objects:
        if o.object_id in removed:
            continue
        dx, dy = displaced.get(o.object_id, (0.0, 0.0))
        xx, xy, _, yy = (float(value) for value in o.covariance)
        objects.append(
            MapObject(o.object_id, o.name, Place(o.x + dx, o.y + dy, xx, xy, yy), o.reliability)
        )
    return objects


def write_map(
    path: Path,
    source: str,
    objects: Sequence[MapObject],
    stamp_ns: int = 0,
    taught: Sequence[ObjectModel] = (),
) -> None:
    """Write a new map file with the given objects, each with its change IMPORTED.

    Those of them that are in `taught` are recognized from it at once.
    """
    with replacing(path) as part:
        with create_map(part, source) as store:
            changes = [
                (
                    version,
                    stamp_ns,
                    Change(o.object_id, Kind.IMPORTED, None, o.place, o.reliability, source),
                )
                for version, o in enumerate(objects, start=1)
            ]
            store.commit([replace(o) for o in objects], (), changes)
        known = {o.object_id for o in objects}
        for one in taught:
            if one.object_id in known:
                add_views(part, one.name, one.views, one.size)
