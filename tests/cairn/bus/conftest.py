"""A network of Zenoh sessions for each test that requests one."""

from collections.abc import Iterator

import pytest

from tests.cairn.bus.network import Network


@pytest.fixture
def network() -> Iterator[Network]:
    network = Network()
    try:
        yield network
    finally:
        network.close()
