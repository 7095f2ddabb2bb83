"""`cairn camera`: calibrates cameras, and shows calibrations."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Annotated, Any

import typer

from cairn import CairnError
from cairn.schemas.sensor_msgs import CameraInfo
from cairn.system.files import explain_os_error, explained
from cairn.terminal.options import Json
from cairn.terminal.output import line, note, print_json, show
from cairn.tools.calibration.images import find_board, find_images
from cairn.tools.calibration.result import (
    as_json,
    as_rows,
    calibrate_cameras,
)
from cairn.vision.camera_file import read_camera, write_camera
from cairn.vision.chessboard import Board
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
            "in the names of files or folders, they are of a stereo pair.",
        ),
    ] = None,
    left: Annotated[
        list[str] | None,
        typer.Option(
            metavar="IMAGES", help="Images of the left camera: a folder or a quoted pattern."
        ),
    ] = None,
    right: Annotated[
        list[str] | None,
        typer.Option(metavar="IMAGES", help="Images of the right camera, with the same names."),
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder for calibration files and plot.")
    ] = Path("calibration"),
    force: Annotated[
        bool, typer.Option("--force", help="Replace an existing calibration.")
    ] = False,
    json: Json = False,
) -> None:
    """Calibrate a camera, or two as a stereo pair, from images of a chessboard.

    Writes camera.yaml (two cameras: left.yaml and right.yaml), which ROS can read, and
    calibration.png with residuals. Names of a pair must differ only in left and right, or in the
    number of cam0 and cam1.
    """
    # Before the work: Matplotlib may not be installed.
    from cairn.tools.calibration.plot import plot_calibration

    expected = _parse_board(board, square)
    found = find_images(images or [], left or [], right or [])
    if not found.left:
        raise CairnError("no images are given; give image files of the board, or their folder")
    names = ["left", "right"] if found.right else ["camera"]
    files = [out / f"{name}.yaml" for name in names]
    _check_folder(out)
    for file in files:
        if file.exists() and not force:
            raise CairnError(f"{file} exists already; give another --out, or --force")
    groups = [found.left, found.right] if found.right else [found.left]
    result = calibrate_cameras(expected, [find_board(expected, group) for group in groups], groups)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CairnError(
            f"{error.filename or out} cannot be made: {explain_os_error(error)}"
        ) from error
    for file, name, info in zip(files, names, result.infos, strict=True):
        write_camera(file, info, name)
    plot = out / "calibration.png"
    plot_calibration(dict(zip(names, result.cameras, strict=True)), result.stereo, plot)
    written = [str(file) for file in (*files, plot)]
    if json:
        print_json({**as_json(result, names), "files": written})
        return
    rows, columns = as_rows(result)
    show(rows, columns, as_json=False)
    for name, camera, info in zip(names, result.cameras, result.infos, strict=True):
        line(
            f"{name}: error {camera.rms:.3f} px, focal lengths {camera.intrinsics[0, 0]:.2f}, "
            f"{camera.intrinsics[1, 1]:.2f} +- {camera.focal_deviation:.2f} px; {_summary(info)}"
        )
    if result.stereo is not None:
        line(f"pair: error {result.stereo.rms:.3f} px, baseline {result.stereo.baseline:.4f} m")
    for remark in result.remarks:
        note(remark)
    note(f"{', '.join(written)} written")


@app.command("show")
def show_camera(
    file: Annotated[Path, typer.Argument(help="Calibration: a camera_info YAML file.")],
    right: Annotated[
        Path | None, typer.Argument(help="The calibration of the right camera of a stereo pair.")
    ] = None,
    json: Json = False,
) -> None:
    """Show a calibration, or check that two are of a stereo pair."""
    first = read_camera(file)
    second = read_camera(right) if right is not None else None
    infos = {str(file): first} if second is None else {str(file): first, str(right): second}
    shown: dict[str, Any] = {
        name: {
            "width": info.width,
            "height": info.height,
            "distortion_model": info.distortion_model,
            "focal_px": float(info.p[0]),
            "view_deg": _view_angles(info),
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
        line(f"{name}: {info.distortion_model}, {_summary(info)}")
    if second is not None:
        line(f"a stereo pair with a baseline of {rig.baseline:.4f} m")
        line(f"1 px of disparity at 3 m is {9.0 / (rig.fx * rig.baseline):.3f} m of range")


def _check_folder(out: Path) -> None:
    """Raise `CairnError` if the results cannot be written, before the slow work."""
    with explained(f"--out {out}"):
        parent = next(path for path in (out, *out.parents) if path.exists())
    if not parent.is_dir():
        raise CairnError(f"--out {out}: {parent} is a file, not a folder; give another one")
    if not os.access(parent, os.W_OK | os.X_OK):
        raise CairnError(
            f"--out {out}: {parent} is not writable; change its permissions, or give another folder"
        )


def _parse_board(text: str, square: float) -> Board:
    columns, _, rows = text.lower().partition("x")
    if not (columns.isdecimal() and rows.isdecimal()):
        raise CairnError(f"--board {text}: write it as COLUMNSxROWS of inner corners, such as 9x6")
    if not (3 <= int(columns) <= 100 and 3 <= int(rows) <= 100):
        raise CairnError(f"--board {text}: a board has 3 to 100 inner corners each way.")
    return Board(int(columns), int(rows), square)


def _view_angles(info: CameraInfo) -> list[float]:
    """Return the horizontal and vertical angles of view [deg] of the rectified image."""
    spans = ((info.width, info.p[2], info.p[0]), (info.height, info.p[6], info.p[5]))
    return [
        math.degrees(math.atan((center + 0.5) / focal) + math.atan((size - 0.5 - center) / focal))
        for size, center, focal in spans
    ]


def _summary(info: CameraInfo) -> str:
    across, down = _view_angles(info)
    fx, fy = f"{info.p[0]:.2f}", f"{info.p[5]:.2f}"
    focal = f"focal length {fx}" if fx == fy else f"focal lengths {fx} and {fy}"
    return (
        f"rectified {info.width} x {info.height} px with {focal} px, view of {across:.1f} x "
        f"{down:.1f} deg"
    )
