"""`cairn object`: teach objects, and look at what was taught."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from cairn import CairnError
from cairn.cli.options import DEFAULT_CONNECT, Connect, Domain, Json, RobotName
from cairn.cli.output import line, print_json, show
from cairn.client import connect as connect_to
from cairn.components.object_recognizer.given import (
    DEFAULT_MAP,
    MapFile,
    parsed_box,
    parsed_size,
)
from cairn.components.object_recognizer.pictures import draw_views
from cairn.components.object_recognizer.running import map_of_recognizer, newest_image
from cairn.components.object_recognizer.teach_report import report
from cairn.vision.images import Gray, read_image
from cairn.vision.taught import TaughtObject, View
from cairn.vision.taught_store import Taught, check_name, read_taught, remove_taught
from cairn.vision.teaching import cut, unfit, view_of

app = typer.Typer(help="Objects that robots recognize: teach and show them.", no_args_is_help=True)
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
    robot: RobotName = "",
    json: Json = False,
) -> None:
    """Teach an object by photographs of it from the front, or one more view of a known object.

    Photographs show the object alone, from edge to edge, unless --box tells where it is. An object
    of the map that has this name keeps its number. Without images, --size tells a known object's.

    --json prints object_id, name, map, views (number in all), taught (for each new view: image,
    width, height, features, and recognized_from: from how large on [px], its longer side in a
    camera's image, it is recognized), look_alikes and remarks.
    """
    if camera and images:
        raise CairnError("give images or --camera, not both")
    if not (camera or images or size):
        raise CairnError("give images of the object, or --camera to take one of a running robot")
    check_name(name)
    meters = parsed_size(size) if size else None
    sources: list[tuple[str, Gray]] = [(str(path), read_image(path)) for path in images or []]
    if camera:
        with connect_to(connect, domain, robot) as client:
            map_file = map_file or map_of_recognizer(client)
            sources.append(newest_image(client, topic))
    path = map_file or DEFAULT_MAP
    views = {source: _fit_view(source, gray, box) for source, gray in sources}
    report(path, name, views, meters, as_json=json)


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
    line(f"{name} (object {object_id}) is no longer recognized")


def _fit_view(source: str, gray: Gray, box: str) -> View:
    try:
        view = view_of(cut(gray, parsed_box(box)) if box else gray)
    except CairnError as error:
        raise CairnError(f"{source}: {error}") from error
    why = unfit(view)
    if why:
        raise CairnError(f"{source} cannot be taught: {why}.")
    return view


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
