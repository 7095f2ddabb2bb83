"""Fixtures of the tests of components: a recording of the MRCLAM data set, patience."""

from pathlib import Path

import pytest

from tests.patience import patient_devices

__all__ = ["patient_devices"]

DATASET = Path(__file__).parents[1] / "data" / "mrclam" / "MRCLAM_Dataset6"


@pytest.fixture(scope="session")
def dataset() -> Path:
    """Return the folder of the data set."""
    return DATASET
