"""The result of a calibration: cameras and remarks, as table and JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cairn import CairnError
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.tools.calibration.images import BoardCorners
from cairn.vision.calibration import (
    Calibration,
    StereoCalibration,
    calibrate,
    calibrate_pair,
    single_camera_info,
    stereo_camera_infos,
)
from cairn.vision.chessboard import Board
from cairn.vision.image_files import pair_files
from cairn.vision.optical_frames import LEFT_FRAME, RIGHT_FRAME


@dataclass(frozen=True)
class CalibrationResult:
    """One camera, or left and right with `stereo`; `remarks` are sentences for the user."""

    cameras: list[Calibration]
    infos: list[CameraInfo]
    stereo: StereoCalibration | None
    pairs: dict[str, str]
    without: list[str]
    remarks: list[str]


def calibrate_cameras(
    board: Board, found: Sequence[BoardCorners], files: Sequence[Sequence[Path]]
) -> CalibrationResult:
    """Calibrate one camera, or left and right, by the corners `found` in the images of each.

    `files` are the images of each. Raises `CairnError` if calibration is not possible.
    """
    without = [name for one in found for name in one.without]
    remarks = [f"{name}: the whole board is not visible, image excluded" for name in without]
    if len(found) == 1:
        camera = calibrate(found[0].corners, found[0].size, board)
        remarks += _fit_remarks(camera) + camera.warnings()
        infos = [single_camera_info(camera, "camera")]
        return CalibrationResult([camera], infos, None, {}, without, remarks)
    left, right = found
    if left.size != right.size:
        raise CairnError(
            f"left images are {left.size[0]} x {left.size[1]} pixels, right ones {right.size[0]} x "
            f"{right.size[1]}; set both cameras to the same size"
        )
    matched = pair_files(*files)
    pairs = {str(a): str(b) for a, b in matched.pairs}
    remarks += [f"{name}: the other image of this pair is missing" for name in matched.unpaired]
    if not pairs:
        raise CairnError(
            f"no left image matches a right one, such as {files[0][0]} and {files[1][0]}; names of "
            "a pair must differ only in left and right, or in the number of cam0 and cam1"
        )
    stereo = calibrate_pair(left.corners, right.corners, pairs, left.size, board)
    cameras = [stereo.left, stereo.right]
    remarks += [remark for camera in cameras for remark in _fit_remarks(camera)]
    remarks += [
        f"{name}: the pair does not fit the others ({error:.2f} px), excluded"
        for name, error in stereo.excluded.items()
    ]
    remarks += stereo.warnings()
    frames = (LEFT_FRAME, RIGHT_FRAME)
    infos = list(stereo_camera_infos(stereo, frames))
    return CalibrationResult(cameras, infos, stereo, pairs, without, remarks)


def as_rows(result: CalibrationResult) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Return a table of the images with their errors [px], and its columns."""
    errors = [camera.errors for camera in result.cameras]
    if result.stereo is None:
        rows = [{"image": name, "error": f"{error:.3f}"} for name, error in errors[0].items()]
        return rows, {"image": "image", "error": "error [px]"}
    rows = [
        {
            "left": a,
            "right": b,
            "left_error": _format_error(errors[0].get(a)),
            "right_error": _format_error(errors[1].get(b)),
            "pair_error": _format_error(result.stereo.errors.get(a)),
        }
        for a, b in result.pairs.items()
    ]
    titles = {"left_error": "left [px]", "right_error": "right [px]", "pair_error": "pair [px]"}
    return rows, {"left": "left", "right": "right", **titles}


def as_json(result: CalibrationResult, names: Sequence[str]) -> dict[str, Any]:
    """Return the result as JSON."""
    content: dict[str, Any] = {
        "cameras": {
            name: {
                "width": found.size[0],
                "height": found.size[1],
                "rms_px": found.rms,
                "camera_matrix": found.intrinsics.tolist(),
                "distortion_coefficients": found.distortion.tolist(),
                "focal_deviation_px": found.focal_deviation,
                "coverage": list(found.coverage),
                "errors_px": found.errors,
                "outlying_px": found.outlying,
                "excluded_px": dict(found.excluded),
            }
            for name, found in zip(names, result.cameras, strict=True)
        },
        "without_board": result.without,
        "remarks": result.remarks,
    }
    if result.stereo is not None:
        content["pair"] = {
            "rms_px": result.stereo.rms,
            "baseline_m": result.stereo.baseline,
            "translation_m": result.stereo.translation.tolist(),
            "rotation": result.stereo.rotation.tolist(),
            "errors_px": dict(result.stereo.errors),
            "excluded_px": dict(result.stereo.excluded),
        }
    return content


def _fit_remarks(found: Calibration) -> list[str]:
    remarks = [
        f"{name}: its corners do not fit ({error:.2f} px), image excluded"
        for name, error in found.excluded.items()
    ]
    return remarks + [
        f"{name}: fits worse than the others ({error:.2f} px; all: {found.rms:.2f} px)"
        for name, error in found.outlying.items()
    ]


def _format_error(error: float | None) -> str:
    return "" if error is None else f"{error:.3f}"
