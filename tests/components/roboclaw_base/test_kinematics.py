"""Kinematics and odometry of a differential base."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from cairn.components.roboclaw_base.kinematics import (
    BaseLimits,
    WheelGeometry,
    count_difference,
    limit_velocity,
    ramp_velocity,
)
from cairn.components.roboclaw_base.odometry import OdometryNoise, SpeedAverage, WheelOdometry

GEOMETRY = WheelGeometry(0.05, 1.02, 0.3, 4000.0, "m2", left_inverted=True, right_inverted=False)
LIMITS = BaseLimits(0.6, 1.5, 0.8, 3.0)
speeds = st.floats(-20, 20)


def test_forward_and_left_are_as_in_rep_103() -> None:
    assert GEOMETRY.wheel_speeds(1.0, 0.0) == (1.0, 1.0)
    left, right = GEOMETRY.wheel_speeds(0.0, 1.0)
    assert left == -0.15
    assert right == 0.15


def test_one_wheel_turn_moves_the_robot_by_the_circumference() -> None:
    first, second = GEOMETRY.channel_counts(2 * math.pi * 0.05, 2 * math.pi * 0.05 * 1.02)

    assert (first, second) == (4000, -4000)  # the left wheel is on M2, and inverted


@given(speeds, speeds)
def test_velocity_survives_conversion_to_counts(forward: float, turn: float) -> None:
    counts = GEOMETRY.channel_counts(*GEOMETRY.wheel_speeds(forward, turn))
    back = GEOMETRY.body_motion(*GEOMETRY.wheel_distances(*counts))

    assert back == pytest.approx((forward, turn), abs=1e-3)  # a count is 0.08 mm


@given(st.integers(0, 2**32 - 1), st.integers(-(2**31) + 1, 2**31 - 1))
def test_count_difference_handles_the_wrap(before: int, counts: int) -> None:
    assert count_difference(before, (before + counts) % 2**32) == counts


@given(speeds, speeds)
def test_command_beyond_the_limits_is_slowed_down_on_the_same_curve(
    forward: float, turn: float
) -> None:
    wheels = GEOMETRY.wheel_speeds(forward, turn)
    v, w = limit_velocity(forward, turn, LIMITS, wheels, 0.7)

    assert abs(v) <= 0.6 * (1 + 1e-9)
    assert abs(w) <= 1.5 * (1 + 1e-9)
    assert max(map(abs, GEOMETRY.wheel_speeds(v, w))) <= 0.7 * (1 + 1e-9)
    assert v * turn == pytest.approx(w * forward, abs=1e-6)
    assert v * forward >= 0
    assert w * turn >= 0


def test_command_within_the_limits_is_unchanged() -> None:
    assert limit_velocity(0.3, -0.5, LIMITS, GEOMETRY.wheel_speeds(0.3, -0.5), 0.7) == (0.3, -0.5)


@given(speeds, speeds, speeds, speeds)
def test_ramp_respects_accelerations_and_reaches_its_target(
    v: float, w: float, to_v: float, to_w: float
) -> None:
    now = (v, w)
    for _ in range(300):
        then = ramp_velocity(now, (to_v, to_w), LIMITS, 0.2)
        assert abs(then[0] - now[0]) <= 0.8 * 0.2 + 1e-9
        assert abs(then[1] - now[1]) <= 3.0 * 0.2 + 1e-9
        now = then
    assert now == pytest.approx((to_v, to_w), abs=1e-9)


@given(st.floats(0.01, 3), st.floats(-6, 6), st.integers(1, 50))
def test_circle_is_the_same_in_few_or_many_steps(radius: float, turn: float, steps: int) -> None:
    assume(abs(turn) > 1e-3)
    noise = OdometryNoise(0.01, 0.02, 0.01)
    odometry = WheelOdometry(noise)
    for _ in range(steps):
        odometry.add(radius * abs(turn) / steps, turn / steps)

    sign = math.copysign(1.0, turn)
    assert odometry.pose[0] == pytest.approx(radius * sign * math.sin(turn), abs=1e-9)
    assert odometry.pose[1] == pytest.approx(radius * sign * (1 - math.cos(turn)), abs=1e-9)
    assert math.cos(odometry.pose[2]) == pytest.approx(math.cos(turn))


def test_covariance_grows_with_distance_and_turn() -> None:
    noise = OdometryNoise(0.1, 0.2, 0.05)
    odometry = WheelOdometry(noise)
    odometry.add(0.0, 0.0)
    assert not odometry.covariance.any()

    for _ in range(400):
        odometry.add(0.01, 0.0)
    spread = np.sqrt(np.diag(odometry.covariance))

    assert spread[0] == pytest.approx(0.1 * 2.0)  # [m/sqrt(m)] on 4 m
    assert spread[2] == pytest.approx(0.05 * 2.0)
    # The heading's random walk displaces it sideways by sqrt(distance^3 / 3) of its deviation.
    assert spread[1] == pytest.approx(0.05 * math.sqrt(4.0**3 / 3), rel=0.01)


def test_speed_is_the_mean_of_the_last_steps() -> None:
    speed = SpeedAverage(0.05)
    for seconds in (0.02, 0.03, 0.015, 0.025):  # reading times are uncertain
        mean = speed.add(seconds, 0.01, -0.02)

    assert mean == pytest.approx((0.03 / 0.07, -0.06 / 0.07))
    for _ in range(3):
        mean = speed.add(0.02, 0.0, 0.0)
    assert mean == (0.0, 0.0)
