"""`cairn driver probe camera`: lists cameras, and tries one or two."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import cv2
import typer
from pydantic import ValidationError

from cairn import CairnError
from cairn.cli.options import Json
from cairn.cli.output import line, note, print_json
from cairn.components.v4l2_camera.config import V4l2StereoCameraConfig
from cairn.components.v4l2_camera.listing import as_lines, listed
from cairn.components.v4l2_camera.pairing import Picture
from cairn.components.v4l2_camera.trial import tried
from cairn.runtime.parameters import error_reason


def probe(
    device: Annotated[
        str | None,
        typer.Argument(
            metavar="[CAMERA]",
            help="A path, name:NAME, usb:VENDOR:PRODUCT[:SERIAL] or port:PORT; none: list them.",
        ),
    ] = None,
    right: Annotated[
        str | None, typer.Option(metavar="CAMERA", help="The right one of two cameras.")
    ] = None,
    seconds: Annotated[float, typer.Option(min=0.5, max=3600, help="How long to try [s].")] = 3.0,
    width: Annotated[int, typer.Option(min=16, max=16384, help="Of pictures [px].")] = 640,
    height: Annotated[int, typer.Option(min=16, max=16384, help="Of pictures [px].")] = 480,
    rate: Annotated[float, typer.Option(min=0.1, max=1000, help="Pictures a second.")] = 25.0,
    format_: Annotated[
        str, typer.Option("--format", help="Of pixels: auto, GREY, YUYV or MJPG.")
    ] = "auto",
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.png", help="Save the newest picture; the right one beside it."),
    ] = None,
    json: Json = False,
) -> None:
    """List cameras with their stable names, formats and controls; or try one, or two as a pair.

    For example: cairn driver probe camera name:HD_Webcam --seconds 5 --out picture.png
    """
    if device is None:
        if right is not None or out is not None:
            raise CairnError("--right and --out are for trying a camera: name the left one first")
        _list(json=json)
        return
    if json:
        raise CairnError("--json is for the list; what a camera does is told in words")
    config = _asked(
        {
            "device": device,
            "right_device": right,
            "width": width,
            "height": height,
            "rate": rate,
            "format": format_,
        }
    )
    outcomes, apart = tried([config.settings_of(name) for name in config.devices()], seconds)
    for name, outcome in zip(config.devices(), outcomes, strict=True):
        line("\n".join(outcome.as_lines(name)))
    if right is not None:
        line("\n".join(apart.as_lines()))
    if out is not None:
        for file, outcome in zip(_files(out), outcomes, strict=False):
            _save(file, outcome.newest)
    if not all(outcome.newest for outcome in outcomes):
        raise CairnError("no picture came of every camera")


def _asked(values: dict[str, Any]) -> V4l2StereoCameraConfig:
    try:
        return V4l2StereoCameraConfig.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise CairnError(f"{key} {error_reason(first)}".lstrip()) from error


def _list(*, json: bool) -> None:
    cameras = listed()
    if json:
        print_json(cameras)
    elif not cameras:
        line("there is no camera: is it plugged in, and its driver loaded (`lsmod`: uvcvideo)?")
    for camera in [] if json else cameras:
        line("\n".join(as_lines(camera)))


def _files(out: Path) -> tuple[Path, Path]:
    return out, out.with_name(f"{out.stem}_right{out.suffix}")


def _save(file: Path, picture: Picture | None) -> None:
    if picture is None:
        return
    try:
        written = cv2.imwrite(str(file), picture.gray)
    except cv2.error as error:
        raise CairnError(f"{file}: no picture can be written so: {error.err}") from error
    if not written:
        raise CairnError(f"{file} cannot be written: is its folder there, and yours to write in?")
    note(f"{file} written")
