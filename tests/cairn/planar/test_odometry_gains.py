"""The gains of odometry are estimated from the motion that scans show."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from cairn.planar.motion_model import MEASURED, OdometryStep, move_pose
from cairn.planar.odometry_gains import AS_CONFIGURED, GainEstimator, shows_position
from cairn.planar.poses import Pose, compose, relative

_STEP_M, _POSE_SD_M, _POSE_SD_RAD = 0.05, 0.01, 0.003


def drive(
    gains: GainEstimator,
    meters: float,
    forward: float = 1.0,
    turn: float = 1.0,
    veer: float = 0.0,
    seed: int = 0,
    shown: bool = True,
    offset: Pose = (0.0, 0.0, 0.0),
) -> None:
    """Drive curves; the robot moves by these gains of what odometry states.

    The pose of each scan is the true one with noise, and `offset` in the robot's frame.
    """
    random = np.random.default_rng(seed)
    true: Pose = (0.0, 0.0, 0.0)
    for k in range(round(meters / _STEP_M)):
        stated = OdometryStep(_STEP_M, 0.0, 0.1 * math.sin(k / 15), 0.1)
        moved = OdometryStep(forward * _STEP_M, 0.0, turn * stated.turned + veer * _STEP_M, 0.1)
        true = move_pose(true, moved)
        noise = random.standard_normal(3) * (_POSE_SD_M, _POSE_SD_M, _POSE_SD_RAD)
        x, y, theta = (value + error for value, error in zip(true, noise, strict=True))
        gains.move(stated)
        gains.add(compose((x, y, theta), offset), shown=shown)


@settings(max_examples=20)
@given(
    forward=st.floats(0.9, 1.1),
    turn=st.floats(0.9, 1.1),
    veer=st.floats(-0.02, 0.02),
    seed=st.integers(0, 100),
)
def test_gains_of_odometry_are_found(forward: float, turn: float, veer: float, seed: int) -> None:
    gains = GainEstimator(MEASURED, AS_CONFIGURED)
    drive(gains, 60.0, forward, turn, veer, seed)
    assert gains.forward[0] == pytest.approx(forward, abs=0.006)
    assert gains.turn == pytest.approx((turn, veer), abs=0.02)
    errors = np.abs((*gains.forward - forward, *gains.turn - (turn, veer)))
    assert (errors < 4 * np.array(gains.deviations)).all()


def test_step_is_corrected_by_the_gains() -> None:
    gains = GainEstimator(MEASURED, AS_CONFIGURED)
    drive(gains, 60.0, forward=0.95, turn=1.05)
    step = gains.corrected(OdometryStep(1.0, 0.0, 1.0, 2.0))
    assert step.ahead == pytest.approx(0.95, abs=0.01)
    assert step.turned == pytest.approx(1.05, abs=0.02)
    assert step.moving_s == 2.0


def test_pose_that_lags_behind_leaves_the_gains_as_they_are() -> None:
    gains = GainEstimator(MEASURED, AS_CONFIGURED)
    drive(gains, 60.0, offset=(-0.05, 0.02, 0.0))
    assert gains.forward[0] == pytest.approx(1.0, abs=0.01)
    assert gains.turn == pytest.approx((1.0, 0.0), abs=0.01)


def test_way_that_no_scan_shows_says_nothing() -> None:
    gains = GainEstimator(MEASURED, AS_CONFIGURED)
    drive(gains, 60.0, forward=0.9, shown=False)
    assert (gains.forward.tolist(), gains.turn.tolist()) == ([1.0], [1.0, 0.0])


def test_way_is_uncertain_in_proportion_as_long_as_no_scan_shows_the_position() -> None:
    gains = GainEstimator(MEASURED, AS_CONFIGURED)
    forward_sd, _, _ = gains.deviations
    gains.add((0.0, 0.0, 0.0), shown=True)
    steps = [gains.move(OdometryStep(_STEP_M, 0.0, 0.0, 0.1)) for _ in range(200)]
    assert math.hypot(*(step.gain_m for step in steps)) == pytest.approx(200 * _STEP_M * forward_sd)

    gains.add((10.0, 0.0, 0.0), shown=True)
    step = gains.move(OdometryStep(_STEP_M, 0.0, 0.0, 0.1))
    assert step.gain_m == pytest.approx(_STEP_M * gains.deviations[0])


def test_pose_that_was_found_anew_is_as_uncertain_as_it_says() -> None:
    gains = GainEstimator(MEASURED, AS_CONFIGURED)
    gains.add((0.0, 0.0, 0.0), shown=False)
    for _ in range(200):
        gains.move(OdometryStep(_STEP_M, 0.0, 0.0, 0.1))
    gains.interrupt()
    step = gains.move(OdometryStep(_STEP_M, 0.0, 0.0, 0.1))
    assert step.gain_m == pytest.approx(_STEP_M * gains.deviations[0])


def test_position_at_both_ends_of_a_hidden_way_shows_the_gain() -> None:
    gains = GainEstimator(MEASURED, AS_CONFIGURED)
    gains.add((0.0, 0.0, 0.0), shown=True)
    for k in range(1, 251):
        gains.move(OdometryStep(_STEP_M, 0.0, 0.0, 0.1))
        # What the pose is in between follows from odometry, and shows nothing.
        gains.add((0.9 * 12.5 if k == 250 else k * _STEP_M, 0.0, 0.0), shown=k == 250)
    assert gains.forward[0] == pytest.approx(0.9, abs=0.01)


def test_end_of_a_way_shows_nothing_if_the_map_is_made_of_the_scans() -> None:
    gains = GainEstimator(MEASURED, AS_CONFIGURED)
    for k in range(251):
        is_shown = k % 250 == 0
        if not is_shown:
            gains.conclude()
        gains.add((0.9 * k * _STEP_M, 0.0, 0.0), shown=is_shown)
        gains.move(OdometryStep(_STEP_M, 0.0, 0.0, 0.1))
    assert gains.forward[0] == 1.0


@pytest.mark.parametrize(("walls", "is_shown"), [("across and along", True), ("along", False)])
def test_wall_along_the_way_does_not_show_how_far(walls: str, is_shown: bool) -> None:
    def log_likelihood(poses: NDArray[np.float64]) -> NDArray[np.float64]:
        far = poses[0] ** 2 if walls == "across and along" else 0.0
        total: NDArray[np.float64] = far + poses[1] ** 2 + poses[2] ** 2
        return -0.5 * total / 0.02**2

    assert shows_position(log_likelihood, (0.0, 0.0, 0.0)) == is_shown


def test_slip_is_not_taken_for_a_gain() -> None:
    gains = GainEstimator(MEASURED, AS_CONFIGURED)
    drive(gains, 30.0)
    before = gains.forward.copy()
    # The robot is held for two meters of odometry.
    held: Pose = (0.0, 0.0, 0.0)
    gains.interrupt()
    for _ in range(41):
        gains.move(OdometryStep(_STEP_M, 0.0, 0.0, 0.1))
        gains.add(held, shown=True)
    gains.conclude()
    assert gains.forward.tolist() == before.tolist()


def test_jump_of_the_pose_is_no_motion() -> None:
    gains = GainEstimator(MEASURED, AS_CONFIGURED)
    pose: Pose = (0.0, 0.0, 0.0)
    for k in range(400):
        if k % 40 == 39:
            gains.interrupt()
            pose = compose(pose, (0.4, 0.0, 0.0))
        pose = compose(pose, (_STEP_M, 0.0, 0.0))
        gains.move(OdometryStep(_STEP_M, 0.0, 0.0, 0.1))
        gains.add(pose, shown=True)
    assert gains.forward[0] == pytest.approx(1.0, abs=0.001)
    assert relative((0.0, 0.0, 0.0), pose)[0] > 20.0
