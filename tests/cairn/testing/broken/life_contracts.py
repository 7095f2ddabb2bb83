"""Drivers that misbehave when they are started, stopped, unplugged or set."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from cairn.testing.bench import Bench
from cairn.testing.driver_contract import Contract, LifeCycleContract, ParametersContract
from cairn.testing.end_contract import StopContract, UnplugContract
from schemas.sensor_msgs import LaserScan
from tests.cairn.testing.broken import scanners
from tests.cairn.testing.broken.deploying import bench_of, contracts

LIVES = (
    scanners.SoundScanner,
    scanners.NeverSilent,
    scanners.LeaksThreads,
    scanners.LeaksFiles,
    scanners.LeaksMemory,
)
ENDS = (scanners.HangsAtItsEnd,)
LINES = (
    scanners.Unbounded,
    scanners.DiesUnplugged,
    scanners.SilentUnplugged,
    scanners.RepeatsUnplugged,
    scanners.NeverReturns,
)
DRIVERS = (*LIVES, *ENDS, *LINES)


@dataclass(frozen=True)
class Plug:
    """A device that is there while its file is."""

    file: Path

    def unplug(self) -> None:
        self.file.unlink(missing_ok=True)

    def plug_in(self) -> None:
        self.file.touch()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("life")


@pytest.fixture(scope="module")
def bench(folder: Path) -> Iterator[Bench]:
    with bench_of(folder, DRIVERS, placement="process", parameters={"device": folder}) as bench:
        yield bench


@pytest.fixture(scope="class")
def device(request: pytest.FixtureRequest, folder: Path) -> Plug:
    return Plug(folder / request.cls.component)


@pytest.fixture(scope="module", autouse=True)
def plugged(folder: Path) -> None:
    for driver in DRIVERS:
        Plug(folder / driver.__name__.lower()).plug_in()


class Settings(Contract):
    port = "scan"
    message = LaserScan
    rate_hz = scanners.RATE_HZ
    cycles = 6
    return_limit_s = 4.0
    tell_limit_s = 1.5


class Lives(Settings, StopContract, LifeCycleContract):
    """Starting and stopping."""


class Ends(Settings, StopContract):
    """Stopping alone."""


class Lines(Settings, UnplugContract, ParametersContract):
    """Unplugging; and parameters."""


globals().update(contracts(Lives, LIVES))
globals().update(contracts(Ends, ENDS))
globals().update(contracts(Lines, LINES))
