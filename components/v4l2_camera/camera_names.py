"""Finding cameras by names that do not depend on the order in which they are plugged in.

The kernel numbers `/dev/videoN` in the order in which devices appear. What stays the same is in
sysfs: a camera's own name, its USB ids, and the port it is plugged into. So udev is not needed.
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
    """A video node: its path, its name, and for USB its ids and its port.

    `index` numbers the nodes of one device: of a USB camera 0 has the images, 1 their metadata.
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
        """The best name of the node in a deployment."""
        if not self.vendor:
            return f"name:{self.name}"
        serial = f":{self.serial}" if self.serial else ""
        return f"usb:{self.vendor}:{self.product}{serial}"

    def __str__(self) -> str:
        where = f", port:{self.port}" if self.port else ""
        return f"{self.path} ({self.name}; {self.stable}{where})"


def video_nodes(sysfs: Path = SYSFS, dev: Path = DEV) -> list[CameraNode]:
    """Return all video nodes of the computer, in the order of their numbers."""
    nodes = []
    for entry in sorted(sysfs.glob("video*"), key=lambda entry: int(entry.name[5:] or 0)):
        try:
            nodes.append(_node(entry, dev))
        except OSError:  # unplugged meanwhile
            continue
    return nodes


def find_camera(name: str, sysfs: Path = SYSFS, dev: Path = DEV) -> Path:
    """Return the path of the video node with a name.

    The name is a path (`/dev/v4l/by-id/...`), which is returned unchanged, or one of `name:NAME`
    (as in sysfs), `usb:VENDOR:PRODUCT[:SERIAL]` (hexadecimal ids) and `port:PORT` (the USB port,
    `1-1.2`). Raises `LinkLost` if there is none now, or if there are several.
    """
    if name.startswith("/"):
        return Path(name)
    nodes = video_nodes(sysfs, dev)
    matching = [node for node in nodes if _matches(node, name)]
    # The other nodes of a device have the name of its first one.
    found = [node for node in matching if node.index == 0] or matching
    if len(found) == 1:
        return found[0].path
    if found:
        raise LinkLost(
            f"{name}: there are several such cameras: {'; '.join(map(str, found))}; name one "
            "by serial number, or by port:... if they have none"
        )
    known = "; ".join(map(str, nodes)) or "none"
    raise LinkLost(f"{name}: there is no such camera; there are: {known}")


def is_name(text: str) -> bool:
    """Return whether a text can name a camera."""
    return bool(
        text.startswith("/")
        or _USB.fullmatch(text)
        or re.fullmatch(r"name:.+|port:\d+-\d+(\.\d+)*", text)
    )


def _matches(node: CameraNode, name: str) -> bool:
    usb = _USB.fullmatch(name)
    if usb is not None:
        return (node.vendor, node.product) == (usb[1].lower(), usb[2].lower()) and (
            usb[3] in (None, node.serial)
        )
    kind, _, value = name.partition(":")
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
