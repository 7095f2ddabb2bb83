"""What the tests of components share."""

import pytest

from tests.cairn.runtime.running import Lockstep


@pytest.fixture
def lockstep() -> Lockstep:
    return Lockstep()
