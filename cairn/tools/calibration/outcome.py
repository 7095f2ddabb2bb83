"""What came of a calibration: the cameras, and what is to be told of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cairn import CairnError
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.tools.calibration.boards import Seen
from cairn.vision.calibration import Calibration, calibrate, camera_info
from cairn.vision.chessboard import Board
from cairn.vision.image_files import paired
from cairn.vision.stereo_calibration import StereoCalibration, calibrate_pair, camera_infos


@dataclass(frozen=True)
class Outcome:
    """One camera, or left and right with `stereo`; `remarks` are sentences for the user."""

    cameras: list[Calibration]
    infos: list[CameraInfo]
    stereo: StereoCalibration | None
    pairs: dict[str, str]
    without: list[str]
    remarks: list[str]


def calibrated(board: Board, seen: Sequence[Seen], files: Sequence[Sequence[Path]]) -> Outcome:
    """The calibration by the corners `seen` of one camera, or of left and right.

    `files` are the images of each. Raises `CairnError` if they give none.
    """
    without = [name for one in seen for name in one.without]
    remarks = [f"{name}: the board is not seen whole, image left out" for name in without]
    if len(seen) == 1:
        found = calibrate(seen[0].corners, seen[0].size, board)
        remarks += _fits(found) + found.doubts()
        return Outcome([found], [camera_info(found, "camera")], None, {}, without, remarks)
    left, right = seen
    if left.size != right.size:
        raise CairnError(
            f"left images are {left.size[0]} x {left.size[1]} pixels, right ones {right.size[0]} x "
            f"{right.size[1]}: have both cameras send the same size"
        )
    of = paired(*files)
    pairs = {str(a): str(b) for a, b in of.pairs}
    remarks += [f"{name}: there is no other image of this pair" for name in of.alone]
    if not pairs:
        raise CairnError(
            f"no left image belongs to a right one, such as {files[0][0]} and {files[1][0]}: names "
            "of a pair must be the same but for left and right, or the number in cam0 and cam1"
        )
    stereo = calibrate_pair(left.corners, right.corners, pairs, left.size, board)
    cameras = [stereo.left, stereo.right]
    remarks += [remark for camera in cameras for remark in _fits(camera)]
    remarks += [
        f"{name}: the pair does not fit the others ({error:.2f} px), left out"
        for name, error in stereo.left_out.items()
    ]
    remarks += stereo.doubts()
    infos = list(camera_infos(stereo, ("left_camera_optical_frame", "right_camera_optical_frame")))
    return Outcome(cameras, infos, stereo, pairs, without, remarks)


def as_rows(outcome: Outcome) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """A table of the images with their errors [px], and its columns."""
    errors = [camera.errors for camera in outcome.cameras]
    if outcome.stereo is None:
        rows = [{"image": name, "error": f"{error:.3f}"} for name, error in errors[0].items()]
        return rows, {"image": "image", "error": "error [px]"}
    rows = [
        {
            "left": a,
            "right": b,
            "left_error": _told(errors[0].get(a)),
            "right_error": _told(errors[1].get(b)),
            "pair_error": _told(outcome.stereo.errors.get(a)),
        }
        for a, b in outcome.pairs.items()
    ]
    titles = {"left_error": "left [px]", "right_error": "right [px]", "pair_error": "pair [px]"}
    return rows, {"left": "left", "right": "right", **titles}


def as_json(outcome: Outcome, names: Sequence[str]) -> dict[str, Any]:
    """All of it for programs."""
    told: dict[str, Any] = {
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
                "left_out_px": dict(found.left_out),
            }
            for name, found in zip(names, outcome.cameras, strict=True)
        },
        "without_board": outcome.without,
        "remarks": outcome.remarks,
    }
    if outcome.stereo is not None:
        told["pair"] = {
            "rms_px": outcome.stereo.rms,
            "baseline_m": outcome.stereo.baseline,
            "translation_m": outcome.stereo.translation.tolist(),
            "rotation": outcome.stereo.rotation.tolist(),
            "errors_px": dict(outcome.stereo.errors),
            "left_out_px": dict(outcome.stereo.left_out),
        }
    return told


def _fits(found: Calibration) -> list[str]:
    told = [
        f"{name}: its corners do not fit ({error:.2f} px), image left out"
        for name, error in found.left_out.items()
    ]
    return told + [
        f"{name}: fits worse than the others ({error:.2f} px; all: {found.rms:.2f} px)"
        for name, error in found.outlying.items()
    ]


def _told(error: float | None) -> str:
    return "" if error is None else f"{error:.3f}"
