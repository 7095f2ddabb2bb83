"""`cairn object`: teach objects, and look at what was taught."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from cairn.cli.connection import DEFAULT_CONNECT, Connect, Domain, Json, Robot, connected
from cairn.cli.tables import line, note, print_json, show
from cairn.errors import CairnError
from components.object_recognizer.given import (
    DEFAULT_MAP,
    MapFile,
    check_shape,
    parsed_box,
    parsed_size,
)
from components.object_recognizer.pictures import draw_views
from components.object_recognizer.running import map_of_recognizer, newest_image
from vision.images import Grey, read_image
from vision.map_file import create, told
from vision.taught import TaughtObject, View
from vision.taught_store import Taught, check_name, read_taught, remove_taught, teach
from vision.teaching import cut, look_alikes, repeats, unfit, view_of

app = typer.Typer(help="Objects that robots recognise: teach and show them.", no_args_is_help=True)
Name = Annotated[str, typer.Argument(help="The object's name.", metavar="NAME")]

_COLUMNS = {
    "object_id": "id",
    "name": "name",
    "width_m": "width [m]",
    "height_m": "height [m]",
    "views": "views",
    "features": "features",
}


@app.command("teach")
def teach_object(
    name: Name,
    images: Annotated[
        list[Path] | None,
        typer.Argument(metavar="IMAGE...", help="Photographs of the object, each a view of it."),
    ] = None,
    size: Annotated[
        str,
        typer.Option(
            metavar="W,H", help="Width and height [m] of what the images show; to range it by."
        ),
    ] = "",
    box: Annotated[
        str,
        typer.Option(
            metavar="X,Y,W,H", help="The part of the images [px] that shows the object alone."
        ),
    ] = "",
    camera: Annotated[
        bool, typer.Option("--camera", help="Take the newest image of a running robot's camera.")
    ] = False,
    topic: Annotated[
        str, typer.Option(help="The camera's topic, for --camera.", metavar="TOPIC")
    ] = "left_image",
    map_file: MapFile = None,
    connect: Connect = DEFAULT_CONNECT,
    domain: Domain = 0,
    robot: Robot = "",
    json: Json = False,
) -> None:
    """Teach an object by photographs of it from the front, or one more view of a known object.

    Photographs show the object alone, from edge to edge, unless --box tells where it is. An object
    of the map that has this name keeps its number. Without images, --size tells a known object's.

    --json prints object_id, name, map, views (number in all), taught (for each new view: image,
    width, height, features), look_alikes and remarks.
    """
    if camera and images:
        raise CairnError("give images or --camera, not both")
    if not (camera or images or size):
        raise CairnError("give images of the object, or --camera to take one of a running robot")
    check_name(name)
    metres = parsed_size(size) if size else None
    sources: list[tuple[str, Grey]] = [(str(path), read_image(path)) for path in images or []]
    if camera:
        with connected(connect, domain) as connection:
            map_file = map_file or map_of_recognizer(connection, robot)
            sources.append(newest_image(connection, topic, robot))
    path = map_file or DEFAULT_MAP
    views = {source: _fit_view(source, grey, box) for source, grey in sources}
    _report(path, name, views, metres, as_json=json)


@app.command("list")
def list_objects(map_file: MapFile = None, json: Json = False) -> None:
    """List the taught objects of a map."""
    taught = read_taught(map_file or DEFAULT_MAP)
    rows = [_row(known) for known in taught.objects]
    show(rows, _COLUMNS, as_json=json, nothing="no object was taught")


@app.command("show")
def show_object(
    name: Name,
    map_file: MapFile = None,
    out: Annotated[
        Path | None, typer.Option(metavar="PICTURE", help="Draw its views with their features.")
    ] = None,
    json: Json = False,
) -> None:
    """Show what was taught of an object; --json prints its views as a list."""
    path = map_file or DEFAULT_MAP
    known = _known(path, read_taught(path), name)
    views = [
        {
            "view": number,
            "width": view.width,
            "height": view.height,
            "features": len(view.features),
        }
        for number, view in enumerate(known.views)
    ]
    if out is not None:
        draw_views(known, out)
    if json:
        print_json({**_row(known), "views": views})
        return
    width = f"{known.size[0]:g} m x {known.size[1]:g} m" if known.size else "size not known"
    line(f"{known.name}: object {known.object_id}, {width}")
    titles = {"view": "view", "width": "width [px]", "height": "height [px]"}
    show(views, {**titles, "features": "features"}, as_json=False)


@app.command("remove")
def remove_object(name: Name, map_file: MapFile = None) -> None:
    """Forget what an object looks like; its place in the map stays until robots miss it there."""
    object_id = remove_taught(map_file or DEFAULT_MAP, name)
    line(f"{name} (object {object_id}) is no longer recognised")


def _fit_view(source: str, grey: Grey, box: str) -> View:
    try:
        view = view_of(cut(grey, parsed_box(box)) if box else grey)
    except CairnError as error:
        raise CairnError(f"{source}: {error}") from error
    why = unfit(view)
    if why:
        raise CairnError(f"{source} cannot be taught: {why}.")
    return view


def _report(
    path: Path,
    name: str,
    views: dict[str, View],
    size: tuple[float, float] | None,
    *,
    as_json: bool,
) -> None:
    """Teach, and tell what was taught and what is odd about it."""
    with told(path):
        is_new = not path.exists()
    if is_new and not views:
        raise CairnError(f"{path}: no such map file: give images of {name} to teach it")
    taught = Taught(0, ()) if is_new else read_taught(path)
    known = taught.named(name)
    stated = size or (known.size if known else None)
    remarks = [check_shape(source, view, stated) for source, view in views.items() if stated]
    if known is not None and size is not None:
        remarks += [check_shape(f"view {k}", v, size) for k, v in enumerate(known.views)]
    remarks += [
        f"{source} shows the same thing at several places: where a part of it alone is seen, "
        f"{name} may be placed wrongly; better teach something that does not repeat"
        for source, view in views.items()
        if repeats(view)
    ]
    views, again = _new_views(views, known)
    remarks += again
    if known is not None and known.size is not None and size not in (None, known.size):
        remarks.append(f"its size was {known.size[0]:g} m x {known.size[1]:g} m until now")
    others = [one for one in taught.objects if one.name != name]
    alike = {one.name: one for view in views.values() for one in look_alikes(view, others)}
    if alike:
        remarks.append(
            f"{name} looks like {', '.join(alike)}: where one of them is seen, it may be taken for "
            "the other"
        )
    if stated is None:
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
                    }
                    for source, view in views.items()
                ],
                "look_alikes": list(alike),
                "remarks": remarks,
            }
        )
        return
    for source, view in views.items():
        line(f"{source}: {view.width} x {view.height} pixels, {len(view.features)} features")
    line(f"{name} (object {object_id}) has {total} view{'s' if total != 1 else ''} in {path}")
    for remark in remarks:
        note(remark)


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


def _known(path: Path, taught: Taught, name: str) -> TaughtObject:
    known = taught.named(name)
    if known is None:
        names = ", ".join(one.name for one in taught.objects) or "none"
        raise CairnError(f"{path}: no object {name!r} was taught; taught are: {names}.")
    return known


def _row(known: TaughtObject) -> dict[str, Any]:
    width, height = known.size or (None, None)
    return {
        "object_id": known.object_id,
        "name": known.name,
        "width_m": width,
        "height_m": height,
        "views": len(known.views),
        "features": sum(len(view.features) for view in known.views),
    }
