"""Imports maps by plugins that read surveyed objects, grids, or scans with poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from cairn import CairnError
from cairn.planar.grid import OccupancyCells
from cairn.planar.poses import Pose
from cairn.planar.scan_grid import build_grid
from cairn.schemas.cairn_msgs import VisualMap
from cairn.schemas.sensor_msgs import LaserScan
from cairn.vision.object_model import ObjectModel
from cairn.visual_map.landmarks import (
    LandmarkRecord,
    MapPosition,
)

IMPORTERS_GROUP = "cairn.visual_map_importers"
"""Entry points of this group are functions of a path that return its `VisualMap`."""

GRID_IMPORTERS_GROUP = "cairn.grid_map_importers"
"""Entry points of this group are functions of a path and a cell size [m] that return a grid map."""

POSED_SCANS_GROUP = "cairn.posed_scan_importers"
"""Entry points of this group are functions of a path that yield scans with their poses."""

OBJECT_MODELS_GROUP = "cairn.object_model_importers"
"""Entry points of this group are functions of a path that return its `ObjectModel`s."""

_GRIDS = (GRID_IMPORTERS_GROUP, POSED_SCANS_GROUP)

Importer = Callable[[Path], VisualMap]
PosedScans = Iterator[tuple[Pose, LaserScan]]


def importer(name: str) -> Importer:
    """Return the importer of visual maps of that name; raise `CairnError` that lists them."""
    loaded: Importer = _loaded(name, IMPORTERS_GROUP, "visual maps")
    return loaded


def endings_of(name: str) -> list[str]:
    """Return the endings of the map files that the importer of that name makes.

    Raises `CairnError` that lists the importers if there is none of that name.
    """
    kinds = {".yaml": _GRIDS, ".cairn": (IMPORTERS_GROUP,)}
    names = {
        ending: {known for group in groups for known in entry_points(group=group).names}
        for ending, groups in kinds.items()
    }
    if found := [ending for ending, known in names.items() if name in known]:
        return found
    all_names = ", ".join(sorted(set().union(*names.values())))
    raise CairnError(f"no importer has the name {name!r}; available: {all_names}.")


def import_models(name: str, path: Path) -> Sequence[ObjectModel]:
    """Return the object models of the importer of that name; none if it has no models."""
    if name not in entry_points(group=OBJECT_MODELS_GROUP).names:
        return ()
    read: Callable[[Path], Sequence[ObjectModel]] = _loaded(
        name, OBJECT_MODELS_GROUP, "object models"
    )
    return read(path)


def import_grid(
    name: str, path: Path, resolution: float, mount: Pose, reach: float
) -> OccupancyCells:
    """Return the grid map of the importer of that name, or build one from its scans.

    Raises `CairnError` if there is no such importer, there are no scans, or the map is too large.
    """
    if name in entry_points(group=GRID_IMPORTERS_GROUP).names:
        read: Callable[[Path, float], OccupancyCells]
        read = _loaded(name, GRID_IMPORTERS_GROUP, "grid maps")
        return read(path, resolution)
    scans: Callable[[Path], PosedScans] = _loaded(name, POSED_SCANS_GROUP, "grid maps")
    try:
        return build_grid(scans(path), resolution, mount, reach)
    except ValueError as error:
        raise CairnError(
            f"{path}: {error}, so no map can be built; give a recording with scans and "
            "correct poses, or a coarser --resolution"
        ) from error


def _loaded(name: str, group: str, what: str) -> Any:
    points = entry_points(group=group)
    if name not in points.names:
        _check_kind(name, group)
        groups = _GRIDS if group in _GRIDS else (group,)
        names = {known for one in groups for known in entry_points(group=one).names}
        known = ", ".join(sorted(names)) or "none is installed"
        raise CairnError(f"no importer of {what} has the name {name!r}; available: {known}.")
    return points[name].load()


def _check_kind(name: str, group: str) -> None:
    """Raise `CairnError` if the importer makes the other kind of maps."""
    grids = {known for g in _GRIDS for known in entry_points(group=g).names}
    if group == IMPORTERS_GROUP and name in grids:
        raise CairnError(f"{name} makes only grid maps; give MAP a name that ends in .yaml.")
    if group in _GRIDS and name in entry_points(group=IMPORTERS_GROUP).names:
        raise CairnError(
            f"{name} makes only visual maps; give MAP a name that does not end in .yaml, such as "
            "map.cairn."
        )


def alter(
    found: VisualMap, displaced: Mapping[int, tuple[float, float]], removed: Sequence[int]
) -> list[LandmarkRecord]:
    """Return the landmarks of a map, some displaced by (dx, dy) [m], some removed.

    Raises `CairnError` for an object that is not in the map, or is named twice.
    """
    known = {o.object_id for o in found.objects}
    for object_id in (*displaced, *removed):
        if object_id not in known:
            raise CairnError(
                f"the map has no object {object_id}; it has {', '.join(map(str, sorted(known)))}."
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
            LandmarkRecord(
                o.object_id, o.name, MapPosition(o.x + dx, o.y + dy, xx, xy, yy), o.reliability
            )
        )
    return objects
