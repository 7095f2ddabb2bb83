"""The driver keeps the contract of a range scanner, and rules particular to this device."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from cairn.schemas.diagnostic_msgs import DiagnosticArray
from cairn.schemas.sensor_msgs import LaserScan
from cairn.testing.robot import Reading, RunningDeployment
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

    def test_damaged_lines_are_counted_and_never_published(
        self, device: Lantern, robot: RunningDeployment, output: Reading[LaserScan]
    ) -> None:
        output.await_count(3)
        with robot.read("diagnostics", DiagnosticArray) as diagnostics:
            before = damaged(diagnostics.await_count(1)[0].message)
            device.emulator.inject("bad_sum", 5)
            diagnostics.await_that(
                lambda arrivals: any(damaged(one.message) >= before + 5 for one in arrivals),
                "five damaged lines more",
            )
        output.await_count(3, after=output.count)

        ranges = [reading for scan in output.messages for reading in scan.ranges if reading < 10]
        assert min(ranges) > 0.98
        assert max(ranges) < 3.02

    def test_a_hanging_device_is_reported_and_returns(
        self, device: Lantern, robot: RunningDeployment, output: Reading[LaserScan]
    ) -> None:
        output.await_count(3)
        mark = len(robot.run.lines)
        device.emulator.hang()
        robot.run.await_line("no turn for 1 s", after=mark)
        device.emulator.hang(0.0)
        output.await_count(3, after=output.count)


def damaged(message: DiagnosticArray) -> int:
    """Return the count of damaged lines."""
    values = {entry.key: entry.value for entry in message.status[0].values}
    return int(values["damaged lines"])
