"""Planar poses in messages."""

import math

import numpy as np
import pytest

from cairn.planar.messages import packed_poses, planar_pose, planar_poses
from cairn.schemas.geometry_msgs import Point, Pose, Quaternion
from cairn.schemas.packed import Packed


@pytest.mark.parametrize("number", [1e200, -1e200, 1e308, 5e-324, 0.0])
def test_yaw_of_any_quaternion_is_finite(number: float) -> None:
    turned = Quaternion(x=number, y=-number, z=number, w=number)
    row = np.array([[1.0, 2.0, 0.0, number, -number, number, number]])

    x, y, yaw = planar_pose(Pose(position=Point(x=1.0, y=2.0), orientation=turned))

    assert (x, y) == (1.0, 2.0)
    assert math.isfinite(yaw)
    assert planar_poses(Packed(Pose, row))[0] == pytest.approx((1.0, 2.0, yaw))


def test_poses_survive_a_message() -> None:
    poses = np.array([[1.0, 2.0, 3.0], [-1.0, 0.5, -3.0]])

    assert planar_poses(packed_poses(poses)) == pytest.approx(poses)
