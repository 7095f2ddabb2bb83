"""A observation that comes late is one of the place where the robot was, not of where it is."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.components.localizer.observations import (
    CameraView,
    Observation,
    as_observed_from,
    view_as_from,
)
from cairn.planar.poses import Pose, compose

meters = st.floats(-3.0, 3.0)
poses = st.tuples(meters, meters, st.floats(-3.0, 3.0))


def placed(robot: Pose, observation: Observation) -> tuple[float, float]:
    ahead = observation.range_m * math.cos(observation.bearing)
    aside = observation.range_m * math.sin(observation.bearing)
    x, y, _ = compose(robot, (ahead, aside, 0.0))
    return x, y


@given(poses, poses, st.floats(0.3, 8.0), st.floats(-3.0, 3.0))
def test_it_places_its_object_where_it_was_seen(
    then: Pose, step: Pose, range_m: float, bearing: float
) -> None:
    observation = Observation(1, range_m, bearing, 0.01, 0.001)
    carried = as_observed_from(observation, step)
    if carried.range_m <= 0.06:
        return  # the robot stands on it now

    now = compose(then, step)
    assert placed(now, carried) == pytest.approx(placed(then, observation), abs=1e-6)


def test_one_that_is_not_late_stays_as_it_is() -> None:
    observation = Observation(1, 3.0, 0.4, 0.01, 0.001)

    carried = as_observed_from(observation, (0.0, 0.0, 0.0))

    assert (carried.range_m, carried.bearing) == pytest.approx((3.0, 0.4))


def test_the_view_of_a_robot_that_has_turned_left_lies_to_its_right() -> None:
    view = view_as_from(CameraView(-0.5, 0.5, 0.4, 5.0), (0.0, 0.0, 0.2))

    assert (view.right, view.left) == pytest.approx((-0.7, 0.3))
