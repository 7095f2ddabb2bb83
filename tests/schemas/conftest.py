"""Settings of the tests of messages: `--mutations 100000` runs the whole mutation test."""

import pytest

from cairn.bus.codec import Codec

DEFAULT_MUTATIONS = 500
DEFAULT_INTERFACE_MUTATIONS = 100  # of hundreds of types


def pytest_addoption(parser: pytest.Parser) -> None:
    """`pytest tests/schemas --mutations 100000`: the option exists when this folder is given."""
    parser.addoption(
        "--mutations",
        type=int,
        default=None,
        help=f"Damaged buffers to decode for each message type: {DEFAULT_MUTATIONS}, or for types "
        f"without rules of their own {DEFAULT_INTERFACE_MUTATIONS}.",
    )


@pytest.fixture
def mutations(request: pytest.FixtureRequest) -> int:
    return request.config.getoption("--mutations", default=None) or DEFAULT_MUTATIONS


@pytest.fixture
def interface_mutations(request: pytest.FixtureRequest) -> int:
    return request.config.getoption("--mutations", default=None) or DEFAULT_INTERFACE_MUTATIONS


@pytest.fixture(scope="session")
def codec() -> Codec:
    return Codec()
