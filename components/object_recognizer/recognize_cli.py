"""`cairn recognize`: which taught objects an image shows, and where they are."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from cairn.cli.connection import Json
from cairn.cli.tables import line, note, print_json
from cairn.errors import CairnError
from components.object_recognizer.bearings import place_of
from components.object_recognizer.cameras import Cameras, cameras_of
from components.object_recognizer.condition import blindness
from components.object_recognizer.given import DEFAULT_MAP, MapFile
from components.object_recognizer.pictures import draw_recognized
from components.object_recognizer.sighting import Sighting, sighted, without_wrong_twins
from vision.camera_file import read_camera
from vision.features import extract
from vision.images import Grey, read_image
from vision.recognition import Recognizer
from vision.stereo import look_swapped
from vision.taught import TaughtObject
from vision.taught_store import read_taught

_AT_CAMERA = (0.0, 0.0, 0.0)
_PROBES = 100


@dataclass(frozen=True)
class Seen:
    """What was recognised in an image, rectified if the camera is calibrated, and what is odd."""

    grey: Grey
    features: int
    sightings: list[Sighting]
    remarks: list[str]


def recognize(
    image: Annotated[Path, typer.Argument(metavar="IMAGE", help="The image, or the left one.")],
    right_image: Annotated[
        Path | None,
        typer.Argument(metavar="RIGHT_IMAGE", help="The right camera's, of the same moment."),
    ] = None,
    map_file: MapFile = None,
    camera_info: Annotated[
        list[Path] | None,
        typer.Option(
            "--camera-info",
            metavar="FILE",
            help="The camera's calibration (`cairn camera calibrate`); for two cameras give it "
            "twice, the left one first.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="PICTURE", help="Draw what was recognised: outlines and features."),
    ] = None,
    json: Json = False,
) -> None:
    """Recognise taught objects in an image, and with a calibration tell where they are.

    Range [m] and bearing [rad, left positive] are from the camera, in the plane; corners are in the
    image, in the rectified one if there is a calibration. Nothing recognised is no error.

    --json prints image, right_image, map, width, height, features, remarks and objects, each with
    object_id, name, view, inliers, corners (four x, y [px]: top left, top right, bottom right,
    bottom left of the view), alternatives (object_id and name each), and range, bearing, covariance
    (2 x 2 of both, row by row), position (x right, y down, z ahead [m]) and ranged_by (stereo, size
    or both), which are null where they are not known; doubt says why.
    """
    infos = camera_info or []
    if len(infos) > 2:
        raise CairnError("give --camera-info for the left camera, and once more for the right one")
    taught = read_taught(map_file or DEFAULT_MAP)
    left = read_image(image)
    right = read_image(right_image) if right_image is not None else None
    cameras = None
    if infos:
        calibrations = [read_camera(file, file.stem) for file in infos]
        cameras = cameras_of(calibrations[0], calibrations[1] if len(infos) == 2 else None)
    seen = _seen(left, right, cameras, {known.object_id: known for known in taught.objects})
    names = {known.object_id: known.name for known in taught.objects}
    objects = [_object(one, names) for one in seen.sightings]
    if out is not None:
        labels = [f"{one['name']}: {one['inliers']}" for one in objects]
        draw_recognized(seen.grey, [one.recognition for one in seen.sightings], labels, out)
    if json:
        print_json(
            {
                "image": str(image),
                "right_image": str(right_image) if right_image is not None else None,
                "map": str(map_file or DEFAULT_MAP),
                "width": seen.grey.shape[1],
                "height": seen.grey.shape[0],
                "features": seen.features,
                "objects": objects,
                "remarks": seen.remarks,
            }
        )
        return
    for one in objects:
        line(_told(one))
    if not objects:
        line("nothing recognised")
    for remark in seen.remarks:
        note(remark)


def _seen(
    left: Grey, right: Grey | None, cameras: Cameras | None, known: dict[int, TaughtObject]
) -> Seen:
    remarks = []
    if not known:
        remarks.append("no object was taught to this map: teach some with `cairn object teach`")
    if cameras is None:
        remarks.append("no range: give the camera's calibration by --camera-info")
    else:
        left = cameras.left.apply(left)
        right = _right(right, cameras, remarks)
    features = extract(left)
    blind = blindness(left)
    if blind:
        remarks.append(f"the image shows little: {blind}")
    found = Recognizer(tuple(known.values())).recognize(features, left.shape[1], left.shape[0])
    if cameras is None:
        sightings = [Sighting(one, None, "none", doubt="no calibration") for one in found]
    else:
        if right is not None and look_swapped(left, right, features.points[:_PROBES], cameras.rig):
            raise CairnError("left and right are swapped: give the left camera's image first")
        sightings = without_wrong_twins(
            [sighted(one, known, cameras, left, right) for one in found]
        )
        remarks += [one.doubt for one in sightings if one.doubt]
    return Seen(left, len(features), sightings, remarks)


def _right(image: Grey | None, cameras: Cameras, remarks: list[str]) -> Grey | None:
    if cameras.complaint:
        raise CairnError(cameras.complaint)
    if (image is None) != (cameras.right is None):
        what = "image" if image is None else "calibration"
        remarks.append(f"no stereo: the right camera's {what} is not given")
        return None
    return None if image is None or cameras.right is None else cameras.right.apply(image)


def _object(one: Sighting, names: dict[int, str]) -> dict[str, Any]:
    recognition, located = one.recognition, one.located
    place = place_of(located, _AT_CAMERA) if located is not None else None
    return {
        "object_id": recognition.object_id,
        "name": recognition.name,
        "view": recognition.view,
        "inliers": recognition.inliers,
        "corners": recognition.corners.tolist(),
        "alternatives": [
            {"object_id": other, "name": names[other]} for other in recognition.alternatives
        ],
        "range": place.range if place else None,
        "bearing": place.bearing if place else None,
        "covariance": place.covariance.ravel().tolist() if place else None,
        "position": located.position.tolist() if located is not None else None,
        "ranged_by": one.way if located is not None else None,
        "doubt": one.doubt or None,
    }


def _told(one: dict[str, Any]) -> str:
    corners = " ".join(f"{x:.0f},{y:.0f}" for x, y in one["corners"])
    told = f"{one['name']} (object {one['object_id']}): {one['inliers']} inliers, at {corners}"
    if one["range"] is not None:
        range_sd, bearing_sd = math.sqrt(one["covariance"][0]), math.sqrt(one["covariance"][3])
        told += (
            f"; {one['range']:.2f} +- {range_sd:.2f} m away, bearing "
            f"{math.degrees(one['bearing']):+.1f} +- {math.degrees(bearing_sd):.1f} deg, by "
            f"{'stereo and size' if one['ranged_by'] == 'both' else one['ranged_by']}"
        )
    if one["alternatives"]:
        told += f"; or {', '.join(other['name'] for other in one['alternatives'])}"
    return told
