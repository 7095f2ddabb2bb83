"""Serial ports, what may be behind them, and programs that disturb them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import psutil
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from cairn.cli.doctor.access import access
from cairn.cli.doctor.finding import Finding

_TOPIC = "serial ports"
_KNOWN = {
    (0x15D1, 0x0000): "Hokuyo range scanner",
    (0x03EB, 0x2404): "RoboClaw motor controller",
    (0x0403, 0x6001): "FTDI RS-232 adapter",
    (0x0403, 0x6015): "FTDI RS-232 adapter",
    (0x067B, 0x2303): "Prolific RS-232 adapter",
    (0x10C4, 0xEA60): "Silicon Labs RS-232 adapter",
    (0x1A86, 0x7523): "CH340 RS-232 adapter",
}
_BY_ID = Path("/dev/serial/by-id")
_MEDDLERS = {
    "ModemManager": "talks to every serial port that is plugged in, as if to a modem",
    "brltty": "takes serial adapters for Braille displays",
}


def serial_ports() -> Iterator[Finding]:
    """All serial ports of USB devices, and who meddles with such."""
    ports = [port for port in list_ports.comports() if port.vid is not None]
    for port in ports:
        yield access(_TOPIC, Path(port.device), _described(port))
    if not ports:
        yield Finding(_TOPIC, "USB", "ok", "no serial device is plugged in")
    running = {process.info["name"]: process.pid for process in psutil.process_iter(["name"])}
    for name, what in _MEDDLERS.items():
        if name in running:
            rules = "install Cairn's udev rules (docs/robot.md)"
            remedy = f"{rules}, or: sudo systemctl disable --now {name}"
            found = f"runs ({running[name]}), and {what}"
            yield Finding(_TOPIC, name, "warn", found, remedy)


def _described(port: ListPortInfo) -> str:
    """What it is, and its names that stay when others are plugged in before it."""
    name = _KNOWN.get((port.vid, port.pid)) or port.description
    serial = f":{port.serial_number}" if port.serial_number else ""
    names = [f"usb:{port.vid:04x}:{port.pid:04x}{serial}", *_links(port.device)]
    return f"{name}; stable names: {', '.join(names)}"


def _links(device: str) -> list[str]:
    folders = (_BY_ID, Path("/dev/cairn"))
    links = [link for folder in folders if folder.exists() for link in sorted(folder.iterdir())]
    return [str(link) for link in links if str(link.resolve()) == device]
