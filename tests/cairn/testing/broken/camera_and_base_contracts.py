"""Cameras whose pairs, and bases whose drives are wrong, under the contracts of these."""

from collections.abc import Iterator

import pytest

from cairn.testing.base_contract import DriveContract, SafetyContract
from cairn.testing.bench import Bench
from cairn.testing.camera_contract import PicturesContract
from tests.cairn.testing.broken import bases, cameras
from tests.cairn.testing.broken.deploying import bench_of, contracts

CAMERAS = (
    cameras.SoundCamera,
    cameras.StampsDiffer,
    cameras.SwappedSides,
    cameras.SwappedSizes,
    cameras.Frozen,
    cameras.WrongEncoding,
    cameras.InfosLate,
)
DRIVEN = (bases.RightIsLeft, bases.TwistInDegrees, bases.TransformLags)
BASES = (bases.SoundBase, bases.NeverStops, bases.Unlimited)


class ShortDrives(DriveContract):
    rate_hz = bases.RATE_HZ
    top_speed = bases.TOP_SPEED
    stop_limit_s = 1.0
    drive_s = 0.6
    return_limit_s = 3.0


class ShortSafety(ShortDrives, SafetyContract):
    """Stopping in time as well."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    folder = tmp_path_factory.mktemp("cameras_and_bases")
    with bench_of(folder, (*CAMERAS, *DRIVEN, *BASES), placement="in_process") as bench:
        yield bench


globals().update(contracts(PicturesContract, CAMERAS, rate_hz=cameras.RATE_HZ, sample_count=8))
globals().update(contracts(ShortDrives, DRIVEN))
globals().update(contracts(ShortSafety, BASES))
