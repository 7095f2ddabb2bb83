"""What cameras there are, and what each offers."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from cairn.components.v4l2_camera.controls import Control
from cairn.components.v4l2_camera.device import VideoDevice
from cairn.components.v4l2_camera.names import CameraNode, video_nodes
from cairn.components.v4l2_camera.pixels import FORMATS
from cairn.driver.errors import DeviceError

_LINKS = (Path("/dev/v4l/by-id"), Path("/dev/v4l/by-path"))


def listed() -> list[dict[str, Any]]:
    """All video nodes: where, their stable names, and what they offer or why that is not known."""
    return [_told(node) for node in video_nodes()]


def as_lines(camera: dict[str, Any]) -> Sequence[str]:
    """One of them in words."""
    lines = [f"{camera['path']}  {camera['name']}", f"  called {', '.join(camera['names'])}"]
    if camera["fault"]:
        return [*lines, f"  {camera['fault']}"]
    for name, sizes in camera["formats"].items():
        lines.append(f"  {name}: {'; '.join(sizes) or 'sizes are not told'}")
    if camera["other_formats"]:
        lines.append(f"  not read by this driver: {', '.join(camera['other_formats'])}")
    lines += [_control_line(control) for control in camera["controls"]]
    return lines


def _control_line(control: dict[str, Any]) -> str:
    value = "unknown" if control["value"] is None else control["value"]
    held = " (something automatic holds it)" if control["inactive"] else ""
    return (
        f"  {control['name']} = {value}{held}: {control['bounds']}; {control['default']} by default"
    )


def _told(node: CameraNode) -> dict[str, Any]:
    told: dict[str, Any] = {
        "path": str(node.path),
        "name": node.name,
        "names": _names(node),
        "fault": "",
        "formats": {},
        "other_formats": [],
        "controls": [],
    }
    try:
        device = VideoDevice(node.path)
    except DeviceError as error:
        return told | {"fault": str(error)}
    try:
        formats = device.formats()
        return told | {
            "formats": {
                name: [str(size) for size in device.sizes(name)]
                for name in FORMATS
                if name in formats
            },
            "other_formats": [name for name in formats if name not in FORMATS],
            "controls": [_control(device, control) for control in device.controls().values()],
        }
    except DeviceError as error:
        return told | {"fault": str(error)}
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


def _control(device: VideoDevice, control: Control) -> dict[str, Any]:
    value: int | None = None
    with suppress(DeviceError):  # some firmware does not answer for all that it offers
        value = device.control(control)
    return {
        "name": control.name,
        "value": value,
        "bounds": control.bounds,
        "default": control.default,
        "inactive": control.inactive,
    }
