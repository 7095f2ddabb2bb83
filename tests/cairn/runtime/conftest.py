"""Fixtures of the tests of components."""

import pytest

from tests.cairn.runtime.running import Lockstep


@pytest.fixture
def lockstep() -> Lockstep:
    return Lockstep()
