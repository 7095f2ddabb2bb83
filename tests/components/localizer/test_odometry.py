"""Odometry tracks: motion between any two times, jumps, lag and gain."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.components.localizer.odometry import CommandedTrack, MeasuredTrack
from cairn.planar.motion_model import MotionModel, OdometryStep, move_pose, odometry_step
from cairn.planar.odometry import OUTDATED_IN_A_ROW, OdometryChange
from cairn.planar.poses import Pose, relative


def measured(*poses: Pose, every_s: float = 0.1) -> MeasuredTrack:
    track = MeasuredTrack()
    for k, pose in enumerate(poses):
        track.add(k * every_s, pose, 0.0, 0.0)
    return track


def test_measured_motion_is_divided_in_proportion_to_time() -> None:
    track = measured((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.2, 0.0, 0.0))
    track.advance(0.0)

    assert track.advance(0.05).ahead == pytest.approx(0.05)
    assert track.preview(0.2).ahead == pytest.approx(0.15)
    assert track.advance(0.15).ahead == pytest.approx(0.10)
    assert track.advance(9.0).ahead == pytest.approx(0.05)


def test_standing_robot_has_no_motion() -> None:
    track = measured((1.0, 2.0, 3.0), (1.0, 2.0, 3.0))
    track.advance(0.0)

    assert track.advance(0.1) == OdometryStep(0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("jump", [(5.0, 0.0, 0.0), (0.1, 0.0, 2.5), (-3.0, 4.0, 0.0)])
def test_impossible_jump_is_ignored(jump: Pose) -> None:
    x, y, theta = jump
    after = (x + 0.1 * math.cos(theta), y + 0.1 * math.sin(theta), theta)
    track = measured((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), jump, after)
    track.advance(0.0)

    step = track.advance(0.3)

    assert (step.ahead, step.aside, step.turned) == pytest.approx((0.2, 0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize("track", [MeasuredTrack(), CommandedTrack(0.1)])
def test_time_that_runs_backwards_is_reported(track: MeasuredTrack | CommandedTrack) -> None:
    track.add(9.0, (0.0, 0.0, 0.0), 0.0, 0.0)
    changes = [track.add(1.0 + k, (0.0, 0.0, 0.0), 1.0, 1.0) for k in range(OUTDATED_IN_A_ROW)]

    assert changes == [OdometryChange.OUTDATED] * (OUTDATED_IN_A_ROW - 1) + [OdometryChange.RESET]


def test_late_pose_refines_motion_that_was_interpolated() -> None:
    track = measured((0.0, 0.0, 0.0))
    track.advance(0.0)
    track.add(0.4, (0.4, 0.0, 0.0), 0.0, 0.0)
    assert track.advance(0.2).ahead == pytest.approx(0.2)

    assert track.add(0.2, (0.1, 0.0, 0.0), 0.0, 0.0) is OdometryChange.LATE

    # The robot was not as far as assumed: the rest of the way is longer.
    assert track.advance(0.3).ahead == pytest.approx(0.05)
    assert track.advance(0.4).ahead == pytest.approx(0.15)


def test_motion_up_to_a_time_that_odometry_had_not_reached_counts_later() -> None:
    track = measured((0.0, 0.0, 0.0), (0.1, 0.0, 0.0))
    track.advance(0.0)
    assert track.advance(0.2).ahead == pytest.approx(0.1)

    track.add(0.3, (0.3, 0.0, 0.0), 0.0, 0.0)

    assert track.advance(0.3).ahead == pytest.approx(0.2)


@given(st.permutations(range(1, 10)))
def test_order_of_late_records_does_not_change_the_motion(order: list[int]) -> None:
    commands = {k: (0.05 * k, (0.01 * k * k, 0.0, 0.0), 0.1 * k, 0.0) for k in range(11)}
    for track in (MeasuredTrack(), CommandedTrack(0.0)):
        track.add(*commands[0])
        track.advance(0.0)
        for k in (*order, 10):
            track.add(*commands[k])
        steps = [track.advance(0.025 * k).ahead for k in range(1, 21)]
        if isinstance(track, MeasuredTrack):
            assert sum(steps) == pytest.approx(1.0)
            assert steps[0] == pytest.approx(0.005)
        else:
            assert sum(steps) == pytest.approx(0.05 * 0.1 * 45)
            assert steps[-1] == pytest.approx(0.025 * 0.9)


def test_late_command_counts_unless_a_newer_one_was_executed() -> None:
    track = CommandedTrack(lag_s=0.1)
    track.add(0.0, (0.0, 0.0, 0.0), 1.0, 0.0)
    track.advance(0.1)
    track.add(0.3, (0.0, 0.0, 0.0), 3.0, 0.0)
    assert track.advance(0.45).ahead == pytest.approx(0.3 + 0.15)

    track.add(0.2, (0.0, 0.0, 0.0), 2.0, 0.0)

    assert track.advance(0.55).ahead == pytest.approx(0.3)


def test_command_is_executed_with_lag_and_gain() -> None:
    track = CommandedTrack(lag_s=0.2, forward_gain=0.9)
    track.add(0.0, (0.0, 0.0, 0.0), 1.0, 0.0)
    track.advance(0.0)

    assert track.advance(0.2).ahead == 0.0
    assert track.advance(1.2).ahead == pytest.approx(0.9)


@given(st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-3, 3)))
def test_step_leads_to_its_target(target: Pose) -> None:
    begin = (0.3, -2.0, 1.0)
    there = relative(begin, move_pose(begin, odometry_step(target)))

    assert there[:2] == pytest.approx(target[:2], abs=1e-9)
    assert math.sin(there[2] - target[2]) == pytest.approx(0.0, abs=1e-9)


def test_noise_grows_with_the_square_root_of_the_distance() -> None:
    model = MotionModel(0.0, 0.0, 0.02, 0.04, 0.03)
    short = np.array(model.deviations(OdometryStep(1.0, 0.0, 0.0, 1.0)))
    long = np.array(model.deviations(OdometryStep(4.0, 0.0, 0.0, 4.0)))

    np.testing.assert_allclose(long, 2.0 * short)
