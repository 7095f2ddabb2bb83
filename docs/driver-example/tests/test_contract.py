"""The driver keeps the contract of a range scanner."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from cairn.testing.scanner_contract import RangeScannerContract

from emulated import SURROUNDINGS, Lantern, plugged_in


class TestLantern(RangeScannerContract):
    deployment = Path(__file__).parents[1] / "deploy" / "lantern.yaml"
    rate_hz = 20.0
    surroundings = SURROUNDINGS
    live_parameters = {"farthest": 2.5}

    @pytest.fixture(scope="class")
    @classmethod
    def device(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lantern]:
        with plugged_in(tmp_path_factory.mktemp("line")) as lantern:
            yield lantern
