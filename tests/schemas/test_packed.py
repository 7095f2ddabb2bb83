"""Packed sequences: one array that is accessed as messages."""

import numpy as np
import pytest

from cairn.schemas.geometry_msgs import Point, Pose, PoseArray, PoseStamped, Quaternion, Twist
from cairn.schemas.message import InvalidMessage
from cairn.schemas.packed import Packed
from cairn.schemas.sensor_msgs import LaserScan
from tests.wording import words_in_order

ROWS = np.arange(21.0).reshape(3, 7)


def test_rows_of_an_array_become_messages() -> None:
    poses = PoseArray(poses=Packed(Pose, ROWS)).poses
    assert len(poses) == 3
    assert poses[1] == Pose(Point(7.0, 8.0, 9.0), Quaternion(10.0, 11.0, 12.0, 13.0))
    assert poses[-1].orientation.w == 20.0
    assert [pose.position.x for pose in poses] == [0.0, 7.0, 14.0]
    assert poses[1:] == Packed(Pose, ROWS[1:])
    assert poses[1] in poses
    with pytest.raises(IndexError):
        poses[3]


def test_messages_become_rows_of_an_array() -> None:
    poses = [Pose(Point(1.0, 2.0, 3.0)), Pose()]
    packed = PoseArray(poses=poses).poses  # type: ignore[arg-type]
    assert packed.array.tolist() == [[1, 2, 3, 0, 0, 0, 1], [0, 0, 0, 0, 0, 0, 1]]
    assert list(packed) == poses


def test_array_is_read_only_and_copied_only_if_it_was_writable() -> None:
    frozen = ROWS.copy()
    frozen.flags.writeable = False
    assert Packed(Pose, frozen).array is frozen
    assert not np.shares_memory(Packed(Pose, ROWS).array, ROWS)
    assert not Packed(Pose, ROWS).array.flags.writeable


def test_packed_sequences_with_equal_numbers_are_equal() -> None:
    assert Packed(Pose, ROWS) == Packed(Pose, list(Packed(Pose, ROWS)))
    assert hash(Packed(Pose, ROWS)) == hash(Packed(Pose, ROWS + 1))
    assert Packed(Pose, ROWS) != Packed(Pose, ROWS + 1)
    assert Packed(Pose, ROWS) != list(Packed(Pose, ROWS))
    assert Packed(Point, ROWS[:, :3]) != Packed(Pose, ROWS)


def test_empty_sequence_is_packed() -> None:
    assert PoseArray().poses.array.shape == (0, 7)
    assert PoseArray(poses=[]) == PoseArray()  # type: ignore[arg-type]


def test_any_message_of_numbers_can_be_packed() -> None:
    assert Packed(Twist, np.zeros((2, 6)))[1] == Twist()
    for element in (PoseStamped, LaserScan, int):
        with pytest.raises(TypeError, match=words_in_order("not", "float64")):
            Packed(element)


@pytest.mark.parametrize(
    ("poses", "error"),
    [
        (np.zeros((2, 3)), r"must have the shape \(n, 7\), not \(2, 3\)"),
        (np.zeros(7), r"must have the shape \(n, 7\), not \(7,\)"),
        (np.full((1, 7), np.nan), "must hold finite numbers only"),
        (np.zeros((1, 7), complex), "must hold numbers, not complex128"),
        ([Point()], "must hold Pose objects only"),
        (Packed(Point), "must be a sequence of Pose"),
        (3, "must be a sequence of Pose"),
    ],
)
def test_other_values_are_rejected_as_sequence_of_poses(poses: object, error: str) -> None:
    with pytest.raises(InvalidMessage, match=f"PoseArray: poses = .*{error}"):
        PoseArray(poses=poses)  # type: ignore[arg-type]
