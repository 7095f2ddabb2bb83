"""`cairn recognize`: recognizes objects in an image and measures where they are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from cairn import CairnError
from cairn.components.object_recognizer.cameras import (
    Cameras,
    cameras_are_swapped,
    make_cameras,
    why_blind,
    why_no_pair,
)
from cairn.components.object_recognizer.object_cli import DEFAULT_MAP, MapFile
from cairn.components.object_recognizer.observation import (
    explain_disagreement,
    make_observation,
    measure_range,
    reject_mixed_up_twins,
)
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.terminal.options import Json
from cairn.terminal.output import line, note, print_json
from cairn.vision.camera_file import read_camera
from cairn.vision.features import extract
from cairn.vision.images import Gray, read_image
from cairn.vision.object_model import ObjectModel
from cairn.vision.recognition import Detection, Recognizer
from cairn.vision.stereo import StereoRig
from cairn.visual_map.object_models import read_models

_AT_CAMERA = (0.0, 0.0, 0.0)
# Error of the camera's direction by its calibration [rad]: the principal point is one or two pixels
# off.
_DIRECTION_SD = 0.003
# Usual limits of the horizontal field of view of a robot's camera without distortion [deg].
_NARROW, _WIDE = 15.0, 140.0


@dataclass(frozen=True)
class RecognitionResult:
    """The detections in an image, which is rectified if the camera is calibrated, and remarks.

    `no_stereo` says why stereo measured nothing; it is empty if stereo was possible.
    """

    gray: Gray
    features: int
    detections: list[Detection]
    no_stereo: str
    remarks: list[str]


def recognize(
    image: Annotated[Path, typer.Argument(metavar="IMAGE", help="The image, or the left one.")],
    right_image: Annotated[
        Path | None,
        typer.Argument(metavar="RIGHT_IMAGE", help="The right camera's image of the same moment."),
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
        typer.Option(metavar="PICTURE", help="Draw the detections: outlines and features."),
    ] = None,
    json: Json = False,
) -> None:
    """Recognize objects in an image; with a calibration, measure where they are.

    Range [m] and bearing [rad, left positive] are from the camera, in the plane; corners are in the
    image, in the rectified one if there is a calibration. To recognize nothing is not an error.

    --json prints image, right_image, map, width, height, features, remarks and objects, each with
    object_id, name, view, inliers, corners (four x, y [px]: top left, top right, bottom right,
    bottom left of the view), alternatives (object_id and name each), and range, bearing, covariance
    (2 x 2 of both, row by row), position (x right, y down, z ahead [m]) and ranged_by (stereo, size
    or both), which are null if unknown; warning says why, or why they may be wrong. no_stereo says
    why nothing was ranged by stereo, and is null if stereo was possible.
    """
    if out is not None and any(_same(out, given) for given in (image, right_image)):
        raise CairnError(f"--out {out} is the input image; give another name")
    infos = camera_info or []
    if len(infos) > 2:
        raise CairnError(
            "give --camera-info at most twice: for the left camera, then for the right one"
        )
    models = {one.object_id: one for one in read_models(map_file or DEFAULT_MAP).models}
    left = read_image(image)
    right = read_image(right_image) if right_image is not None else None
    cameras = None
    if infos:
        calibrations = [read_camera(file, str(file)) for file in infos]
        given = zip((image, right_image), (left, right), calibrations, strict=False)
        for file, gray, calibration in given:
            _check_size(file, gray, calibration)
        cameras = make_cameras(calibrations[0], calibrations[1] if len(infos) == 2 else None)
    result = _recognize(image, right_image, left, right, cameras, models)
    objects = [_object(one, models) for one in result.detections]
    if out is not None:
        from cairn.components.object_recognizer.drawing import draw_detections  # loads Matplotlib

        labels = [_label(one) for one in objects]
        draw_detections(result.gray, result.detections, labels, out)
    if json:
        print_json(
            {
                "image": str(image),
                "right_image": str(right_image) if right_image is not None else None,
                "map": str(map_file or DEFAULT_MAP),
                "width": result.gray.shape[1],
                "height": result.gray.shape[0],
                "features": result.features,
                "objects": objects,
                "no_stereo": result.no_stereo or None,
                "remarks": result.remarks,
            }
        )
        return
    for one in objects:
        line(_sentence(one))
    if not objects:
        line("nothing recognized")
    for remark in result.remarks:
        note(remark)


def _same(one: Path, other: Path | None) -> bool:
    return other is not None and one.exists() and other.exists() and one.samefile(other)


def _recognize(
    image: Path,
    right_image: Path | None,
    left: Gray,
    right: Gray | None,
    cameras: Cameras | None,
    models: dict[int, ObjectModel],
) -> RecognitionResult:
    remarks = []
    if not models:
        remarks.append("this map has no object models; teach objects with `cairn object teach`")
    rectified = left if cameras is None else cameras.left.apply(left)
    features = extract(rectified)
    blind = why_blind(rectified)
    if blind:
        remarks.append(f"the image shows little: {blind}")
    height, width = rectified.shape
    detections = Recognizer(tuple(models.values())).recognize(features, width, height)
    if cameras is None:
        remarks.append("no range: give the camera's calibration by --camera-info")
        detections = [replace(one, warning="no calibration") for one in detections]
        no_stereo = "no calibration"
    else:
        remarks += _view_remarks(cameras.rig)
        no_stereo = _why_no_stereo(left, right, cameras)
        other = None
        if not no_stereo and right is not None and cameras.right is not None:
            other = cameras.right.apply(right)
            if cameras_are_swapped(rectified, other, features, cameras.rig):
                raise CairnError(
                    f"left and right are swapped: {image} is the right camera's image; give the "
                    f"left camera's image first, {right_image}"
                )
        detections = _with_warnings(
            reject_mixed_up_twins(
                [measure_range(one, models, cameras, rectified, other) for one in detections]
            )
        )
        if other is not None and not any(one.has_stereo_range for one in detections):
            no_stereo = why_no_pair(rectified, other, features, cameras.rig)
            if any(one.rows_off for one in detections):
                no_stereo = "the rows of the images are not aligned"
            elif detections and not no_stereo:
                no_stereo = "the objects are not found in the right image, or are too far away"
        if no_stereo and (right is not None or cameras.right is not None):
            remarks.append(f"no stereo: {no_stereo}")
        remarks += dict.fromkeys(one.warning for one in detections if one.warning)
    return RecognitionResult(rectified, len(features), detections, no_stereo, remarks)


def _why_no_stereo(left: Gray, right: Gray | None, cameras: Cameras) -> str:
    """Return why stereo is not possible, "" if it is."""
    if cameras.pair_error:
        raise CairnError(cameras.pair_error)
    if right is None:
        return "the right camera's image is not given"
    if cameras.right is None:
        return "the right camera's calibration is not given"
    if np.array_equal(left, right):
        return "the right image is the same as the left one; give the right camera's image"
    return ""


def _view_remarks(rig: StereoRig) -> list[str]:
    """Return remarks on a focal length that stereo and sizes cannot check: both scale with it."""
    across = math.degrees(2.0 * math.atan(rig.width / 2.0 / rig.fx))
    if _NARROW <= across <= _WIDE:
        return []
    return [
        f"the calibration has a field of view of {across:.0f} deg: if the camera's is different, "
        "ranges and bearings are wrong; calibrate it again with `cairn camera calibrate`"
    ]


def _with_warnings(detections: Sequence[Detection]) -> list[Detection]:
    """Add warnings to detections whose ranges by stereo and by size contradict each other."""
    ratios = {one.name: one.range_ratio for one in detections if one.range_ratio is not None}
    warnings = [
        "" if one.ranges_agree else explain_disagreement(one.name, ratios) for one in detections
    ]
    return [
        replace(one, warning="; ".join(filter(None, (one.warning, warning))))
        for one, warning in zip(detections, warnings, strict=True)
    ]


def _check_size(file: Path | None, gray: Gray | None, calibration: CameraInfo) -> None:
    if gray is None:
        return
    height, width = gray.shape
    if (width, height) != (calibration.width, calibration.height):
        raise CairnError(
            f"{file} is {width} x {height} pixels, but {calibration.header.frame_id} is of images "
            f"of {calibration.width} x {calibration.height}; give the calibration of this size"
        )


def _object(detection: Detection, models: dict[int, ObjectModel]) -> dict[str, Any]:
    position = detection.position
    observed = make_observation(detection, _AT_CAMERA, _DIRECTION_SD)
    return {
        "object_id": detection.object_id,
        "name": detection.name,
        "view": detection.view,
        "inliers": detection.inliers,
        "corners": detection.corners.tolist(),
        "alternatives": [
            {"object_id": other, "name": models[other].name} for other in detection.alternatives
        ],
        "range": observed.range if observed else None,
        "bearing": observed.bearing if observed else None,
        "covariance": observed.covariance.tolist() if observed else None,
        "position": position.position.tolist() if position is not None else None,
        "ranged_by": detection.ranged_by if position is not None else None,
        "warning": detection.warning or None,
    }


def _label(one: dict[str, Any]) -> str:
    label = f"{one['name']}: {one['inliers']}"
    if one["range"] is not None:
        label += f", {one['range']:.2f} +- {math.sqrt(one['covariance'][0]):.2f} m"
    if one["alternatives"]:
        label += f"; or {', '.join(other['name'] for other in one['alternatives'])}"
    return label + ("; doubtful" if one["range"] is not None and one["warning"] else "")


def _sentence(one: dict[str, Any]) -> str:
    corners = " ".join(f"{x:.0f},{y:.0f}" for x, y in one["corners"])
    text = f"{one['name']} (object {one['object_id']}): {one['inliers']} inliers, at {corners}"
    if one["range"] is not None:
        range_sd, bearing_sd = math.sqrt(one["covariance"][0]), math.sqrt(one["covariance"][3])
        text += (
            f"; {one['range']:.3f} +- {range_sd:.3f} m away, bearing "
            f"{math.degrees(one['bearing']):+.2f} +- {math.degrees(bearing_sd):.2f} deg, by "
            f"{'stereo and size' if one['ranged_by'] == 'both' else one['ranged_by']}"
        )
    if one["alternatives"]:
        text += f"; or {', '.join(other['name'] for other in one['alternatives'])}"
    return text
