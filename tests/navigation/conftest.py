"""The simulated robot of `deploy/sim.yaml`, whole, on virtual time."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.navigation.driving import LockstepRobot


@pytest.fixture
def drive(tmp_path: Path) -> Iterator[Callable[..., LockstepRobot]]:
    """Makes a deployment with these `--set`s; it is stopped after the test."""
    drives: list[LockstepRobot] = []

    def make(*sets: str, seed: int = 1) -> LockstepRobot:
        drives.append(LockstepRobot(tmp_path, *sets, seed=seed))
        return drives[-1]

    yield make
    for one in drives:
        one.shutdown()
