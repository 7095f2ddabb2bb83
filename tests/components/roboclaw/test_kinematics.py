"""Wheels, counts and the way that they lead."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from cairn.components.roboclaw.kinematics import Geometry, Limits, approached, counted, limited
from cairn.components.roboclaw.odometry import OdometryErrors, RecentSpeed, WheelOdometry

GEOMETRY = Geometry(0.05, 1.02, 0.3, 4000.0, "m2", left_inverted=True, right_inverted=False)
LIMITS = Limits(0.6, 1.5, 0.8, 3.0)
speeds = st.floats(-20, 20)


def test_ahead_and_left_are_where_rep_103_has_them() -> None:
    assert GEOMETRY.wheel_speeds(1.0, 0.0) == (1.0, 1.0)
    left, right = GEOMETRY.wheel_speeds(0.0, 1.0)
    assert left == -0.15
    assert right == 0.15


def test_a_turn_of_a_wheel_is_its_circumference() -> None:
    first, second = GEOMETRY.channel_counts(2 * math.pi * 0.05, 2 * math.pi * 0.05 * 1.02)

    assert (first, second) == (4000, -4000)  # the left wheel is on M2, and inverted


@given(speeds, speeds)
def test_twists_come_back_from_counts(forward: float, turn: float) -> None:
    counts = GEOMETRY.channel_counts(*GEOMETRY.wheel_speeds(forward, turn))
    back = GEOMETRY.twist(*GEOMETRY.wheel_ways(*counts))

    assert back == pytest.approx((forward, turn), abs=1e-3)  # a count is 0.08 mm


@given(st.integers(0, 2**32 - 1), st.integers(-(2**31) + 1, 2**31 - 1))
def test_differences_of_counters_go_across_their_wrap(before: int, way: int) -> None:
    assert counted(before, (before + way) % 2**32) == way


@given(speeds, speeds)
def test_a_command_beyond_the_limits_keeps_its_curve(forward: float, turn: float) -> None:
    wheels = GEOMETRY.wheel_speeds(forward, turn)
    v, w = limited(forward, turn, LIMITS, wheels, 0.7)

    assert abs(v) <= 0.6 * (1 + 1e-9)
    assert abs(w) <= 1.5 * (1 + 1e-9)
    assert max(map(abs, GEOMETRY.wheel_speeds(v, w))) <= 0.7 * (1 + 1e-9)
    assert v * turn == pytest.approx(w * forward, abs=1e-6)
    assert v * forward >= 0
    assert w * turn >= 0


def test_a_command_within_the_limits_is_left_as_it_is() -> None:
    assert limited(0.3, -0.5, LIMITS, GEOMETRY.wheel_speeds(0.3, -0.5), 0.7) == (0.3, -0.5)


@given(speeds, speeds, speeds, speeds)
def test_speeds_change_no_faster_than_allowed_and_arrive(
    v: float, w: float, to_v: float, to_w: float
) -> None:
    now = (v, w)
    for _ in range(300):
        then = approached(now, (to_v, to_w), LIMITS, 0.2)
        assert abs(then[0] - now[0]) <= 0.8 * 0.2 + 1e-9
        assert abs(then[1] - now[1]) <= 3.0 * 0.2 + 1e-9
        now = then
    assert now == pytest.approx((to_v, to_w), abs=1e-9)


@given(st.floats(0.01, 3), st.floats(-6, 6), st.integers(1, 50))
def test_a_circle_is_the_same_in_few_steps_or_many(
    radius: float, turned: float, steps: int
) -> None:
    assume(abs(turned) > 1e-3)
    errors = OdometryErrors(0.01, 0.02, 0.01)
    odometry = WheelOdometry(errors)
    for _ in range(steps):
        odometry.add(radius * abs(turned) / steps, turned / steps)

    sign = math.copysign(1.0, turned)
    assert odometry.pose[0] == pytest.approx(radius * sign * math.sin(turned), abs=1e-9)
    assert odometry.pose[1] == pytest.approx(radius * sign * (1 - math.cos(turned)), abs=1e-9)
    assert math.cos(odometry.pose[2]) == pytest.approx(math.cos(turned))


def test_the_covariance_grows_with_way_and_turn() -> None:
    errors = OdometryErrors(0.1, 0.2, 0.05)
    odometry = WheelOdometry(errors)
    odometry.add(0.0, 0.0)
    assert not odometry.covariance.any()

    for _ in range(400):
        odometry.add(0.01, 0.0)
    spread = np.sqrt(np.diag(odometry.covariance))

    assert spread[0] == pytest.approx(0.1 * 2.0)  # [m/sqrt(m)] on 4 m
    assert spread[2] == pytest.approx(0.05 * 2.0)
    # The heading's random walk moves it aside by sqrt(way^3 / 3) of its own deviation.
    assert spread[1] == pytest.approx(0.05 * math.sqrt(4.0**3 / 3), rel=0.01)


def test_speeds_are_means_of_the_last_moments() -> None:
    speed = RecentSpeed(0.05)
    for seconds in (0.02, 0.03, 0.015, 0.025):  # read at times that are not quite true
        told = speed.add(seconds, 0.01, -0.02)

    assert told == pytest.approx((0.03 / 0.07, -0.06 / 0.07))
    for _ in range(3):
        told = speed.add(0.02, 0.0, 0.0)
    assert told == (0.0, 0.0)
