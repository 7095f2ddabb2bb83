"""Messages in Python: defaults, immutability, equality, conversion of values."""

import gc
import math
from dataclasses import FrozenInstanceError, replace
from enum import IntEnum

import numpy as np
import pytest
from pydantic import ValidationError

from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.cairn_msgs import ObjectEvidence, RecognizedObject, VisualMapChange
from cairn.schemas.field_types import BoolArray, Float32, Int16Array, String, UInt8, empty
from cairn.schemas.geometry_msgs import (
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    Twist,
    Vector3,
)
from cairn.schemas.message import InvalidMessage, message, reject, type_name
from cairn.schemas.nav_msgs import MapMetaData, OccupancyGrid, Path
from cairn.schemas.sensor_msgs import CameraInfo, Image, LaserScan
from cairn.schemas.std_msgs import Header
from tests.wording import words_in_order


def test_omitted_fields_are_zero_and_orientation_is_identity() -> None:
    assert Header() == Header(stamp=Time(sec=0, nanosec=0), frame_id="")
    assert Pose().orientation == Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
    assert PoseWithCovariance().covariance.tolist() == [0.0] * 36


def test_message_class_has_its_ros_name() -> None:
    assert type_name(Twist) == "geometry_msgs/msg/Twist"


def test_other_classes_have_no_ros_name() -> None:
    class OwnTwist(Twist):
        pass

    with pytest.raises(TypeError, match="OwnTwist is not a message"):
        type_name(OwnTwist)
    with pytest.raises(TypeError, match="int is not a message"):
        type_name(int)


@pytest.mark.parametrize("name", ["Twist", "geometry_msgs/Twist", "geometry_msgs/other/Twist", "/"])
def test_incomplete_ros_name_is_rejected(name: str) -> None:
    with pytest.raises(TypeError, match="is not a ROS 2 message name"):
        message(name)


def test_class_without_fields_is_rejected() -> None:
    with pytest.raises(TypeError, match="at least one field"):

        @message("test_msgs/msg/Nothing")
        class Nothing:
            """A class without fields."""


def test_message_is_immutable() -> None:
    scan = LaserScan(range_max=8.0, ranges=np.ones(1, np.float32))
    with pytest.raises(FrozenInstanceError):
        scan.angle_min = 1.0  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        scan.ranges[0] = 2.0


def test_changing_the_source_array_does_not_change_the_message() -> None:
    covariance = np.eye(6).ravel()
    uncertain = PoseWithCovariance(covariance=covariance)
    covariance[0] = 9.0
    assert uncertain.covariance[0] == 1.0


def test_read_only_array_of_the_right_type_is_not_copied() -> None:
    pixels = np.zeros(12, np.uint8)
    pixels.flags.writeable = False
    assert Image(height=3, step=4, data=pixels).data is pixels


def test_bytes_are_not_copied() -> None:
    pixels = bytes(12)
    image = Image(height=3, step=4, data=pixels)  # type: ignore[arg-type]
    assert np.shares_memory(image.data, np.frombuffer(pixels, np.uint8))


@pytest.mark.parametrize(
    "cells",
    [[-1, 0, 100], (-1, 0, 100), np.array([-1, 0, 100]), np.array([-1.0, 0.0, 100.0])],
    ids=["list", "tuple", "int64", "float64"],
)
def test_sequences_become_arrays_of_the_type_on_the_wire(cells: object) -> None:
    grid = OccupancyGrid(info=MapMetaData(resolution=0.1, width=3, height=1), data=cells)  # type: ignore[arg-type]
    assert grid.data.dtype == np.int8
    assert grid.data.tolist() == [-1, 0, 100]


@pytest.mark.parametrize(
    "values",
    [
        np.array([200]),
        np.array([200], np.uint8),
        [200],
        [2**70],
        np.array([0.5]),
        [0.5],
        np.array([np.nan]),
        np.array([1e300]),
        ["1"],
        [None],
        [[1], [2, 3]],
        [True],
        np.array([1 + 0j]),
        np.zeros((1, 1)),
        3,
        "1",
        iter([1]),
    ],
    ids=lambda values: "iterator" if hasattr(values, "__next__") else repr(values),
)
def test_value_that_the_array_type_cannot_hold_exactly_is_rejected(values: object) -> None:
    with pytest.raises(InvalidMessage, match=r"nav_msgs/msg/OccupancyGrid: data = .*: must "):
        OccupancyGrid(info=MapMetaData(resolution=0.1, width=1, height=1), data=values)  # type: ignore[arg-type]


def test_python_floats_are_rounded_to_float32_but_float64_arrays_are_not() -> None:
    with pytest.raises(InvalidMessage, match="float32 represents exactly"):
        LaserScan(ranges=np.array([0.1]))
    with pytest.raises(InvalidMessage, match="fit float32"):
        LaserScan(ranges=[1e39])  # type: ignore[arg-type]
    exact = np.array([0.5, np.nan, np.inf])
    single = exact.astype(np.float32)
    assert LaserScan(range_max=8.0, ranges=single) == LaserScan(range_max=8.0, ranges=exact)
    assert LaserScan(range_max=8.0, ranges=[0.1]).ranges[0] == np.float32(0.1)  # type: ignore[arg-type]


def test_float32_field_is_rounded_to_float32() -> None:
    assert MapMetaData(resolution=0.05).resolution == float(np.float32(0.05))


def test_numpy_scalars_and_enumerations_become_python_numbers() -> None:
    class Verdict(IntEnum):
        FALSE_MATCH = 2

    point = Point(np.float32(0.5), np.float64(2.0), np.int64(3))  # type: ignore[arg-type]
    assert point == Point(0.5, 2.0, 3.0)
    assert type(point.x) is float
    assert type(point.z) is float
    sec = Time(sec=np.int32(3)).sec  # type: ignore[arg-type]
    assert (sec, type(sec)) == (3, int)
    evidence = ObjectEvidence(
        object_id=1, similarity=0.5, verdict=Verdict.FALSE_MATCH, distance=0.0, x=0.0, y=0.0,
        covariance=np.zeros(4), range=1.0, bearing=0.0,
    )  # fmt: skip
    assert type(evidence.verdict) is int


def test_message_field_accepts_a_mapping() -> None:
    assert Twist(linear={"x": 1.0}) == Twist(linear=Vector3(x=1.0))  # type: ignore[arg-type]
    with pytest.raises(
        InvalidMessage, match=words_in_order("Twist", "linear.x = 'fast'", "finite number")
    ):
        Twist(linear={"x": "fast"})  # type: ignore[arg-type]


def test_messages_with_equal_fields_are_equal() -> None:
    one, same, other = (
        LaserScan(range_max=8.0, ranges=np.float32([1, np.nan, r]))  # type: ignore[arg-type]
        for r in (2, 2, 3)
    )
    assert one == same
    assert hash(one) == hash(same)
    assert one != other
    strangers: list[object] = ["scan", Point(), None]
    assert all(one != stranger for stranger in strangers)


def test_nan_equals_nan_in_messages() -> None:
    nowhere = VisualMapChange(old_x=math.nan, old_y=-math.nan)
    assert nowhere == VisualMapChange()
    assert hash(nowhere) == hash(VisualMapChange())


def test_replace_validates_the_new_message() -> None:
    sighting = RecognizedObject(object_id=1, range=2.0, bearing=0.0)
    assert replace(sighting, range=3.0).range == 3.0
    with pytest.raises(InvalidMessage, match=words_in_order("range = -1.0", "above 0")):
        replace(sighting, range=-1.0)


def test_sequences_of_messages_are_tuples() -> None:
    assert Path(poses=[]).poses == ()  # type: ignore[arg-type]
    with pytest.raises(InvalidMessage, match=r"Path: poses\[1\] = 7: "):
        Path(poses=[{}, 7])  # type: ignore[arg-type]


def test_missing_and_unknown_fields_are_named() -> None:
    with pytest.raises(InvalidMessage, match="RecognizedObject: object_id: is required"):
        RecognizedObject(range=1.0, bearing=0.0)  # type: ignore[call-arg]
    with pytest.raises(InvalidMessage, match="Header: frame = 'map': unexpected keyword argument"):
        Header(frame="map")  # type: ignore[call-arg]


def test_long_value_is_shortened_in_the_error() -> None:
    with pytest.raises(InvalidMessage) as rejected:
        Header(frame_id="a" * 10_000 + "\0")
    assert len(str(rejected.value)) < 300
    with pytest.raises(InvalidMessage) as rejected:
        Image(data=np.zeros(100_000, np.uint8))
    assert len(str(rejected.value)) < 300
    assert rejected.value.path == "data"
    assert rejected.value.type_name == "sensor_msgs/msg/Image"


def test_rejection_leaks_no_memory() -> None:
    before = set(map(id, _refusals()))
    for _ in range(10):
        with pytest.raises(InvalidMessage):
            Image(height=1, step=1)
        with pytest.raises(InvalidMessage):
            CameraInfo(roi={"height": "tall"})  # type: ignore[arg-type]
    kept = [refusal for refusal in _refusals() if id(refusal) not in before]
    assert kept == []


def _refusals() -> list[object]:
    gc.collect()
    return [thing for thing in gc.get_objects() if type(thing) in (InvalidMessage, ValidationError)]


def test_float_beyond_float32_is_rejected() -> None:
    with pytest.raises(InvalidMessage, match=words_in_order("range_max = 1e+39", "float32")):
        LaserScan(range_max=1e39)


def test_defaults_are_converted_and_validated() -> None:
    assert Battery(voltage=12.0).good.dtype == np.bool_


def test_users_can_define_messages() -> None:
    battery = Battery(voltage=12.1, cells=[4000, 4100], good=[True, False])  # type: ignore[arg-type]
    assert battery.cells.dtype == np.int16
    with pytest.raises(
        InvalidMessage, match=r"acme_msgs/msg/Battery: voltage = 0\.0: must be above"
    ):
        Battery(voltage=0.0)


@message("acme_msgs/msg/Battery")
class Battery:
    """State of a battery."""

    voltage: Float32
    name: String = ""
    level: UInt8 = 0
    cells: Int16Array = empty("int16")
    good: BoolArray = ()  # type: ignore[assignment]

    def __post_init__(self) -> None:
        """A battery has a voltage."""
        if self.voltage <= 0:
            reject(self, "voltage", self.voltage, "must be above 0")


def test_bool_array_rejects_bytes_other_than_0_and_1() -> None:
    raw = np.array([0, 1, 2], np.uint8).view(np.bool_)
    with pytest.raises(InvalidMessage, match=words_in_order("bytes 0 and 1")):
        Battery(voltage=1.0, good=raw)
