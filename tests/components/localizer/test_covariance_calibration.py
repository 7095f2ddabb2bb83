"""The published covariance: scaled by past corrections, with the error of the map."""

import math

import numpy as np
import pytest

from cairn.components.localizer.covariance_calibration import CovarianceCalibrator
from cairn.components.localizer.particle_set import PoseEstimate
from cairn_lab.evaluation.results import SIGMA_LIMITS
from tests.components.localizer.random_floor import START, floor, new_robot, wander

CELL_M = 0.05
EXACT_M = 0.027  # what exact beams deviate from a map of such cells


def estimate_with(deviation: float, x: float = 0.0) -> PoseEstimate:
    return PoseEstimate((x, 0.0, 0.0), np.diag([deviation**2, deviation**2, deviation**2]))


def after_corrections(of: float) -> CovarianceCalibrator:
    """Return a calibrator after scans that shrink a particle set from 0.05 to 0.03 m."""
    stated = CovarianceCalibrator()
    for k in range(200):
        stated.add_correction(estimate_with(0.05), estimate_with(0.03, of * (-1) ** k), 1.0)
    return stated


def deviation(stated: CovarianceCalibrator) -> float:
    return math.sqrt(stated.calibrated(estimate_with(0.03), CELL_M)[0, 0])


def test_consistent_filter_publishes_its_own_covariance() -> None:
    expected = math.sqrt(0.05**2 - 0.03**2)

    assert deviation(after_corrections(expected)) == pytest.approx(0.03, rel=0.05)


def test_corrections_smaller_than_expected_make_the_stated_covariance_narrower() -> None:
    assert deviation(after_corrections(0.01)) < 0.015


def test_corrections_larger_than_expected_make_it_wider_within_limits() -> None:
    assert 0.05 < deviation(after_corrections(0.12)) < deviation(after_corrections(5.0)) < 0.1


def test_scans_of_a_standing_robot_change_the_calibration_little() -> None:
    expected = math.sqrt(0.05**2 - 0.03**2)
    still, moving = after_corrections(expected), after_corrections(expected)
    for _ in range(20):
        still.add_correction(estimate_with(0.05), estimate_with(0.03), 0.03)
        moving.add_correction(estimate_with(0.05), estimate_with(0.03), 1.0)

    assert deviation(still) == pytest.approx(0.03, rel=0.05)
    assert deviation(moving) < 0.022


def test_corrections_across_a_corridor_do_not_scale_along_it() -> None:
    stated = CovarianceCalibrator()
    before, after = np.diag([0.3**2, 0.05**2, 0.01]), np.diag([0.3**2, 0.01**2, 0.01])
    for k in range(200):
        y = 0.005 * (-1) ** k
        stated.add_correction(PoseEstimate((0, 0, 0), before), PoseEstimate((0, y, 0), after), 1.0)

    covariance = stated.calibrated(PoseEstimate((0.0, 0.0, 0.0), after), CELL_M)

    assert math.sqrt(covariance[0, 0]) == pytest.approx(0.3, rel=0.02)
    assert math.sqrt(covariance[1, 1]) < 0.01


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_steady_corrections_add_a_lag(turn: float) -> None:
    stated = CovarianceCalibrator()
    before, after = np.diag([0.02**2] * 3), np.diag([0.018**2] * 3)
    for _ in range(200):  # a fifth of what is missing is made up for each time
        x, y = 0.004 * math.cos(turn), 0.004 * math.sin(turn)
        stated.add_correction(PoseEstimate((0, 0, 0), before), PoseEstimate((x, y, 0), after), 1.0)

    covariance = stated.calibrated(PoseEstimate((0.0, 0.0, 0.0), after), CELL_M)

    ahead, left = np.array([math.cos(turn), math.sin(turn)]), [-math.sin(turn), math.cos(turn)]
    assert math.sqrt(ahead @ covariance[:2, :2] @ ahead) == pytest.approx(0.02, rel=0.2)
    assert math.sqrt(left @ covariance[:2, :2] @ left) < 0.01


def test_deviation_beyond_the_cells_is_the_error_of_the_map() -> None:
    exact, crooked = CovarianceCalibrator(), CovarianceCalibrator()
    exact.add_deviation(EXACT_M, CELL_M)
    crooked.add_deviation(math.hypot(EXACT_M, 0.04), CELL_M)

    assert deviation(exact) == pytest.approx(math.hypot(0.03, CELL_M / 8), rel=0.01)
    assert deviation(crooked) == pytest.approx(math.hypot(0.03, CELL_M / 8, 0.04), rel=0.01)


def test_scan_without_deviation_changes_nothing() -> None:
    stated = CovarianceCalibrator()
    before = deviation(stated)

    stated.add_deviation(math.nan, CELL_M)

    assert deviation(stated) == before


@pytest.mark.accuracy
def test_truth_lies_within_the_stated_sigmas_as_often_as_it_should() -> None:
    squares: list[float] = []
    for seed in (7, 8, 9):
        grid = floor(9.0, 4, seed)
        robot = new_robot(grid, seed)
        robot.set_pose(START, np.diag([0.05**2, 0.05**2, 0.03**2]))
        errors, covariances, _ = wander(robot, grid, START, 30.0, seed)
        pairs = zip(errors[20:, :2], covariances[20:, :2, :2], strict=True)
        squares += [error @ np.linalg.solve(covariance, error) for error, covariance in pairs]

    one, two, three = (float(np.mean(np.array(squares) <= limit)) for limit in SIGMA_LIMITS)
    assert 0.5 < one < 0.95  # 0.93: the covariance is a little too wide here
    assert two > 0.9
    assert three > 0.98
