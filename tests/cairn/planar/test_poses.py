"""Poses compose and invert as rigid motions; conversion to messages and back is exact."""

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
def test_pose_composed_with_its_inverse_is_the_origin(pose: Pose) -> None:
    assert same(compose(pose, inverse(pose)), (0.0, 0.0, 0.0))
    assert same(compose(inverse(pose), pose), (0.0, 0.0, 0.0))


@given(poses, poses)
def test_relative_pose_composed_with_its_origin_is_the_pose(origin: Pose, pose: Pose) -> None:
    assert same(compose(origin, relative(origin, pose)), pose)


@given(poses, poses, poses)
def test_composition_is_associative(a: Pose, b: Pose, c: Pose) -> None:
    assert same(compose(compose(a, b), c), compose(a, compose(b, c)))


@given(poses)
def test_pose_survives_conversion_to_a_message_and_back(pose: Pose) -> None:
    assert same(planar_pose(pose_message(pose)), pose)


@given(st.lists(poses, max_size=5))
def test_packed_poses_survive_conversion_and_back(rows: list[Pose]) -> None:
    array = np.array(rows, np.float64).reshape(-1, 3)

    again = planar_poses(packed_poses(array))

    assert all(same(tuple(a), tuple(b)) for a, b in zip(array, again, strict=True))


def test_covariance_is_stored_at_the_positions_that_ros_defines() -> None:
    root = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.01, -0.02, 0.05]])
    covariance = root @ root.T

    message = with_covariance((1.0, 2.0, 0.5), covariance)

    assert planar_covariance(message) == pytest.approx(covariance)
    full = message.covariance.reshape(6, 6)
    assert full[5, 5] == pytest.approx(covariance[2, 2])
    assert full[0, 5] == pytest.approx(covariance[0, 2])


def test_headings_are_interpolated_along_the_shorter_arc() -> None:
    middle = between((0.0, 0.0, 3.0), (1.0, 0.0, -3.0), 0.5)

    assert middle[0] == 0.5
    assert abs(middle[2]) == pytest.approx(math.pi)
