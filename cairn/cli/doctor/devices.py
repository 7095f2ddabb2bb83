"""Serial ports and cameras: what is plugged in, and whether it may be opened and is free."""

from __future__ import annotations

import getpass
import grp
import os
import socket
import stat
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import psutil
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from cairn.cli.doctor import Finding

_SERIAL, _CAMERAS = "serial ports", "cameras"
_PTY_MASTERS = {"/dev/ptmx", "/dev/pts/ptmx"}
"""A process that has one of these open provides a port in software: it is the device itself."""

_KNOWN = {
    (0x15D1, 0x0000): "Hokuyo range scanner",
    (0x03EB, 0x2404): "RoboClaw motor controller",
    (0x0403, 0x6001): "FTDI RS-232 adapter",
    (0x0403, 0x6015): "FTDI RS-232 adapter",
    (0x067B, 0x2303): "Prolific RS-232 adapter",
    (0x10C4, 0xEA60): "Silicon Labs RS-232 adapter",
    (0x1A86, 0x7523): "CH340 RS-232 adapter",
}
_LINK_FOLDERS = (Path("/dev/serial/by-id"), Path("/dev/cairn"))
_DISTURBING = {
    "ModemManager": "probes every serial port that is plugged in, as if it were a modem",
    "brltty": "takes serial adapters for Braille displays",
}
_INSTALL_RULES = "install Cairn's udev rules (docs/how-to/robot.md)"


def serial_ports() -> Iterator[Finding]:
    """Check all serial ports of USB devices, and report programs that disturb them."""
    ports = [port for port in list_ports.comports() if port.vid is not None]
    for port in ports:
        yield access(_SERIAL, Path(port.device), _described_port(port))
    if not ports:
        yield Finding(_SERIAL, "USB", "ok", "no serial device is plugged in")
    running = {process.info["name"]: process.pid for process in psutil.process_iter(["name"])}
    for name, effect in _DISTURBING.items():
        if name in running:
            remedy = f"{_INSTALL_RULES}, or: sudo systemctl disable --now {name}"
            found = f"runs ({running[name]}), and {effect}"
            yield Finding(_SERIAL, name, "warn", found, remedy)


def cameras(root: Path = Path("/")) -> Iterator[Finding]:
    """Check all cameras; of a camera's several nodes the one that has the images."""
    folder = root / "sys/class/video4linux"
    nodes = sorted(folder.glob("video*"), key=lambda node: int(node.name.removeprefix("video")))
    with_images = [node for node in nodes if _text(node / "index") in ("0", "")]
    for node in with_images:
        yield access(_CAMERAS, root / "dev" / node.name, _described_camera(node))
    if not with_images:
        yield Finding(_CAMERAS, "video", "ok", "no camera is plugged in")


def access(topic: str, path: Path, description: str) -> Finding:
    """Check whether a device may be opened and is free; it is not opened, which could reset it."""
    if not path.exists():
        remedy = "plug it in, or correct the name; the kernel's log shows what was plugged in"
        return Finding(topic, str(path), "fail", f"{description}: does not exist", remedy)
    if not stat.S_ISCHR(path.stat().st_mode):
        remedy = "remove the file, and plug the device in again"
        found = f"{description}: is a file, not a device"
        return Finding(topic, str(path), "fail", found, remedy)
    if not os.access(path, os.R_OK | os.W_OK):
        found = f"{description}: may not be opened"
        return Finding(topic, str(path), "fail", found, _access_remedy(path))
    if users := opened_by(path, with_cairn=False):
        remedy = "end that process: two programs that read one device take each other's answers"
        found = f"{description}: in use by {', '.join(users)}"
        return Finding(topic, str(path), "warn", found, remedy)
    of_cairn = opened_by(path)
    found = f"{description}; in use by {', '.join(of_cairn)}" if of_cairn else description
    return Finding(topic, str(path), "ok", found)


def opened_by(path: Path, *, with_cairn: bool = True) -> list[str]:
    """Return the processes that have a device open, as `name (pid)`.

    Only root sees those of other users. Without `with_cairn`, components of Cairn are left out.
    """
    device = os.path.realpath(path)
    users = []
    for process in psutil.process_iter():
        with suppress(OSError, psutil.Error):
            folder = Path(f"/proc/{process.pid}/fd")
            links = {os.readlink(one) for one in folder.iterdir()}
            if device in links and not links & _PTY_MASTERS:
                name = _process_name(process)
                if with_cairn or not name.startswith("cairn:"):
                    users.append(name)
    return users


def connected_to(host: str, port: int) -> str:
    """Return the process that is connected to a network device, as `name (pid)`; else empty."""
    with suppress(OSError, psutil.Error):
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        addresses = {address[4] for address in found}
        for one in psutil.net_connections("tcp"):
            if one.status == psutil.CONN_ESTABLISHED and one.pid and one.raddr in addresses:
                return _process_name(psutil.Process(one.pid))
    return ""


def _process_name(process: psutil.Process) -> str:
    title = " ".join(process.cmdline()).strip()  # a title that was set is padded
    return f"{title if title.startswith('cairn:') else process.name()} ({process.pid})"


def _access_remedy(path: Path) -> str:
    status = path.stat()
    user = getpass.getuser()
    try:
        group = grp.getgrgid(status.st_gid)
    except KeyError:
        return f"{_INSTALL_RULES}, and plug the device in again"
    if not status.st_mode & stat.S_IRGRP or group.gr_name == "root":
        return f"{_INSTALL_RULES}, and plug the device in again"
    if user in group.gr_mem and status.st_gid not in os.getgroups():
        return f"log out and in again: {user} joined group {group.gr_name} after this login"
    return f"sudo usermod -aG {group.gr_name} {user}, then log out and in again"


def _described_port(port: ListPortInfo) -> str:
    """Describe a port with its stable names, which do not depend on the order of plugging in."""
    name = _KNOWN.get((port.vid, port.pid)) or port.description
    serial = f":{port.serial_number}" if port.serial_number else ""
    names = [f"usb:{port.vid:04x}:{port.pid:04x}{serial}", *_links_to(port.device)]
    return f"{name}; stable names: {', '.join(names)}"


def _links_to(device: str) -> list[str]:
    folders = (folder for folder in _LINK_FOLDERS if folder.exists())
    links = [link for folder in folders for link in sorted(folder.iterdir())]
    return [str(link) for link in links if str(link.resolve()) == device]


def _described_camera(node: Path) -> str:
    name = _text(node / "name")
    device = (node / "device").resolve().parent
    if not (device / "idVendor").exists():
        return f"{name}; stable name: name:{name}"
    parts = [_text(device / part) for part in ("idVendor", "idProduct", "serial")]
    names = [f"usb:{':'.join(part for part in parts if part)}", f"port:{device.name}"]
    return f"{name}; stable names: {', '.join(names)}"


def _text(file: Path) -> str:
    return file.read_text(encoding="utf-8", errors="replace").strip() if file.exists() else ""
