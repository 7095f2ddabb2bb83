"""Drivers whose scans are wrong, under the contract of scans."""

from collections.abc import Iterator

import pytest

from cairn.testing.bench import Bench
from cairn.testing.scanner_contract import ScanContract
from tests.cairn.testing.broken import scanners
from tests.cairn.testing.broken.deploying import bench_of, contracts

DRIVERS = (
    scanners.SoundScanner,
    scanners.Millimetres,
    scanners.MillimetreLimits,
    scanners.Clockwise,
    scanners.Degrees,
    scanners.TooFar,
    scanners.StampedWhenSent,
    scanners.StampsJump,
    scanners.StampsOfAnotherClock,
    scanners.OtherFrame,
    scanners.EveryOther,
)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    folder = tmp_path_factory.mktemp("scans")
    for driver in DRIVERS:
        (folder / driver.__name__.lower()).touch()
    with bench_of(folder, DRIVERS, placement="in_process", parameters={"device": folder}) as bench:
        yield bench


globals().update(
    contracts(
        ScanContract,
        DRIVERS,
        rate_hz=scanners.RATE_HZ,
        surroundings=scanners.SURROUNDINGS,
        sample_count=12,
    )
)
