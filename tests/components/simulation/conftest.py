"""Fixtures of the simulation's tests."""

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.components.simulation.simulation_harness import Simulation


@pytest.fixture
def simulate(tmp_path: Path) -> Callable[..., Simulation]:
    return lambda **more: Simulation(tmp_path, **more)
