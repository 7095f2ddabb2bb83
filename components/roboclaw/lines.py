"""Opening the line to a RoboClaw by the name that its parameter gives."""

from __future__ import annotations

from cairn.driver.errors import LinkLost
from cairn.driver.link import Link, SerialLink, TcpLink

_TCP = "tcp:"


def open_line(port: str, baud: int) -> Link:
    """The serial port, or the serial device server for `tcp:HOST:PORT`; raises `LinkLost`."""
    if not port.startswith(_TCP):
        return SerialLink(port, baud)
    host, _, number = port.removeprefix(_TCP).rpartition(":")
    if not (host and number.isdecimal() and int(number) < 65536):
        raise LinkLost(f"{port} names no TCP port; write it as tcp:192.168.0.7:4001")
    return TcpLink(host, int(number))
