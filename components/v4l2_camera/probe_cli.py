"""`cairn driver probe camera`: lists cameras and their controls, and tries one or two of them."""

from __future__ import annotations

import logging
import queue
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from pydantic import ValidationError

from cairn import SECOND, CairnError
from cairn.components.v4l2_camera.camera import VideoCamera
from cairn.components.v4l2_camera.camera_names import CameraNode, video_nodes
from cairn.components.v4l2_camera.config import CameraSettings, V4l2StereoCameraConfig
from cairn.components.v4l2_camera.controls import CameraControl
from cairn.components.v4l2_camera.decoding import FORMATS
from cairn.components.v4l2_camera.device import VideoDevice
from cairn.components.v4l2_camera.format_negotiation import CaptureFormat
from cairn.components.v4l2_camera.pairing import StampedImage, StereoPairer
from cairn.driver.device_thread import DeviceThread
from cairn.driver.errors import DeviceError
from cairn.runtime.parameters import error_reason
from cairn.terminal.options import Json
from cairn.terminal.output import line, note, print_json
from cairn.vision.images import write_picture

_LINKS = (Path("/dev/v4l/by-id"), Path("/dev/v4l/by-path"))
_USUAL_RATE = 25.0  # [1/s], of a camera that does not report it


@dataclass
class CameraTrial:
    """What one camera sent: its counts, ages of its images [s], the newest one, errors."""

    camera: VideoCamera
    capture_format: CaptureFormat
    rate: float = 0.0
    ages: list[float] = field(default_factory=list)
    newest: StampedImage | None = None
    errors: list[str] = field(default_factory=list)

    def as_lines(self, name: str) -> list[str]:
        """Return the trial in words."""
        counts = vars(self.camera.counts)
        lines = [
            f"{name}: {self.camera.identity}",
            f"  {self.capture_format.layout}, {self.rate:.4g} images per second; negotiated "
            f"{self.capture_format.rate:.4g}",
            "  " + ", ".join(f"{number} {name}" for name, number in counts.items()),
        ]
        if self.ages:
            stamped = "start of exposure" if self.camera.stamps_at_start else "end of transfer"
            mean = sum(self.ages) / len(self.ages)
            lines.append(
                f"  stamped at the {stamped}; read {1e3 * mean:.3g} ms later on average, at most "
                f"{1e3 * max(self.ages):.3g}"
            )
        return [*lines, *(f"  {error}" for error in self.errors)]


@dataclass(frozen=True)
class PairTrial:
    """How two cameras pair: number of pairs, their time offsets [s], unpaired images."""

    pairs: int
    offsets: list[float]
    unpaired: int

    def as_lines(self) -> list[str]:
        """Return the trial in words."""
        if not self.offsets:
            return [f"no pairs; {self.unpaired} unpaired images"]
        mean = sum(self.offsets) / len(self.offsets)
        return [
            f"{self.pairs} pairs, {self.unpaired} unpaired images; right "
            f"{1e3 * mean:+.2f} ms after left, from {1e3 * min(self.offsets):+.2f} to "
            f"{1e3 * max(self.offsets):+.2f}"
        ]


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
    width: Annotated[int, typer.Option(min=16, max=16384, help="Width of images [px].")] = 640,
    height: Annotated[int, typer.Option(min=16, max=16384, help="Height of images [px].")] = 480,
    rate: Annotated[float, typer.Option(min=0.1, max=1000, help="Images per second.")] = 25.0,
    format_: Annotated[
        str, typer.Option("--format", help="Pixel format: auto, GREY, YUYV or MJPG.")
    ] = "auto",
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.png", help="Save the newest image; the right one beside it."),
    ] = None,
    json: Json = False,
) -> None:
    """List cameras with their stable names, formats and controls; or try one, or two as a pair.

    For example: cairn driver probe camera name:HD_Webcam --seconds 5 --out image.png
    """
    if device is None:
        if right is not None or out is not None:
            raise CairnError("--right and --out need a camera to try; name the left one first")
        _list_cameras(json=json)
        return
    if json:
        raise CairnError("--json works for the list only; leave it out to try a camera")
    config = _config(
        {
            "device": device,
            "right_device": right,
            "width": width,
            "height": height,
            "rate": rate,
            "format": format_,
        }
    )
    trials, pairs = try_cameras([config.settings_of(name) for name in config.devices()], seconds)
    for name, trial in zip(config.devices(), trials, strict=True):
        line("\n".join(trial.as_lines(name)))
    if right is not None:
        line("\n".join(pairs.as_lines()))
    if out is not None:
        files = out, out.with_name(f"{out.stem}_right{out.suffix}")
        for file, trial in zip(files, trials, strict=False):
            if trial.newest is not None:
                write_picture(trial.newest.gray, file)
                note(f"{file} written")
    if not all(trial.newest for trial in trials):
        raise CairnError("not every camera sent an image; see the lines above")


def describe_cameras() -> list[dict[str, Any]]:
    """Return all video nodes: path, stable names, and what they offer or why that is unknown."""
    return [_describe(node) for node in video_nodes()]


def description_lines(camera: dict[str, Any]) -> Sequence[str]:
    """Return the description of one video node in words."""
    lines = [f"{camera['path']}  {camera['name']}", f"  names: {', '.join(camera['names'])}"]
    if camera["error"]:
        return [*lines, f"  {camera['error']}"]
    for name, sizes in camera["formats"].items():
        lines.append(f"  {name}: {'; '.join(sizes) or 'sizes are not reported'}")
    if camera["other_formats"]:
        lines.append(f"  not supported by this driver: {', '.join(camera['other_formats'])}")
    lines += [_control_line(control) for control in camera["controls"]]
    return lines


def try_cameras(
    cameras: Sequence[CameraSettings], seconds: float
) -> tuple[list[CameraTrial], PairTrial]:
    """Read one or two cameras for a time [s]; raises `DeviceError` if one cannot be opened."""
    images: queue.Queue[tuple[int, StampedImage]] = queue.Queue()
    log = logging.getLogger(__name__)
    with ExitStack() as stack:
        trials = []
        for side, settings in enumerate(cameras):
            camera = VideoCamera(settings, {}, lambda _: None, partial(_put, images, side), log)
            stack.callback(camera.close)
            trials.append(CameraTrial(camera, camera.open()))
        for side, trial in enumerate(trials):
            thread = DeviceThread(
                f"camera {side}",
                trial.camera.serve,
                log=log,
                on_device_error=partial(_note_error, trial),
                on_failure=partial(_note_error, trial),
            )
            thread.start()
            stack.callback(thread.stop)
        return trials, _collect(images, trials, seconds)


def _config(values: dict[str, Any]) -> V4l2StereoCameraConfig:
    try:
        return V4l2StereoCameraConfig.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(map(str, first["loc"]))
        raise CairnError(f"{key} {error_reason(first)}".lstrip()) from error


def _list_cameras(*, json: bool) -> None:
    cameras = describe_cameras()
    if json:
        print_json(cameras)
    elif not cameras:
        line("no cameras found: check that one is plugged in, and that `lsmod` shows uvcvideo")
    for camera in [] if json else cameras:
        line("\n".join(description_lines(camera)))


def _control_line(control: dict[str, Any]) -> str:
    value = "unknown" if control["value"] is None else control["value"]
    inactive = " (set automatically by the camera)" if control["inactive"] else ""
    return (
        f"  {control['name']} = {value}{inactive}: {control['bounds']}; default "
        f"{control['default']}"
    )


def _describe(node: CameraNode) -> dict[str, Any]:
    description: dict[str, Any] = {
        "path": str(node.path),
        "name": node.name,
        "names": _names(node),
        "error": "",
        "formats": {},
        "other_formats": [],
        "controls": [],
    }
    try:
        device = VideoDevice(node.path)
    except DeviceError as error:
        return description | {"error": str(error)}
    try:
        formats = device.formats()
        return description | {
            "formats": {
                name: [str(size) for size in device.sizes(name)]
                for name in FORMATS
                if name in formats
            },
            "other_formats": [name for name in formats if name not in FORMATS],
            "controls": [
                _describe_control(device, control) for control in device.controls().values()
            ],
        }
    except DeviceError as error:
        return description | {"error": str(error)}
    finally:
        device.close()


def _names(node: CameraNode) -> list[str]:
    links = [
        str(link)
        for folder in _LINKS
        if folder.is_dir()
        for link in sorted(folder.iterdir())
        if link.resolve() == node.path
    ]
    port = [f"port:{node.port}"] if node.port else []
    return [*links, node.stable, *port]


def _describe_control(device: VideoDevice, control: CameraControl) -> dict[str, Any]:
    value: int | None = None
    with suppress(DeviceError):  # some firmware fails to read controls that it offers
        value = device.control(control)
    return {
        "name": control.name,
        "value": value,
        "bounds": control.bounds,
        "default": control.default,
        "inactive": control.inactive,
    }


def _put(images: queue.Queue[tuple[int, StampedImage]], side: int, image: StampedImage) -> None:
    images.put((side, image))


def _collect(
    images: queue.Queue[tuple[int, StampedImage]],
    trials: Sequence[CameraTrial],
    seconds: float,
) -> PairTrial:
    slowest = min(trial.capture_format.rate or _USUAL_RATE for trial in trials)
    pairer, offsets = StereoPairer(round(0.5 * SECOND / slowest)), []
    deadline = time.monotonic() + seconds
    while (left_s := deadline - time.monotonic()) > 0:
        try:
            side, image = images.get(timeout=left_s)
        except queue.Empty:
            break
        trial = trials[side]
        trial.newest = image
        trial.ages.append(trial.camera.latency_s)
        if pairer.add(side, image) is not None:
            offsets.append(1e-9 * pairer.offset)
    for trial in trials:
        trial.rate = trial.camera.rate()
    return PairTrial(pairer.pairs, offsets, sum(pairer.unpaired))


def _note_error(trial: CameraTrial, error: Exception) -> None:
    if str(error) not in trial.errors:
        trial.errors.append(str(error) if isinstance(error, DeviceError) else repr(error))
