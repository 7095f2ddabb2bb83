"""The gains of odometry are estimated from the motion that scans show."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cairn.planar.motion_model import MEASURED, OdometryStep, move_pose, odometry_step
from cairn.planar.odometry_gains import GainEstimator
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
        gains.add(stated, compose((x, y, theta), offset), shown)


@settings(max_examples=20)
@given(
    forward=st.floats(0.9, 1.1),
    turn=st.floats(0.9, 1.1),
    veer=st.floats(-0.02, 0.02),
    seed=st.integers(0, 100),
)
def test_gains_of_odometry_are_found(forward: float, turn: float, veer: float, seed: int) -> None:
    gains = GainEstimator(MEASURED)
    drive(gains, 60.0, forward, turn, veer, seed)
    assert gains.forward[0] == pytest.approx(forward, abs=0.006)
    assert gains.turn == pytest.approx((turn, veer), abs=0.02)
    errors = np.abs((*gains.forward - forward, *gains.turn - (turn, veer)))
    assert (errors < 4 * np.array(gains.deviations)).all()


def test_step_is_corrected_by_the_gains() -> None:
    gains = GainEstimator(MEASURED)
    drive(gains, 60.0, forward=0.95, turn=1.05)
    step = gains.corrected(OdometryStep(1.0, 0.0, 1.0, 2.0))
    assert step.ahead == pytest.approx(0.95, abs=0.01)
    assert step.turned == pytest.approx(1.05, abs=0.02)
    assert step.moving_s == 2.0


def test_pose_that_lags_behind_leaves_the_gains_as_they_are() -> None:
    gains = GainEstimator(MEASURED)
    drive(gains, 60.0, offset=(-0.05, 0.02, 0.0))
    assert gains.forward[0] == pytest.approx(1.0, abs=0.01)
    assert gains.turn == pytest.approx((1.0, 0.0), abs=0.01)


def test_way_that_no_scan_shows_says_nothing() -> None:
    gains = GainEstimator(MEASURED)
    drive(gains, 60.0, forward=0.9, shown=False)
    assert (gains.forward.tolist(), gains.turn.tolist()) == ([1.0], [1.0, 0.0])
    assert gains.corrected(odometry_step((0.1, 0.0, 0.1))) == odometry_step((0.1, 0.0, 0.1))


def test_slip_is_not_taken_for_a_gain() -> None:
    gains = GainEstimator(MEASURED)
    drive(gains, 30.0)
    before = gains.forward.copy()
    # The robot is held for two meters of odometry.
    held: Pose = (0.0, 0.0, 0.0)
    gains.interrupt()
    for _ in range(41):
        gains.add(OdometryStep(_STEP_M, 0.0, 0.0, 0.1), held, shown=True)
    gains.add(OdometryStep(_STEP_M, 0.0, 0.0, 0.1), held, shown=False)
    assert gains.forward.tolist() == before.tolist()


def test_jump_of_the_pose_is_no_motion() -> None:
    gains = GainEstimator(MEASURED)
    pose: Pose = (0.0, 0.0, 0.0)
    for k in range(400):
        if k % 40 == 39:
            gains.interrupt()
            pose = compose(pose, (0.4, 0.0, 0.0))
        pose = compose(pose, (_STEP_M, 0.0, 0.0))
        gains.add(OdometryStep(_STEP_M, 0.0, 0.0, 0.1), pose, shown=True)
    assert gains.forward[0] == pytest.approx(1.0, abs=0.001)
    assert relative((0.0, 0.0, 0.0), pose)[0] > 20.0
