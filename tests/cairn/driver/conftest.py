"""Fixture of the tests of drivers: patience."""

from tests.patience import patient_devices

__all__ = ["patient_devices"]
