"""Poses compose and invert as rigid motions do; messages carry them there and back."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cairn.planar.messages import (
    packed_poses,
    planar_covariance,
    planar_pose,
    planar_poses,
    pose_message,
    with_covariance,
)
from cairn.planar.poses import Pose, between, compose, inverse, relative, wrap

meters = st.floats(-100.0, 100.0)
poses = st.tuples(meters, meters, st.floats(-math.pi, math.pi, exclude_max=True))


def same(a: Pose, b: Pose) -> bool:
    apart = math.hypot(a[0] - b[0], a[1] - b[1])
    return apart < 1e-9 and abs(wrap(a[2] - b[2])) < 1e-9


@given(poses)
def test_there_and_back_is_where_one_was(pose: Pose) -> None:
    assert same(compose(pose, inverse(pose)), (0.0, 0.0, 0.0))
    assert same(compose(inverse(pose), pose), (0.0, 0.0, 0.0))


@given(poses, poses)
def test_a_pose_seen_from_another_leads_there(origin: Pose, pose: Pose) -> None:
    assert same(compose(origin, relative(origin, pose)), pose)


@given(poses, poses, poses)
def test_steps_may_be_taken_together(a: Pose, b: Pose, c: Pose) -> None:
    assert same(compose(compose(a, b), c), compose(a, compose(b, c)))


@given(poses)
def test_a_message_carries_a_pose(pose: Pose) -> None:
    assert same(planar_pose(pose_message(pose)), pose)


@given(st.lists(poses, max_size=5))
def test_packed_messages_carry_poses(rows: list[Pose]) -> None:
    array = np.array(rows, np.float64).reshape(-1, 3)

    again = planar_poses(packed_poses(array))

    assert all(same(tuple(a), tuple(b)) for a, b in zip(array, again, strict=True))


def test_a_covariance_is_carried_where_ros_has_it() -> None:
    root = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.01, -0.02, 0.05]])
    covariance = root @ root.T

    message = with_covariance((1.0, 2.0, 0.5), covariance)

    assert planar_covariance(message) == pytest.approx(covariance)
    full = message.covariance.reshape(6, 6)
    assert full[5, 5] == pytest.approx(covariance[2, 2])
    assert full[0, 5] == pytest.approx(covariance[0, 2])


def test_headings_are_interpolated_the_short_way_round() -> None:
    middle = between((0.0, 0.0, 3.0), (1.0, 0.0, -3.0), 0.5)

    assert middle[0] == 0.5
    assert abs(middle[2]) == pytest.approx(math.pi)
