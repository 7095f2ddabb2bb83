"""The math of transforms, compared with SciPy's rotations and with matrices."""

import math
import pickle  # noqa: TID251 - that a copy is equal is the test
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from cairn.schemas import geometry_msgs
from cairn.tf import InvalidArgumentError, Transform
from tests.wording import words_in_order

from .frames import (
    Array,
    angles,
    assert_same,
    lengths,
    reference_matrix,
    reference_rotation,
    transforms,
)

UP, DOWN = math.pi / 2, -math.pi / 2


@given(transforms)
def test_matrix_is_that_of_the_reference(one: Transform) -> None:
    np.testing.assert_allclose(one.matrix(), reference_matrix(one), atol=1e-12)


@given(angles, angles, angles)
def test_roll_pitch_yaw_are_rotations_about_fixed_axes(
    roll: float, pitch: float, yaw: float
) -> None:
    made = Transform.from_roll_pitch_yaw(roll, pitch, yaw)
    wanted = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()

    np.testing.assert_allclose(made.rotation_matrix(), wanted, atol=1e-12)
    again = Transform.from_roll_pitch_yaw(*made.roll_pitch_yaw())
    np.testing.assert_allclose(again.rotation_matrix(), wanted, atol=1e-6)


@pytest.mark.parametrize("pitch", [UP, DOWN])
@pytest.mark.parametrize(("roll", "yaw"), [(0.0, 0.7), (0.4, -2.0), (3.0, 3.0)])
def test_at_vertical_pitch_the_roll_is_zero_and_the_rotation_the_same(
    pitch: float, roll: float, yaw: float
) -> None:
    made = Transform.from_roll_pitch_yaw(roll, pitch, yaw)

    found = made.roll_pitch_yaw()

    assert found[:2] == (0.0, pitch)
    assert -math.pi <= found[2] <= math.pi
    again = Transform.from_roll_pitch_yaw(*found)
    np.testing.assert_allclose(again.rotation_matrix(), made.rotation_matrix(), atol=1e-9)


@given(transforms, transforms)
def test_composition_is_the_product_of_matrices(one: Transform, other: Transform) -> None:
    wanted = reference_matrix(one) @ reference_matrix(other)
    np.testing.assert_allclose((one @ other).matrix(), wanted, atol=1e-9)


@given(transforms)
def test_inverse_undoes_a_transform(one: Transform) -> None:
    np.testing.assert_allclose(
        one.inverse().matrix(), np.linalg.inv(reference_matrix(one)), atol=1e-9
    )
    assert_same(one @ one.inverse(), Transform())


@given(transforms, transforms, st.floats(0.0, 1.0))
def test_interpolation_is_linear_and_slerp(one: Transform, other: Transform, part: float) -> None:
    between = one.interpolate(other, part)

    ends = Rotation.concatenate([reference_rotation(one), reference_rotation(other)])
    turned = (ends[0].inv() * ends[1]).magnitude()
    moved = (1 - part) * np.array(one.translation) + part * np.array(other.translation)
    np.testing.assert_allclose(between.translation, moved, atol=1e-9)
    assert math.isclose(math.hypot(*between.rotation), 1.0, abs_tol=1e-12)
    if turned < math.pi - 1e-3:  # at half a turn, both ways have the same length
        wanted = Slerp([0.0, 1.0], ends)(part).as_matrix()
        np.testing.assert_allclose(between.rotation_matrix(), wanted, atol=1e-6)
        reached = (ends[0].inv() * reference_rotation(between)).magnitude()
        assert reached <= turned + 1e-6


def test_interpolation_takes_the_shorter_way_for_either_sign_of_a_quaternion() -> None:
    start = Transform.from_roll_pitch_yaw(0.0, 0.0, 0.1)
    end = Transform.from_roll_pitch_yaw(0.0, 0.0, 0.5)
    x, y, z, w = end.rotation

    same = Transform(rotation=(-x, -y, -z, -w))

    assert start.interpolate(same, 0.25).pose2d()[2] == pytest.approx(0.2)


@given(transforms, st.lists(st.tuples(lengths, lengths, lengths), max_size=5))
def test_points_are_mapped_to_the_target(
    one: Transform, points: list[tuple[float, float, float]]
) -> None:
    array: Array = np.array(points, dtype=np.float64).reshape(-1, 3)
    wanted = reference_rotation(one).as_matrix() @ array.T + np.array(one.translation)[:, None]

    mapped = one.apply(array)

    assert mapped.shape == array.shape
    np.testing.assert_allclose(mapped, wanted.T, atol=1e-9)


def test_single_point_stays_a_single_point() -> None:
    quarter = Transform.from_roll_pitch_yaw(0.0, 0.0, UP, (1.0, 2.0, 3.0))

    np.testing.assert_allclose(quarter.apply([1.0, 0.0, 0.0]), [1.0, 3.0, 3.0], atol=1e-12)


@pytest.mark.parametrize("shape", [(2,), (2, 2), (1, 3, 3), ()])
def test_points_of_another_shape_are_rejected(shape: tuple[int, ...]) -> None:
    with pytest.raises(InvalidArgumentError, match=words_in_order(str(shape), "(n, 3)")):
        Transform().apply(np.zeros(shape))


@given(lengths, lengths, angles)
def test_pose_in_the_plane_comes_back(x: float, y: float, yaw: float) -> None:
    pose = Transform.from_pose2d(x, y, yaw).pose2d()

    assert pose[:2] == (x, y)
    assert math.isclose(math.remainder(pose[2] - yaw, math.tau), 0.0, abs_tol=1e-9)


@given(transforms)
def test_message_has_the_same_transform(one: Transform) -> None:
    message = one.to_message()

    assert isinstance(message, geometry_msgs.Transform)
    assert_same(Transform.from_message(message), one)


def test_quaternion_of_almost_unit_length_is_normalized() -> None:
    made = Transform(rotation=(0.0, 0.0, 0.0, 1.004))

    assert made.rotation == (0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("rotation", "words"),
    [
        ((0.0, 0.0, 0.0, 0.0), ("not normalized", "length is 0,")),
        ((0.0, 0.0, 1.0, 1.0), ("not normalized", "1.41421")),
        ((0.0, 0.0, 0.0, 0.99), ("not normalized", "0.99")),
        ((0.0, 0.0, math.nan, 1.0), ("nan", "not normalized")),
        ((0.0, 0.0, math.inf, 1.0), ("inf", "not normalized")),
        ((1e200, 0.0, 0.0, 0.0), ("1e+200", "not normalized")),
    ],
)
def test_quaternion_of_another_length_is_rejected(
    rotation: tuple[float, float, float, float], words: tuple[str, ...]
) -> None:
    with pytest.raises(InvalidArgumentError, match=words_in_order(*words)):
        Transform(rotation=rotation)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_number_that_is_not_finite_is_rejected(bad: float) -> None:
    with pytest.raises(InvalidArgumentError, match=words_in_order("translation", "not finite")):
        Transform((0.0, bad, 0.0))
    with pytest.raises(InvalidArgumentError, match=words_in_order("roll", "not all finite")):
        Transform.from_roll_pitch_yaw(0.0, bad, 0.0)


def test_transform_is_an_immutable_value() -> None:
    one = Transform((1.0, 2.0, 3.0))

    with pytest.raises(FrozenInstanceError):
        one.translation = (0.0, 0.0, 0.0)  # type: ignore[misc]
    assert one == Transform((1.0, 2.0, 3.0))
    assert len({one, Transform((1.0, 2.0, 3.0)), Transform()}) == 2
    assert pickle.loads(pickle.dumps(one)) == one


def test_array_is_not_composed_with_a_transform() -> None:
    with pytest.raises(TypeError):
        np.eye(4) @ Transform()  # type: ignore[operator]
    with pytest.raises(TypeError):
        Transform() @ np.eye(4)  # type: ignore[operator]
