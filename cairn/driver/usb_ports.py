"""Serial ports named by USB numbers, whatever paths they have when they are plugged in again."""

import re

from serial.tools import list_ports

from cairn.driver.errors import LinkLost

_USB = re.compile(r"usb:([0-9a-fA-F]{4}):([0-9a-fA-F]{4})(?::(.+))?")


def find_port(port: str) -> str:
    """Return the path of the serial port named `port`.

    The name is a path (`/dev/serial/by-id/...`, `/dev/ttyACM0`), which is returned as it is, or
    `usb:VENDOR:PRODUCT[:SERIAL]` with hexadecimal numbers, which is searched among the ports that
    are present now: it stays valid when a device comes back under another path, and needs no udev.

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
        raise LinkLost(
            f"{port}: several such devices are plugged in: {named}; add the serial number to the "
            "name"
        )
    raise LinkLost(f"{port}: no such device is plugged in; `cairn doctor` lists those that are")
