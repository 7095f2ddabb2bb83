"""What goes wrong with devices while a driver talks with them."""

from cairn.errors import CairnError


class DeviceError(CairnError):
    """A device does not do what it should; a driver tells it, and begins anew with the device."""


class LinkLost(DeviceError):  # noqa: N818 - it tells what happened
    """The line to a device is gone, or could not be opened: unplugged, switched off, refused."""
