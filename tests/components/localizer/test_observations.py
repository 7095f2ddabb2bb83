"""Observations: association by position, and observations that arrive late."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.components.localizer.observations import (
    NEAREST_M,
    CameraView,
    Landmark,
    as_observed_from,
    associate,
    view_as_from,
)
from cairn.components.localizer.particle_set import PoseEstimate
from cairn.planar.poses import Pose, compose
from cairn.visual_map.observations import Observation

AT_ORIGIN = PoseEstimate((0.0, 0.0, 0.0), np.diag([0.0025, 0.0025, 0.0004]))
NORTH, EAST = Landmark(1, 0.0, 3.0), Landmark(2, 3.0, 0.0)
BOTH = {1: NORTH, 2: EAST}


def observed(object_id: int, range_m: float, bearing: float, *alternatives: int) -> Observation:
    return Observation(object_id, range_m, bearing, 0.01, 0.0004, alternatives)


def test_unambiguous_observation_is_kept() -> None:
    moved = observed(1, 1.0, 1.0)

    assert associate([moved], AT_ORIGIN, BOTH) == [moved]


def test_ambiguous_observation_is_assigned_by_position() -> None:
    [found] = associate([observed(1, 3.0, 0.0, 2)], AT_ORIGIN, BOTH)

    assert found.object_id == 2
    assert found.alternatives == ()


def test_ambiguous_observation_far_from_both_objects_is_dropped() -> None:
    assert associate([observed(1, 1.5, -1.0, 2)], AT_ORIGIN, BOTH) == []


def test_lookalikes_close_together_are_dropped() -> None:
    together = {1: Landmark(1, 3.0, 0.1), 2: Landmark(2, 3.0, -0.1)}

    assert associate([observed(1, 3.0, 0.0, 2)], AT_ORIGIN, together) == []


def test_ambiguous_observation_without_a_pose_is_dropped() -> None:
    sure = observed(2, 3.0, 0.0)

    assert associate([observed(1, 3.0, math.pi / 2, 2), sure], None, BOTH) == [sure]


def test_of_two_instances_the_one_at_the_mapped_position_counts() -> None:
    other, mapped = observed(2, 2.0, 0.8), observed(2, 3.05, 0.0)

    assert associate([other, mapped], AT_ORIGIN, BOTH) == [mapped]


def test_two_instances_away_from_the_mapped_position_are_dropped() -> None:
    assert associate([observed(2, 2.0, 0.8), observed(2, 1.0, -0.5)], AT_ORIGIN, BOTH) == []


def test_alternative_removed_from_the_map_is_ignored() -> None:
    gone = {1: NORTH, 2: Landmark(2, 3.0, 0.0, live=False)}

    assert associate([observed(1, 3.0, 0.0, 2)], AT_ORIGIN, gone) == []


meters = st.floats(-3.0, 3.0)
poses = st.tuples(meters, meters, st.floats(-3.0, 3.0))


def placed(robot: Pose, observation: Observation) -> tuple[float, float]:
    ahead = observation.range_m * math.cos(observation.bearing)
    aside = observation.range_m * math.sin(observation.bearing)
    x, y, _ = compose(robot, (ahead, aside, 0.0))
    return x, y


@given(poses, poses, st.floats(0.3, 8.0), st.floats(-3.0, 3.0))
def test_late_observation_implies_the_same_position(
    then: Pose, step: Pose, range_m: float, bearing: float
) -> None:
    observation = Observation(1, range_m, bearing, 0.01, 0.001)
    carried = as_observed_from(observation, step)
    if carried.range_m <= NEAREST_M:
        return  # the robot stands on it now

    now = compose(then, step)
    assert placed(now, carried) == pytest.approx(placed(then, observation), abs=1e-6)


def test_observation_without_delay_is_unchanged() -> None:
    observation = Observation(1, 3.0, 0.4, 0.01, 0.001)

    carried = as_observed_from(observation, (0.0, 0.0, 0.0))

    assert (carried.range_m, carried.bearing) == pytest.approx((3.0, 0.4))


def test_view_is_rotated_back_by_the_turn() -> None:
    view = view_as_from(CameraView(-0.5, 0.5, 0.4, 5.0), (0.0, 0.0, 0.2))

    assert (view.right, view.left) == pytest.approx((-0.7, 0.3))
