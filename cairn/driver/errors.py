"""Errors of devices while a driver talks with them."""

from cairn.errors import CairnError


class DeviceError(CairnError):
    """A device does not do what it should; its driver logs that and opens the device again."""


class LinkLost(DeviceError):
    """The line to a device is lost, or could not be opened: unplugged, switched off, refused."""
