"""Settings of the tests of messages: `--mutations 100000` runs the whole mutation test."""

import pytest

from cairn.bus.codec import Codec

DEFAULT_MUTATIONS = 500


def pytest_addoption(parser: pytest.Parser) -> None:
    """`pytest tests/schemas --mutations 100000`: the option exists when this folder is given."""
    parser.addoption(
        "--mutations",
        type=int,
        default=DEFAULT_MUTATIONS,
        help="Damaged buffers to decode for each message type.",
    )


@pytest.fixture
def mutations(request: pytest.FixtureRequest) -> int:
    return int(request.config.getoption("--mutations", default=DEFAULT_MUTATIONS))


@pytest.fixture(scope="session")
def codec() -> Codec:
    return Codec()
