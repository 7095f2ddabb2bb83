"""The drivers of real scanners fulfill the contract on emulated ones, all in one deployment.

Scans are judged in real time, so these tests must not run beside those that compute much.
"""

import math
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path

import pytest

from cairn.components.hokuyo_scanner.emulator import EmulatedScip
from cairn.components.pbs_scanner.emulator import EmulatedPbs
from cairn.driver.emulator import EmulatedDevice, Emulator
from cairn.driver.emulator_lines import PtyEnd
from cairn.schemas.sensor_msgs import LaserScan
from cairn.testing.driver_contract import (
    EndContract,
    LifeCycleContract,
    ParametersContract,
    StopContract,
    UnplugContract,
)
from cairn.testing.robot import Bench, settings
from cairn.testing.scanner_contract import RangeScannerContract, ScanContract

DEPLOYMENT = """
    settings: {utm: "", pbs: ""}
    components:
      utm: {plugin: hokuyo_scanner, parameters: {port: "${utm}"}}
      pbs: {plugin: pbs_scanner, parameters: {port: "${pbs}"}, topics: {scan: pbs_scan}}
    """


@pytest.fixture(scope="module")
def lines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Mapping[str, Emulator]]:
    """The emulated scanners by the names of their drivers."""
    folder = lines_of(tmp_path_factory)
    devices: dict[str, EmulatedDevice] = {"utm": EmulatedScip("UTM-30LX"), "pbs": EmulatedPbs()}
    with ExitStack() as stack:
        yield {
            name: stack.enter_context(Emulator(device, PtyEnd(folder / name)))
            for name, device in devices.items()
        }


@pytest.fixture(scope="module")
def bench(
    lines: Mapping[str, Emulator], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Bench]:
    folder = lines_of(tmp_path_factory)
    words = settings({name: str(folder / name) for name in lines})
    with Bench(tmp_path_factory.mktemp("emulated"), DEPLOYMENT, words) as bench:
        yield bench


@pytest.fixture(scope="class")
def device(request: pytest.FixtureRequest, lines: Mapping[str, Emulator]) -> Emulator:
    return lines[request.cls.component]


def lines_of(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with the pseudo-terminals of the emulators."""
    folder = tmp_path_factory.getbasetemp() / "lines"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.mark.accuracy
@pytest.mark.realtime
class TestPbsScans(ScanContract):
    component = "pbs"
    rate_hz = 10.0
    surroundings = {math.radians(90.0): 1.9}


@pytest.mark.accuracy
@pytest.mark.realtime
class TestUtmScans(ScanContract):
    component = "utm"
    rate_hz = 40.0
    # Of the emulated room: while the sample is taken, the person walking in it hides none of these.
    surroundings = {0.0: 4.0, math.radians(30.0): 4.4, math.radians(-90.0): 1.8}
    sample_count = 80


class Life(StopContract, UnplugContract, LifeCycleContract, ParametersContract):
    """What is not judged by the clock, with limits that suit a computer with other work."""

    port, message = "scan", LaserScan
    return_limit_s = 30.0
    report_limit_s = 30.0
    cycles = 6


@pytest.mark.accuracy
class TestPbsLife(Life):
    component = "pbs"
    rate_hz = 10.0


class TestUtmLife(EndContract, Life):
    component = "utm"
    rate_hz = 40.0
    live_parameters = {"skip": 1, "cluster": 2}


def test_both_classes_together_run_the_whole_contract() -> None:
    run = {name for one in (TestUtmLife, TestUtmScans) for name in dir(one)}

    assert {name for name in dir(RangeScannerContract) if name.startswith("test_")} <= run
