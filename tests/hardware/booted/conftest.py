"""The same cables as the guest's other tests have."""

from tests.hardware.guest.conftest import _acm_device, acm

__all__ = ["_acm_device", "acm"]
