"""The base on an emulated RoboClaw keeps the contract of a base."""

from collections.abc import Iterator

import pytest

from cairn.testing.base_contract import BaseContract
from tests.components.roboclaw.emulated_base import DEPLOYMENT, EmulatedBase, emulated_base

pytestmark = pytest.mark.realtime


class TestRoboclawBase(BaseContract):
    deployment = DEPLOYMENT
    rate_hz = 40.0
    top_speed = 0.8
    turn = 1.0
    stop_limit_s = 2.5  # the controller's own time limit is 1 s
    cycles = 6

    @pytest.fixture(scope="class")
    @classmethod
    def device(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[EmulatedBase]:
        with emulated_base(tmp_path_factory.mktemp("line")) as base:
            yield base
