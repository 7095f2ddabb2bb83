"""Cameras that the kernel knows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from cairn.cli.doctor.access import access
from cairn.cli.doctor.finding import Finding

_TOPIC = "cameras"


def cameras(root: Path = Path("/")) -> Iterator[Finding]:
    """All cameras; of a device's several nodes the one with the pictures."""
    folder = root / "sys/class/video4linux"
    nodes = sorted(folder.glob("video*"), key=lambda node: int(node.name.removeprefix("video")))
    pictures = [node for node in nodes if _text(node / "index") in ("0", "")]
    for node in pictures:
        yield access(_TOPIC, root / "dev" / node.name, _described(node))
    if not pictures:
        yield Finding(_TOPIC, "video", "ok", "no camera is plugged in")


def _described(node: Path) -> str:
    name = _text(node / "name")
    device = (node / "device").resolve().parent
    if not (device / "idVendor").exists():
        return f"{name}; stable name: name:{name}"
    parts = [_text(device / part) for part in ("idVendor", "idProduct", "serial")]
    names = [f"usb:{':'.join(part for part in parts if part)}", f"port:{device.name}"]
    return f"{name}; stable names: {', '.join(names)}"


def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8", errors="replace").strip() if file.exists() else ""
