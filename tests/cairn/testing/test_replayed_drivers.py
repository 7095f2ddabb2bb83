"""The replayed drivers fulfill the contracts, as far as a recording allows."""

import gzip
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cairn.testing.camera_contract import PicturesContract
from cairn.testing.driver_contract import LifeCycleContract, ParametersContract, StopContract
from cairn.testing.odometry_contract import OdometryContract
from cairn.testing.robot import Bench, settings
from cairn.testing.scanner_contract import ScanContract

LOG = Path(__file__).parents[3] / "deploy" / "recordings" / "fr079_corrected.log.gz"
PART = slice(4850, 9150)  # lines of the log: six minutes without long gaps between scans
APART_S = 0.3  # for a while the scanner of the log was read twice as often
PAIRS = 1500
PICTURES = 7

LOG_REPLAY = """
    clock: simulated
    settings: {recording: ""}
    components:
      base: {plugin: replay_odometry, parameters: {recording: "${recording}"}}
      scanner: {plugin: replay_scanner, parameters: {recording: "${recording}"}}
      replay_clock:
        plugin: replay_clock
        parameters: {recording: "${recording}", rate: 4.0, tick_s: 0.1}
        topics: {time: clock}
        restart: transient
        significant: true
    """
CAMERA_REPLAY = """
    clock: simulated
    settings: {recording: ""}
    components:
      camera: {plugin: replay_camera, parameters: {recording: "${recording}"}}
      replay_clock:
        plugin: replay_clock
        parameters: {recording: "${recording}", rate: 1.0}
        topics: {time: clock}
        restart: transient
        significant: true
    """


class Recorded:
    """Replayed at four times the recorded speed; the clock ticks every tenth of a second."""

    live = False
    early_s = 3.0
    oldest_s = 5.0
    jitter = 0.6
    return_limit_s = 30.0  # these tests run beside others
    rate_tolerance = 0.25


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    folder = tmp_path_factory.mktemp("log")
    part = folder / "part.log"
    part.write_text("".join(_steady_part()), encoding="ascii")
    with Bench(folder, LOG_REPLAY, settings({"recording": str(part)})) as bench:
        yield bench


def _steady_part() -> Iterator[str]:
    """Yield a part of the log in which scans have one rate, whichever of them a test receives."""
    with gzip.open(LOG, "rt", encoding="ascii") as log:
        lines = log.readlines()
    yield from (line for line in lines[: PART.start] if not line.startswith(("ODOM", "FLASER")))
    last_s = 0.0
    for line in lines[PART]:
        if line.startswith("FLASER"):
            stamp_s = float(line.split()[-3])
            if stamp_s - last_s < APART_S:
                continue
            last_s = stamp_s
        yield line


@pytest.mark.accuracy
class TestBase(Recorded, ParametersContract, OdometryContract):
    rate_hz = 8.43


class TestScanner(Recorded, StopContract, LifeCycleContract, ParametersContract, ScanContract):
    rate_hz = 2.3
    cycles = 6


@pytest.mark.accuracy
class TestCamera(StopContract, LifeCycleContract, ParametersContract, PicturesContract):
    rate_hz = 10.0
    calibrated = False
    early_s = 0.3
    return_limit_s = 30.0
    cycles = 6

    @pytest.fixture(scope="class")
    @classmethod
    def bench(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
        folder = tmp_path_factory.mktemp("images")
        generator = np.random.default_rng(1)
        for side in ("left", "right"):
            (folder / side).mkdir()
            taken: list[Path] = []
            for number in range(PAIRS):
                file = folder / side / f"{1_700_000_000_000_000_000 + number * 100_000_000}.png"
                if number < PICTURES:
                    Image.fromarray(generator.integers(0, 255, (24, 32), np.uint8)).save(file)
                else:
                    file.hardlink_to(taken[number % PICTURES])
                taken.append(file)
        words = settings({"recording": str(folder)})
        with Bench(tmp_path_factory.mktemp("camera"), CAMERA_REPLAY, words) as bench:
            yield bench
