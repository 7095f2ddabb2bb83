"""`cairn recognize`: which taught objects an image shows, and where they are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from cairn import CairnError
from cairn.cli.options import Json
from cairn.cli.output import line, note, print_json
from cairn.components.object_recognizer.agreement import contradiction
from cairn.components.object_recognizer.bearings import place_of
from cairn.components.object_recognizer.cameras import Cameras, cameras_of
from cairn.components.object_recognizer.condition import blindness
from cairn.components.object_recognizer.given import DEFAULT_MAP, MapFile
from cairn.components.object_recognizer.pictures import draw_recognized
from cairn.components.object_recognizer.sighting import Sighting, sighted, without_wrong_twins
from cairn.components.object_recognizer.stereo_check import swapped, unlike
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.vision.camera_file import read_camera
from cairn.vision.features import extract
from cairn.vision.images import Gray, read_image
from cairn.vision.recognition import Recognizer
from cairn.vision.stereo import StereoRig
from cairn.vision.taught import TaughtObject
from cairn.vision.taught_store import read_taught

_AT_CAMERA = (0.0, 0.0, 0.0)
# How well a calibration tells where the camera looks [rad]: its principal point is one or two
# pixels off.
_AIM_SD = 0.003
# Across the image [deg]: hardly a robot's camera sees less, or without distortion more.
_NARROW, _WIDE = 15.0, 140.0


@dataclass(frozen=True)
class Seen:
    """What was recognized in an image, rectified if the camera is calibrated, and what is odd.

    `no_stereo` says why stereo told nothing; it is empty if it might have.
    """

    gray: Gray
    features: int
    sightings: list[Sighting]
    no_stereo: str
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
        typer.Option(metavar="PICTURE", help="Draw what was recognized: outlines and features."),
    ] = None,
    json: Json = False,
) -> None:
    """Recognize taught objects in an image, and with a calibration tell where they are.

    Range [m] and bearing [rad, left positive] are from the camera, in the plane; corners are in the
    image, in the rectified one if there is a calibration. Nothing recognized is no error.

    --json prints image, right_image, map, width, height, features, remarks and objects, each with
    object_id, name, view, inliers, corners (four x, y [px]: top left, top right, bottom right,
    bottom left of the view), alternatives (object_id and name each), and range, bearing, covariance
    (2 x 2 of both, row by row), position (x right, y down, z ahead [m]) and ranged_by (stereo, size
    or both), which are null where they are not known; doubt says why, or why they may be wrong.
    no_stereo says why nothing was ranged by stereo, and is null if it could be.
    """
    if out is not None and any(_same(out, given) for given in (image, right_image)):
        raise CairnError(f"--out {out} is the image that is to be looked at: give another name")
    infos = camera_info or []
    if len(infos) > 2:
        raise CairnError("give --camera-info for the left camera, and once more for the right one")
    taught = read_taught(map_file or DEFAULT_MAP)
    left = read_image(image)
    right = read_image(right_image) if right_image is not None else None
    cameras = None
    if infos:
        calibrations = [read_camera(file, str(file)) for file in infos]
        given = zip((image, right_image), (left, right), calibrations, strict=False)
        for file, gray, calibration in given:
            _check_size(file, gray, calibration)
        cameras = cameras_of(calibrations[0], calibrations[1] if len(infos) == 2 else None)
    known = {one.object_id: one for one in taught.objects}
    seen = _seen(image, right_image, left, right, cameras, known)
    names = {known.object_id: known.name for known in taught.objects}
    objects = [_object(one, names) for one in seen.sightings]
    if out is not None:
        labels = [_label(one) for one in objects]
        draw_recognized(seen.gray, [one.recognition for one in seen.sightings], labels, out)
    if json:
        print_json(
            {
                "image": str(image),
                "right_image": str(right_image) if right_image is not None else None,
                "map": str(map_file or DEFAULT_MAP),
                "width": seen.gray.shape[1],
                "height": seen.gray.shape[0],
                "features": seen.features,
                "objects": objects,
                "no_stereo": seen.no_stereo or None,
                "remarks": seen.remarks,
            }
        )
        return
    for one in objects:
        line(_told(one))
    if not objects:
        line("nothing recognized")
    for remark in seen.remarks:
        note(remark)


def _same(one: Path, other: Path | None) -> bool:
    return other is not None and one.exists() and other.exists() and one.samefile(other)


def _seen(
    image: Path,
    right_image: Path | None,
    left: Gray,
    right: Gray | None,
    cameras: Cameras | None,
    known: dict[int, TaughtObject],
) -> Seen:
    remarks = []
    if not known:
        remarks.append("no object was taught to this map: teach some with `cairn object teach`")
    rectified = left if cameras is None else cameras.left.apply(left)
    features = extract(rectified)
    blind = blindness(rectified)
    if blind:
        remarks.append(f"the image shows little: {blind}")
    height, width = rectified.shape
    found = Recognizer(tuple(known.values())).recognize(features, width, height)
    if cameras is None:
        remarks.append("no range: give the camera's calibration by --camera-info")
        sightings = [Sighting(one, None, "none", doubt="no calibration") for one in found]
        no_stereo = "no calibration"
    else:
        remarks += _odd_view(cameras.rig)
        no_stereo = _no_pair(left, right, cameras)
        other = None
        if not no_stereo and right is not None and cameras.right is not None:
            other = cameras.right.apply(right)
            if swapped(rectified, other, features, cameras.rig):
                raise CairnError(
                    f"left and right are swapped, for {image} shows what the right camera sees: "
                    f"give the left camera's image first, {right_image}"
                )
        sightings = _doubted(
            without_wrong_twins([sighted(one, known, cameras, rectified, other) for one in found])
        )
        if other is not None and not any(one.by_stereo for one in sightings):
            no_stereo = unlike(rectified, other, features, cameras.rig)
            if any(one.rows_off for one in sightings):
                no_stereo = "the rows of the images are not aligned"
            elif sightings and not no_stereo:
                no_stereo = "what was recognized is not found in the right image, or is too far"
        if no_stereo and (right is not None or cameras.right is not None):
            remarks.append(f"no stereo: {no_stereo}")
        remarks += dict.fromkeys(one.doubt for one in sightings if one.doubt)
    return Seen(rectified, len(features), sightings, no_stereo, remarks)


def _no_pair(left: Gray, right: Gray | None, cameras: Cameras) -> str:
    """Why stereo cannot be tried, in words; empty if it can."""
    if cameras.complaint:
        raise CairnError(cameras.complaint)
    if right is None:
        return "the right camera's image is not given"
    if cameras.right is None:
        return "the right camera's calibration is not given"
    if np.array_equal(left, right):
        return "the right image is the same as the left one: give the right camera's"
    return ""


def _odd_view(rig: StereoRig) -> list[str]:
    """What is odd about a calibration that stereo and sizes cannot contradict: all is in scale."""
    across = math.degrees(2.0 * math.atan(rig.width / 2.0 / rig.fx))
    if _NARROW <= across <= _WIDE:
        return []
    return [
        f"by its calibration the camera sees {across:.0f} deg across: if it does not, ranges and "
        "bearings are wrong, so calibrate it anew with `cairn camera calibrate`"
    ]


def _doubted(sightings: Sequence[Sighting]) -> list[Sighting]:
    """The same, with doubt of those whose ranges by stereo and by size contradict each other."""
    ratios = {one.recognition.name: one.ratio for one in sightings if one.ratio is not None}
    doubts = [
        "" if one.consistent else contradiction(one.recognition.name, ratios) for one in sightings
    ]
    return [
        replace(one, doubt="; ".join(filter(None, (one.doubt, doubt))))
        for one, doubt in zip(sightings, doubts, strict=True)
    ]


def _check_size(file: Path | None, gray: Gray | None, calibration: CameraInfo) -> None:
    if gray is None:
        return
    height, width = gray.shape
    if (width, height) != (calibration.width, calibration.height):
        raise CairnError(
            f"{file} is {width} x {height} pixels, but {calibration.header.frame_id} is of images "
            f"of {calibration.width} x {calibration.height}: give the calibration of such images"
        )


def _object(one: Sighting, names: dict[int, str]) -> dict[str, Any]:
    recognition, located = one.recognition, one.located
    place = place_of(located, _AT_CAMERA, _AIM_SD) if located is not None else None
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


def _label(one: dict[str, Any]) -> str:
    label = f"{one['name']}: {one['inliers']}"
    if one["range"] is not None:
        label += f", {one['range']:.2f} +- {math.sqrt(one['covariance'][0]):.2f} m"
    if one["alternatives"]:
        label += f"; or {', '.join(other['name'] for other in one['alternatives'])}"
    return label + ("; in doubt" if one["range"] is not None and one["doubt"] else "")


def _told(one: dict[str, Any]) -> str:
    corners = " ".join(f"{x:.0f},{y:.0f}" for x, y in one["corners"])
    told = f"{one['name']} (object {one['object_id']}): {one['inliers']} inliers, at {corners}"
    if one["range"] is not None:
        range_sd, bearing_sd = math.sqrt(one["covariance"][0]), math.sqrt(one["covariance"][3])
        told += (
            f"; {one['range']:.3f} +- {range_sd:.3f} m away, bearing "
            f"{math.degrees(one['bearing']):+.2f} +- {math.degrees(bearing_sd):.2f} deg, by "
            f"{'stereo and size' if one['ranged_by'] == 'both' else one['ranged_by']}"
        )
    if one["alternatives"]:
        told += f"; or {', '.join(other['name'] for other in one['alternatives'])}"
    return told
