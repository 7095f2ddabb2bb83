"""Drivers that misbehave when started, stopped, unplugged, configured, or driven too fast."""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from cairn.schemas.sensor_msgs import LaserScan
from cairn.testing.base_contract import SafetyContract
from cairn.testing.driver_contract import (
    LifeCycleContract,
    ParametersContract,
    StopContract,
    UnplugContract,
)
from cairn.testing.robot import Bench
from tests.cairn.testing.broken import bases, scanners
from tests.cairn.testing.broken.deploying import bench_of, contracts, name_of
from tests.patience import LIMIT_S

SCANNERS = (
    scanners.NeverSilent,
    scanners.KeepsItsPort,
    scanners.Leaks,
    scanners.Unbounded,
    scanners.HangsAtItsEnd,
    scanners.DiesUnplugged,
    scanners.SilentUnplugged,
    scanners.RepeatsUnplugged,
    scanners.NeverReturns,
)
ALONE = (scanners.Leaks, scanners.HangsAtItsEnd, scanners.DiesUnplugged)
HANGING = (scanners.HangsAtItsEnd,)


@dataclass(frozen=True)
class Plug:
    """A device that exists while its file exists."""

    file: Path

    def unplug(self) -> None:
        """Wait until the driver has noticed it: one that has not would work when it is back."""
        self.file.unlink(missing_ok=True)
        deadline = time.monotonic() + LIMIT_S
        while not scanners.loss_of(self.file).exists():
            assert time.monotonic() < deadline, f"no driver notices that {self.file} is gone"
            time.sleep(0.005)

    def plug_in(self) -> None:
        scanners.loss_of(self.file).unlink(missing_ok=True)
        self.file.touch()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("life")


@pytest.fixture(scope="module")
def bench(folder: Path) -> Iterator[Bench]:
    for driver in SCANNERS:
        Plug(folder / name_of(driver)).plug_in()
    with bench_of(folder, (*SCANNERS, bases.Unlimited), ALONE, HANGING) as bench:
        yield bench


@pytest.fixture(scope="class")
def device(request: pytest.FixtureRequest, folder: Path) -> Plug:
    return Plug(folder / request.cls.component)


class Scanner(StopContract, UnplugContract, LifeCycleContract, ParametersContract):
    port = "scan"
    message = LaserScan
    rate_hz = scanners.RATE_HZ
    return_limit_s = 30.0
    report_limit_s = 30.0


class Base(SafetyContract):
    rate_hz = bases.RATE_HZ
    top_speed = bases.TOP_SPEED
    drive_s = 2.0  # more than a pause of the driver, which would make up for it at its old speed


# Each fails one test by a time limit, which is therefore short.
LIMITS = {
    scanners.SilentUnplugged: {"report_limit_s": 3.0},
    scanners.NeverReturns: {"return_limit_s": 4.0},
}
for scanner in SCANNERS:
    globals().update(contracts(Scanner, (scanner,), **LIMITS.get(scanner, {})))
globals().update(contracts(Base, (bases.Unlimited,), return_limit_s=30.0))
