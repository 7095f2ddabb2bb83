"""What all tests may use: deployments in real processes, and the `cairn` command."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.launching import Launching, launching


@pytest.fixture
def launch(tmp_path: Path) -> Iterator[Launching]:
    """Starts deployments; nothing of them is left after the test."""
    with launching(tmp_path) as launch:
        yield launch
