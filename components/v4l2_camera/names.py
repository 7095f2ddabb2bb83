"""Cameras by names that stay the same when they are plugged in another order.

The kernel numbers `/dev/videoN` as devices come. What stays is told by sysfs: a camera's own name,
its USB numbers, and the socket it is plugged into. So it is found without udev, too.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cairn.driver.errors import LinkLost

SYSFS: Final = Path("/sys/class/video4linux")
DEV: Final = Path("/dev")

_USB = re.compile(r"usb:([0-9a-fA-F]{4}):([0-9a-fA-F]{4})(?::(.+))?")


@dataclass(frozen=True)
class CameraNode:
    """A video node: its path, its name, and for USB what it is and where it is plugged in.

    `index` numbers the nodes of one device: of a USB camera 0 has the pictures, 1 their metadata.
    """

    path: Path
    name: str
    index: int = 0
    vendor: str = ""
    product: str = ""
    serial: str = ""
    port: str = ""

    @property
    def stable(self) -> str:
        """How the node is best called in a deployment."""
        if not self.vendor:
            return f"name:{self.name}"
        serial = f":{self.serial}" if self.serial else ""
        return f"usb:{self.vendor}:{self.product}{serial}"

    def __str__(self) -> str:
        where = f", port:{self.port}" if self.port else ""
        return f"{self.path} ({self.name}; {self.stable}{where})"


def video_nodes(sysfs: Path = SYSFS, dev: Path = DEV) -> list[CameraNode]:
    """All video nodes of the computer, in order of their numbers."""
    nodes = []
    for entry in sorted(sysfs.glob("video*"), key=lambda entry: int(entry.name[5:] or 0)):
        try:
            nodes.append(_node(entry, dev))
        except OSError:  # unplugged while it was looked at
            continue
    return nodes


def find_camera(wanted: str, sysfs: Path = SYSFS, dev: Path = DEV) -> Path:
    """The path of the video node that is called so.

    That is a path (`/dev/v4l/by-id/...`), returned as it is, or one of `name:NAME` (as sysfs tells
    it), `usb:VENDOR:PRODUCT[:SERIAL]` (hexadecimal numbers) and `port:PORT` (the USB socket,
    `1-1.2`). Raises `LinkLost` if there is none now, or if there are several.
    """
    if wanted.startswith("/"):
        return Path(wanted)
    nodes = video_nodes(sysfs, dev)
    called = [node for node in nodes if _is_called(node, wanted)]
    # A device's further nodes are called as its first one.
    found = [node for node in called if node.index == 0] or called
    if len(found) == 1:
        return found[0].path
    if found:
        raise LinkLost(
            f"{wanted}: there are several such cameras: {'; '.join(map(str, found))}; tell them "
            "apart by serial number, or by port:... if they have none"
        )
    there = "; ".join(map(str, nodes)) or "none"
    raise LinkLost(f"{wanted}: there is no such camera; there are: {there}")


def is_name(text: str) -> bool:
    """Whether a camera can be called so."""
    return bool(
        text.startswith("/")
        or _USB.fullmatch(text)
        or re.fullmatch(r"name:.+|port:\d+-\d+(\.\d+)*", text)
    )


def _is_called(node: CameraNode, wanted: str) -> bool:
    usb = _USB.fullmatch(wanted)
    if usb is not None:
        return (node.vendor, node.product) == (usb[1].lower(), usb[2].lower()) and (
            usb[3] in (None, node.serial)
        )
    kind, _, value = wanted.partition(":")
    return (kind == "name" and node.name == value) or (kind == "port" and node.port == value)


def _node(entry: Path, dev: Path) -> CameraNode:
    path, name = dev / entry.name, _text(entry / "name")
    index = int(_text(entry / "index") or 0)
    # Of USB devices `device` is an interface (1-1.2:1.0) below the device itself (1-1.2).
    device = (entry / "device").resolve().parent
    if not (device / "idVendor").exists():
        return CameraNode(path, name, index)
    vendor, product = _text(device / "idVendor"), _text(device / "idProduct")
    serial = _text(device / "serial") if (device / "serial").exists() else ""
    return CameraNode(path, name, index, vendor, product, serial, device.name)


def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8", errors="replace").strip()
