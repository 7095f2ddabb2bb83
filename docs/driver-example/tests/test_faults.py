"""What a contract cannot know: how this device's line may be disturbed."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from cairn.testing.bench import settings
from cairn.testing.robot import Robot
from schemas.diagnostic_msgs import DiagnosticArray
from schemas.sensor_msgs import LaserScan

from emulated import Lantern, plugged_in

DEPLOYMENT = Path(__file__).parents[1] / "deploy" / "lantern.yaml"


@pytest.fixture
def lantern(tmp_path: Path) -> Iterator[Lantern]:
    with plugged_in(tmp_path) as lantern:
        yield lantern


def test_damaged_lines_are_counted_and_never_published(
    lantern: Lantern, deploy: Callable[..., Robot]
) -> None:
    robot = deploy(DEPLOYMENT, *settings(lantern.settings))
    with robot.read("scan", LaserScan) as scans, robot.read("diagnostics", DiagnosticArray) as told:
        scans.await_count(3)
        lantern.emulation.spoil("bad_sum", 5)
        told.await_that(
            lambda arrivals: any(damaged(arrival.message) >= 5 for arrival in arrivals),
            "five damaged lines",
        )
        scans.await_count(3, after=scans.count)

    ranges = [reading for scan in scans.messages for reading in scan.ranges if reading < 10]
    assert min(ranges) > 0.98
    assert max(ranges) < 3.02


def test_a_device_that_hangs_is_told_and_comes_back(
    lantern: Lantern, deploy: Callable[..., Robot]
) -> None:
    robot = deploy(DEPLOYMENT, *settings(lantern.settings))
    with robot.read("scan", LaserScan) as scans:
        scans.await_count(3)
        lantern.emulation.hang()
        robot.run.await_line("no turn for 1 s")
        lantern.emulation.hang(0.0)
        scans.await_count(3, after=scans.count)


def damaged(message: DiagnosticArray) -> int:
    """How many damaged lines are told."""
    values = {entry.key: entry.value for entry in message.status[0].values}
    return int(values["damaged lines"])
