"""`cairn camera`: calibrates cameras, and shows calibrations."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Annotated, Any

import typer

from cairn import CairnError
from cairn.cli.options import Json
from cairn.cli.output import line, note, print_json, show
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.tools.calibration.boards import look_for
from cairn.tools.calibration.given import sorted_out
from cairn.tools.calibration.outcome import as_json, as_rows, calibrated
from cairn.vision.calibration_picture import draw_calibration
from cairn.vision.camera_file import read_camera, write_camera
from cairn.vision.chessboard import Board
from cairn.vision.file_errors import why
from cairn.vision.stereo import StereoRig

app = typer.Typer(help="Cameras: calibrate one or a stereo pair.", no_args_is_help=True)


@app.command()
def calibrate(
    board: Annotated[
        str,
        typer.Option(
            metavar="COLUMNSxROWS", help="Inner corners of the chessboard: 9x6 has 10 x 7 squares."
        ),
    ],
    square: Annotated[
        float, typer.Option(min=0.0005, max=10.0, help="Side of the board's squares [m].")
    ],
    images: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="IMAGES...",
            help="Images of the board, or folders of them. With left and right, or cam0 and cam1, "
            "in their names (or folders' names) they are of a stereo camera.",
        ),
    ] = None,
    left: Annotated[
        list[str] | None,
        typer.Option(metavar="IMAGES", help="The left camera's: a folder or a quoted pattern."),
    ] = None,
    right: Annotated[
        list[str] | None, typer.Option(metavar="IMAGES", help="The right camera's, named the same.")
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder for calibration files and picture.")
    ] = Path("calibration"),
    force: Annotated[bool, typer.Option("--force", help="Replace a calibration there.")] = False,
    json: Json = False,
) -> None:
    """Calibrate a camera, or two as a stereo pair, from images of a chessboard.

    Writes camera.yaml (two cameras: left.yaml and right.yaml), which ROS reads as well, and
    calibration.png with residuals. Files of a pair have the same name but for left and right, or
    for the number in cam0 and cam1.
    """
    wanted = _board(board, square)
    given = sorted_out(images or [], left or [], right or [])
    if not given.left:
        raise CairnError("no images are given: name files of the board, or their folder")
    names = ["left", "right"] if given.right else ["camera"]
    files = [out / f"{name}.yaml" for name in names]
    _check_folder(out)
    for file in files:
        if file.exists() and not force:
            raise CairnError(f"{file} exists already. Give another --out, or --force.")
    groups = [given.left, given.right] if given.right else [given.left]
    outcome = calibrated(wanted, [look_for(wanted, group) for group in groups], groups)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CairnError(f"{error.filename or out} cannot be made: {why(error)}.") from error
    for file, name, info in zip(files, names, outcome.infos, strict=True):
        write_camera(file, info, name)
    picture = out / "calibration.png"
    draw_calibration(dict(zip(names, outcome.cameras, strict=True)), outcome.stereo, picture)
    written = [str(file) for file in (*files, picture)]
    if json:
        print_json({**as_json(outcome, names), "files": written})
        return
    rows, columns = as_rows(outcome)
    show(rows, columns, as_json=False)
    for name, found, info in zip(names, outcome.cameras, outcome.infos, strict=True):
        line(
            f"{name}: error {found.rms:.3f} px, focal lengths {found.intrinsics[0, 0]:.2f}, "
            f"{found.intrinsics[1, 1]:.2f} +- {found.focal_deviation:.2f} px; {_described(info)}"
        )
    if outcome.stereo is not None:
        line(f"pair: error {outcome.stereo.rms:.3f} px, baseline {outcome.stereo.baseline:.4f} m")
    for told in outcome.remarks:
        note(told)
    note(f"{', '.join(written)} written")


@app.command("show")
def show_camera(
    file: Annotated[Path, typer.Argument(help="Calibration: a camera_info YAML file.")],
    right: Annotated[
        Path | None, typer.Argument(help="That of the right camera of a stereo pair.")
    ] = None,
    json: Json = False,
) -> None:
    """Show what a calibration says, or check that two are of a stereo pair."""
    first = read_camera(file)
    second = read_camera(right) if right is not None else None
    infos = {str(file): first} if second is None else {str(file): first, str(right): second}
    shown: dict[str, Any] = {
        name: {
            "width": info.width,
            "height": info.height,
            "distortion_model": info.distortion_model,
            "focal_px": float(info.p[0]),
            "view_deg": _views(info),
        }
        for name, info in infos.items()
    }
    if second is not None:
        rig = StereoRig.of(first, second)
        shown["baseline_m"] = rig.baseline
    if json:
        print_json(shown)
        return
    for name, info in infos.items():
        line(f"{name}: {info.distortion_model}, {_described(info)}")
    if second is not None:
        line(f"a stereo pair with a baseline of {rig.baseline:.4f} m")
        line(f"1 px of disparity at 3 m is {9.0 / (rig.fx * rig.baseline):.3f} m of range")


def _check_folder(out: Path) -> None:
    """That nothing prevents it, before the long work whose results it is to hold."""
    try:
        there = next(path for path in (out, *out.parents) if path.exists())
    except OSError as error:
        raise CairnError(f"--out {out}: {why(error)}") from error
    if not there.is_dir():
        raise CairnError(f"--out {out}: {there} is a file, not a folder: give another one")
    if not os.access(there, os.W_OK | os.X_OK):
        raise CairnError(
            f"--out {out}: {there} cannot be written: give yourself the permission, or another "
            "folder"
        )


def _board(text: str, square: float) -> Board:
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise CairnError(f"--board {text}: write it as COLUMNSxROWS of inner corners, such as 9x6.")
    if not (3 <= int(columns) <= 100 and 3 <= int(rows) <= 100):
        raise CairnError(f"--board {text}: a board has 3 to 100 inner corners each way.")
    return Board(int(columns), int(rows), square)


def _views(info: CameraInfo) -> list[float]:
    """Angles of view [deg] of the rectified image, across and down."""
    spans = ((info.width, info.p[2], info.p[0]), (info.height, info.p[6], info.p[5]))
    return [
        math.degrees(math.atan((center + 0.5) / focal) + math.atan((size - 0.5 - center) / focal))
        for size, center, focal in spans
    ]


def _described(info: CameraInfo) -> str:
    across, down = _views(info)
    fx, fy = f"{info.p[0]:.2f}", f"{info.p[5]:.2f}"
    focal = f"focal length {fx}" if fx == fy else f"focal lengths {fx} and {fy}"
    return (
        f"rectified {info.width} x {info.height} px with {focal} px, view of {across:.1f} x "
        f"{down:.1f} deg"
    )
