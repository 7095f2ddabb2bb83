"""What an importer of visual maps is: a plugin that reads surveyed objects from somewhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import entry_points
from pathlib import Path

from cairn.errors import CairnError
from components.map_builder.objects import Change, Kind, MapObject, Place
from components.map_builder.store import create_map
from schemas.cairn_msgs import VisualMap

IMPORTERS_GROUP = "cairn.visual_map_importers"
"""Entry points of this group are functions from a path to the `VisualMap` found there."""

Importer = Callable[[Path], VisualMap]


def importer(name: str) -> Importer:
    """The importer of that name; `CairnError` names those there are."""
    points = entry_points(group=IMPORTERS_GROUP)
    if name not in points.names:
        known = ", ".join(sorted(points.names)) or "none is installed"
        raise CairnError(f"there is no importer {name!r} of visual maps; known: {known}.")
    loaded: Importer = points[name].load()
    return loaded


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


def write_map(path: Path, source: str, objects: Sequence[MapObject], stamp_ns: int = 0) -> None:
    """Write a new map file with the given objects, each with its change IMPORTED."""
    partial = path.with_name(path.name + ".partial")
    partial.unlink(missing_ok=True)
    with create_map(partial, source) as store:
        changes = [
            (
                version,
                stamp_ns,
                Change(o.object_id, Kind.IMPORTED, None, o.place, o.reliability, source),
            )
            for version, o in enumerate(objects, start=1)
        ]
        store.commit([replace(o) for o in objects], (), changes)
    partial.replace(path)
