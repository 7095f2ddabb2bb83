"""Serial ports by names that stay the same when devices are plugged in another order."""

from __future__ import annotations

import os
import re

from serial.tools import list_ports

from cairn.driver.errors import LinkLost

# RS-232 of all kinds; USB devices of class CDC (ttyACM) and pseudo-terminals have no speed.
_PACED = ("ttyUSB", "ttyS", "ttyAMA", "ttyO", "ttyTHS", "ttymxc")

_USB = re.compile(r"usb:([0-9a-fA-F]{4}):([0-9a-fA-F]{4})(?::(.+))?")


def find_port(port: str) -> str:
    """The path of the serial port that is called `port`.

    That is a path (`/dev/serial/by-id/...`, `/dev/ttyACM0`), returned as it is, or
    `usb:VENDOR:PRODUCT[:SERIAL]` with hexadecimal numbers, which is looked up among the ports that
    are there now: it stays true when a device comes back under another name, and needs no udev.

    Raises `LinkLost` if no such device, or more than one, is plugged in.
    """
    match = _USB.fullmatch(port)
    if match is None:
        return port
    vendor, product, number = int(match[1], 16), int(match[2], 16), match[3]
    found = [
        known
        for known in list_ports.comports()
        if (known.vid, known.pid) == (vendor, product) and number in (None, known.serial_number)
    ]
    if len(found) == 1:
        device: str = found[0].device
        return device
    if found:
        named = ", ".join(f"{known.device} ({known.serial_number})" for known in found)
        raise LinkLost(f"{port}: there are several: {named}; add the serial number to the name")
    raise LinkLost(f"{port}: no such device is plugged in; `cairn doctor` lists those that are")


def is_paced(device: str) -> bool:
    """Whether bytes take the time on a serial port's line that its speed gives them."""
    return os.path.basename(os.path.realpath(device)).startswith(_PACED)
