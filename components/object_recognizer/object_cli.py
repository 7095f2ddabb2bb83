"""`cairn object`: teaches objects, and lists, shows and removes their models."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from cairn import CairnError
from cairn.client import NoMessageError, Robot
from cairn.client import connect as connect_to
from cairn.schemas.message import InvalidMessage, type_name
from cairn.schemas.sensor_msgs import Image
from cairn.terminal.options import (
    DEFAULT_CONNECT,
    Connect,
    Domain,
    Json,
    RobotName,
)
from cairn.terminal.output import line, note, print_json, show
from cairn.vision.images import Gray, gray_of, read_image
from cairn.vision.object_model import ModelView, ObjectModel
from cairn.vision.teaching import (
    crop,
    look_alikes,
    make_view,
    repeats,
    smallest_recognized_size,
    why_unrecognizable,
)
from cairn.visual_map.object_models import (
    ObjectModels,
    add_views,
    check_name,
    read_models,
    remove_model,
)
from cairn.visual_map.sqlite_file import create, explained_errors

DEFAULT_MAP = Path("visual_map.cairn")

MapFile = Annotated[
    Path | None,
    typer.Option(
        "--map",
        envvar="CAIRN_VISUAL_MAP",
        metavar="FILE",
        help=f"The visual map with the object models; default: {DEFAULT_MAP}.",
    ),
]
Name = Annotated[str, typer.Argument(help="The object's name.", metavar="NAME")]

app = typer.Typer(help="Objects that robots recognize: teach and show them.", no_args_is_help=True)

PLUGIN = "object_recognizer"
_TIMEOUT_S = 5.0
_LARGEST_M = 100.0
# Ratio of the aspect ratios of a photograph and of the stated size: a slanted view, a wrong size.
_SLANTED, _WRONG = 1.1, 1.3
# An object that must be at least this large in an image [px] is recognized only from near by.
_LARGE = 160

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
            metavar="W,H", help="Width and height [m] of what the images show, to measure range."
        ),
    ] = "",
    box: Annotated[
        str,
        typer.Option(
            metavar="X,Y,W,H", help="The part of the images [px] that shows only the object."
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
    """Teach an object by photographs of it from the front, or add a view to a known object.

    Photographs show only the object, from edge to edge; otherwise give its part by --box. A
    landmark of the map with this name keeps its identifier. Without images, --size sets the size of
    a known object.

    --json prints object_id, name, map, views (total number), taught (for each new view: image,
    width, height, features, and recognized_from: the smallest size [px], of its longer side in a
    camera's image, at which it is recognized), look_alikes and remarks.
    """
    if camera and images:
        raise CairnError("give images or --camera, not both")
    if not (camera or images or size):
        raise CairnError("give images of the object, or --camera to take one of a running robot")
    check_name(name)
    meters = _parse_size(size) if size else None
    sources: list[tuple[str, Gray]] = [(str(path), read_image(path)) for path in images or []]
    if camera:
        with connect_to(connect, domain, robot) as client:
            map_file = map_file or _map_of_recognizer(client)
            sources.append(_newest_image(client, topic))
    path = map_file or DEFAULT_MAP
    views = {source: _checked_view(source, gray, box) for source, gray in sources}
    _teach(path, name, views, meters, as_json=json)


@app.command("list")
def list_objects(map_file: MapFile = None, json: Json = False) -> None:
    """List the objects of which a map has models."""
    models = read_models(map_file or DEFAULT_MAP).models
    rows = [_row(model) for model in models]
    show(rows, _COLUMNS, as_json=json, nothing="the map has no object models")


@app.command("show")
def show_object(
    name: Name,
    map_file: MapFile = None,
    out: Annotated[
        Path | None, typer.Option(metavar="PICTURE", help="Draw its views with their features.")
    ] = None,
    json: Json = False,
) -> None:
    """Show the model of an object; --json prints its views as a list."""
    path = map_file or DEFAULT_MAP
    model = _find(path, read_models(path), name)
    views = [{"view": number, **_view_row(view)} for number, view in enumerate(model.views)]
    if out is not None:
        from cairn.components.object_recognizer.drawing import draw_views  # loads Matplotlib

        draw_views(model, out)
    if json:
        print_json({**_row(model), "views": views})
        return
    width = f"{model.size[0]:g} m x {model.size[1]:g} m" if model.size else "size not known"
    line(f"{model.name}: object {model.object_id}, {width}")
    titles = {"view": "view", "width": "width [px]", "height": "height [px]"}
    show(views, {**titles, "features": "features"}, as_json=False)


@app.command("remove")
def remove_object(name: Name, map_file: MapFile = None) -> None:
    """Remove the model of an object; its landmark stays until robots do not find it there."""
    object_id = remove_model(map_file or DEFAULT_MAP, name)
    line(f"{name} (object {object_id}) is no longer recognized")


def _teach(
    path: Path,
    name: str,
    given: dict[str, ModelView],
    size: tuple[float, float] | None,
    *,
    as_json: bool,
) -> None:
    """Add views, by the names of their sources, to an object's model; print result and remarks.

    Raises `CairnError` if the object cannot be taught.
    """
    with explained_errors(path):
        is_new = not path.exists()
    if is_new and not given:
        raise CairnError(f"{path}: no such map file; give images of {name} to teach it")
    if is_new and not path.absolute().parent.exists():
        raise CairnError(
            f"--map {path}: the folder {path.parent} does not exist; make it, or correct it"
        )
    known = ObjectModels(0, ()) if is_new else read_models(path)
    model = known.named(name)
    views, duplicates = _without_duplicates(given, model)
    # First: it may raise, and the tests below take a while.
    size_remarks = _check_sizes(views, model, size)
    smallest = {source: smallest_recognized_size(view) for source, view in views.items()}
    others = [one for one in known.models if one.name != name]
    alike = {one.name: one for view in views.values() for one in look_alikes(view, others)}
    remarks = [
        *size_remarks,
        *(_repetition_remark(source, name) for source, view in views.items() if repeats(view)),
        *duplicates,
        *(_visibility_remark(source, longest) for source, longest in smallest.items()),
    ]
    if alike:
        remarks.append(
            f"{name} looks like {', '.join(alike)}: the recognizer may mistake one for the other"
        )
    if size is None and (model is None or model.size is None):
        remarks.append(
            f"the size of {name} is not known: only a stereo pair can measure its range; give it "
            "by --size W,H"
        )
    if is_new:
        create(path, "made by cairn object teach").close()
        remarks.append(f"{path} is new: a map without landmarks")
    object_id = add_views(path, name, list(views.values()), size)
    total = len(views) + (len(model.views) if model else 0)
    remarks = [remark for remark in remarks if remark]
    if as_json:
        print_json(
            {
                "object_id": object_id,
                "name": name,
                "map": str(path),
                "views": total,
                "taught": [
                    {"image": source, **_view_row(view), "recognized_from": smallest[source]}
                    for source, view in views.items()
                ],
                "look_alikes": list(alike),
                "remarks": remarks,
            }
        )
        return
    for source, view in views.items():
        text = f"{source}: {view.width} x {view.height} pixels, {len(view.features)} features"
        longest = smallest[source]
        line(text if longest is None else f"{text}, recognized from about {longest} pixels on")
    line(f"{name} (object {object_id}) has {total} view{'s' if total != 1 else ''} in {path}")
    for remark in remarks:
        note(remark)


def _parse_size(text: str) -> tuple[float, float]:
    """Parse width and height [m] W,H; raise `CairnError` if they are not valid."""
    try:
        width, height = (float(part) for part in text.split(","))
    except ValueError:
        width = height = math.nan
    if not (0 < width <= _LARGEST_M and 0 < height <= _LARGEST_M):
        raise CairnError(
            f"--size {text}: write it as W,H, width and height in meters of the object in the "
            f"image, above 0 and at most {_LARGEST_M:g}, such as 0.21,0.297"
        )
    return width, height


def _parse_box(text: str) -> tuple[int, int, int, int]:
    """Parse a part of an image X,Y,W,H [px]; raise `CairnError` if it is not valid."""
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError:
        raise CairnError(
            f"--box {text}: write it as X,Y,W,H in pixels, such as 120,80,200,150"
        ) from None
    return x, y, width, height


def _newest_image(robot: Robot, topic: str) -> tuple[str, Gray]:
    """Receive the next image on a topic; return the topic's full name and the image.

    Raises `CairnError` if there is no such topic of images, or if none arrives within 5 s.
    """
    publisher = robot.find_topic(topic)
    full = publisher.topic
    if publisher.type_name != type_name(Image):
        raise CairnError(
            f"{full} carries {publisher.type_name}, not images; give the topic of a camera's "
            "images by --topic"
        )
    try:
        with robot.subscribe(full, Image) as images:
            return full, gray_of(images.next(_TIMEOUT_S))
    except NoMessageError:
        raise CairnError(
            f"no image arrived on {full} within {_TIMEOUT_S:g} s; check the camera"
        ) from None
    except (InvalidMessage, CairnError) as error:
        raise CairnError(f"{full}: {error}") from error


def _map_of_recognizer(robot: Robot) -> Path | None:
    """Return the map file of the robot's recognizer, None if no recognizer is running."""
    name = robot.component_of(PLUGIN)
    return Path(robot.parameters(name)["map_file"].value) if name is not None else None


def _checked_view(source: str, gray: Gray, box: str) -> ModelView:
    try:
        view = make_view(crop(gray, _parse_box(box)) if box else gray)
    except CairnError as error:
        raise CairnError(f"{source}: {error}") from error
    why = why_unrecognizable(view)
    if why:
        raise CairnError(f"{source} cannot be taught: {why}.")
    return view


def _without_duplicates(
    views: dict[str, ModelView], model: ObjectModel | None
) -> tuple[dict[str, ModelView], list[str]]:
    """Return the views that are new, and remarks on the others."""
    known = list(model.views) if model else []
    new, remarks = {}, []
    for source, view in views.items():
        if any(np.array_equal(view.picture, one.picture) for one in known):
            remarks.append(f"{source} is a view of it already: skipped")
            continue
        known.append(view)
        new[source] = view
    return new, remarks


def _check_sizes(
    views: dict[str, ModelView], model: ObjectModel | None, size: tuple[float, float] | None
) -> list[str]:
    """Return remarks on the stated size; raise `CairnError` if a view contradicts it."""
    before = model.size if model else None
    stated = size or before
    if stated is None:
        return []
    remarks = [_check_shape(source, view, stated) for source, view in views.items()]
    if model is not None and size is not None:
        remarks += [_check_shape(f"view {k}", v, size) for k, v in enumerate(model.views)]
    if before is not None and before != stated:
        remarks.append(f"its size was {before[0]:g} m x {before[1]:g} m until now")
    return remarks


def _check_shape(name: str, view: ModelView, size: tuple[float, float]) -> str:
    """Return a remark on a photograph of an object of that size, "" if their shapes agree.

    Raises `CairnError` if the photograph cannot show that size: ranges would be wrong.
    """
    shape, stated = view.width / view.height, size[0] / size[1]
    off = max(shape / stated, stated / shape)
    text = (
        f"{name}: the image is {shape:.2f} times as wide as high, but the size {size[0]:g} m x "
        f"{size[1]:g} m is {stated:.2f} times"
    )
    if off > _WRONG:
        raise CairnError(
            f"{text}; give width and height in this order, and an image that shows only the "
            "object, from edge to edge (--box)"
        )
    return f"{text}: its range will be less accurate" if off > _SLANTED else ""


def _repetition_remark(source: str, name: str) -> str:
    return (
        f"{source} repeats the same pattern: if only a part of {name} is visible, its position "
        "may be wrong; better teach an object that does not repeat"
    )


def _visibility_remark(source: str, longest: int | None) -> str:
    """Return a remark on a view that is recognized from `longest` [px] on; "" if that is good."""
    if longest is None:
        return (
            f"{source} has so little contrast that it may not be recognized in a camera's image; "
            "give a photograph in good light, or teach another object"
        )
    if longest < _LARGE:
        return ""
    return (
        f"{source} has little contrast, or only fine detail: it is recognized if it is "
        f"{longest} pixels or more across in the camera's image, and not from farther away"
    )


def _find(path: Path, known: ObjectModels, name: str) -> ObjectModel:
    model = known.named(name)
    if model is None:
        names = ", ".join(one.name for one in known.models) or "none"
        raise CairnError(f"{path}: object model {name!r} does not exist; available: {names}.")
    return model


def _view_row(view: ModelView) -> dict[str, Any]:
    return {"width": view.width, "height": view.height, "features": len(view.features)}


def _row(model: ObjectModel) -> dict[str, Any]:
    width, height = model.size or (None, None)
    return {
        "object_id": model.object_id,
        "name": model.name,
        "width_m": width,
        "height_m": height,
        "views": len(model.views),
        "features": sum(len(view.features) for view in model.views),
    }
