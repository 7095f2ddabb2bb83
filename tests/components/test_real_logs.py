"""Localization on parts of real recordings, in maps of other parts of them."""

import math

import numpy as np
import pytest

from cairn.planar.grid import OccupancyCells
from cairn_lab.evaluation.results import SIGMA_LIMITS
from tests.components.corrected_logs import (
    LOGS,
    CorrectedLog,
    draw_map,
    drive,
    from_known_start,
    load_log,
    mapped_by_stretches,
    new_localizer,
)
from tests.sweeps import sampled

pytestmark = pytest.mark.slow


LogAndMap = tuple[CorrectedLog, OccupancyCells]
THREE_SIGMA = SIGMA_LIMITS[2]


def log_and_map(name: str) -> LogAndMap:
    log = load_log(LOGS[name])
    return log, draw_map(log, mapped_by_stretches(log))


@pytest.fixture(scope="module")
def fr079() -> LogAndMap:
    return log_and_map("fr079")


@pytest.fixture(scope="module")
def fr101() -> LogAndMap:
    return log_and_map("fr101")


@pytest.mark.accuracy
@pytest.mark.parametrize("seed", sampled(range(2)))
def test_wheel_slip_in_a_real_log_does_not_lose_the_robot(fr079: LogAndMap, seed: int) -> None:
    log, grid = fr079
    every = np.ones(len(log.scans), bool)

    outcome = from_known_start(log, grid, every, seed, 940.0, 1060.0)

    judged = ~mapped_by_stretches(log)[log.scan_at >= 940.0][: len(outcome.error)]
    assert np.median(outcome.error[judged]) < 0.1
    assert outcome.error.max() < 0.6
    assert np.mean(outcome.squares <= THREE_SIGMA) > 0.9


def test_scans_three_seconds_apart_keep_the_pose(fr101: LogAndMap) -> None:
    log, grid = fr101

    outcome = from_known_start(log, grid, np.ones(len(log.scans), bool), 0, 0.0, 400.0)

    assert np.median(outcome.error) < 0.1
    assert outcome.error.max() < 0.5


@pytest.mark.parametrize("begin_s", sampled([110.0, 350.0, 590.0, 790.0]))
def test_robot_is_found_in_an_office_building(fr101: LogAndMap, begin_s: float) -> None:
    log, grid = fr101
    robot = new_localizer(grid, 1)
    robot.advance(begin_s)

    every = np.ones(len(log.scans), bool)
    outcome = drive(robot, log, every, begin_s, begin_s + 90.0, until_located=True)

    assert not math.isnan(outcome.error[-1])
    assert outcome.error[-1] < 0.5
