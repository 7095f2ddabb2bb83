"""Fixtures of the guest's tests: serial devices on cables."""

from collections.abc import Iterator

import pytest

from tests.hardware.guest.cables import AcmCable, Cable, FtdiCable, plugged_in


@pytest.fixture(scope="session")
def _acm_device() -> AcmCable:
    cable = AcmCable()
    cable.make()
    return cable


@pytest.fixture
def acm(_acm_device: AcmCable) -> Iterator[Cable]:
    """A USB-CDC device, plugged in."""
    with plugged_in(_acm_device) as cable:
        yield cable


@pytest.fixture
def ftdi() -> Iterator[Cable]:
    """An RS-232 line behind an FTDI adapter, plugged in."""
    with plugged_in(FtdiCable()) as cable:
        yield cable
