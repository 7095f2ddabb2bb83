"""Teaches an object, and tells what was taught and what is odd about it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from cairn import CairnError
from cairn.cli.output import line, note, print_json
from cairn.components.object_recognizer.given import check_shape
from cairn.vision.map_file import create, told
from cairn.vision.taught import TaughtObject, View
from cairn.vision.taught_store import Taught, read_taught, teach
from cairn.vision.teaching import look_alikes, recognized_from, repeats

# What must be so many pixels across in an image [px] is recognized from near by only.
_LARGE = 160


def report(
    path: Path,
    name: str,
    given: dict[str, View],
    size: tuple[float, float] | None,
    *,
    as_json: bool,
) -> None:
    """Teach views of an object, by the names of their sources, to the map at `path`; tell what was
    taught and what is odd about it.

    Raises `CairnError` if it cannot be taught.
    """
    with told(path):
        is_new = not path.exists()
    if is_new and not given:
        raise CairnError(f"{path}: no such map file: give images of {name} to teach it")
    if is_new and not path.absolute().parent.exists():
        raise CairnError(f"--map {path}: there is no folder {path.parent}: make it, or correct it")
    taught = Taught(0, ()) if is_new else read_taught(path)
    known = taught.named(name)
    views, again = _new_views(given, known)
    # First: it may refuse them, and to try them all takes a while.
    sizes = _odd_sizes(views, known, size)
    smallest = {source: recognized_from(view) for source, view in views.items()}
    others = [one for one in taught.objects if one.name != name]
    alike = {one.name: one for view in views.values() for one in look_alikes(view, others)}
    remarks = [
        *sizes,
        *(_repeating(source, name) for source, view in views.items() if repeats(view)),
        *again,
        *(_only_near(source, longest) for source, longest in smallest.items()),
    ]
    if alike:
        remarks.append(
            f"{name} looks like {', '.join(alike)}: where one of them is seen, it may be taken for "
            "the other"
        )
    if size is None and (known is None or known.size is None):
        remarks.append(
            f"the size of {name} is not known: only two cameras can tell how far away it is. Tell "
            "it by --size W,H"
        )
    if is_new:
        create(path, "made by cairn object teach").close()
        remarks.append(f"{path} is new: a map without places of objects")
    object_id = teach(path, name, list(views.values()), size)
    total = len(views) + (len(known.views) if known else 0)
    remarks = [remark for remark in remarks if remark]
    if as_json:
        print_json(
            {
                "object_id": object_id,
                "name": name,
                "map": str(path),
                "views": total,
                "taught": [
                    {
                        "image": source,
                        "width": view.width,
                        "height": view.height,
                        "features": len(view.features),
                        "recognized_from": smallest[source],
                    }
                    for source, view in views.items()
                ],
                "look_alikes": list(alike),
                "remarks": remarks,
            }
        )
        return
    for source, view in views.items():
        shown = f"{source}: {view.width} x {view.height} pixels, {len(view.features)} features"
        longest = smallest[source]
        line(shown if longest is None else f"{shown}, recognized from about {longest} pixels on")
    line(f"{name} (object {object_id}) has {total} view{'s' if total != 1 else ''} in {path}")
    for remark in remarks:
        note(remark)


def _odd_sizes(
    views: dict[str, View], known: TaughtObject | None, size: tuple[float, float] | None
) -> list[str]:
    """What is odd about the size that is stated; raises `CairnError` if a view contradicts it."""
    before = known.size if known else None
    stated = size or before
    if stated is None:
        return []
    remarks = [check_shape(source, view, stated) for source, view in views.items()]
    if known is not None and size is not None:
        remarks += [check_shape(f"view {k}", v, size) for k, v in enumerate(known.views)]
    if before is not None and before != stated:
        remarks.append(f"its size was {before[0]:g} m x {before[1]:g} m until now")
    return remarks


def _repeating(source: str, name: str) -> str:
    return (
        f"{source} shows the same thing at several places: where a part of it alone is seen, "
        f"{name} may be placed wrongly; better teach something that does not repeat"
    )


def _only_near(source: str, longest: int | None) -> str:
    """A remark on a view that is recognized from `longest` [px] on; empty if that is well."""
    if longest is None:
        return (
            f"{source} has so little contrast that it may not be recognized in a camera's image: "
            "give a photograph in good light, or teach something else"
        )
    if longest < _LARGE:
        return ""
    return (
        f"{source} has little contrast, or only fine detail: it is recognized where it is "
        f"{longest} pixels or more across in the camera's image, and not from farther away"
    )


def _new_views(
    views: dict[str, View], known: TaughtObject | None
) -> tuple[dict[str, View], list[str]]:
    """The views that show something new, and remarks on the others."""
    shown = list(known.views) if known else []
    new, remarks = {}, []
    for source, view in views.items():
        if any(np.array_equal(view.picture, one.picture) for one in shown):
            remarks.append(f"{source} is a view of it already: left out")
            continue
        shown.append(view)
        new[source] = view
    return new, remarks
