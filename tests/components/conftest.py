"""Fixture of the tests of components: a recording of the MRCLAM data set."""

from pathlib import Path

import pytest

DATASET = Path(__file__).parents[1] / "data" / "mrclam" / "MRCLAM_Dataset6"


@pytest.fixture(scope="session")
def dataset() -> Path:
    """Return the folder of the data set."""
    return DATASET
