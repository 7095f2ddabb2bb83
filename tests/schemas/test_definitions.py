"""The definition text and type hash of a message class equal those of ROS 2."""

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from cairn.bus.type_hash import definition, type_hash
from cairn.schemas.cairn_msgs import ObjectEvidence
from cairn.schemas.diagnostic_msgs import DiagnosticStatus
from cairn.schemas.geometry_msgs import PoseArray, PoseStamped, PoseWithCovarianceStamped, Twist
from cairn.schemas.nav_msgs import OccupancyGrid, Odometry, Path
from cairn.schemas.sensor_msgs import Image, LaserScan
from cairn.schemas.std_msgs import String
from tests.schemas.arbitrary import EVERY_MESSAGE, OF_ROS_2

ROS = get_typestore(Stores.ROS2_JAZZY)


@pytest.mark.parametrize("name", OF_ROS_2)
def test_standard_messages_are_defined_as_in_ros_2_jazzy(name: str) -> None:
    cls = EVERY_MESSAGE[name]
    assert type_hash(cls) == ROS.hash_rihs01(name)
    assert definition(cls) == ROS.generate_msgdef(name, ros_version=2)[0]


@pytest.mark.parametrize(
    ("cls", "digest"),
    [
        (String, "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"),
        (LaserScan, "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828"),
        (Image, "d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"),
        (Odometry, "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"),
        (OccupancyGrid, "8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7"),
        (Path, "1957a5bb3cee5da65c4e52e52b65a93df227efce4c20f8458b36e73066ca334b"),
        (PoseStamped, "10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8"),
    ],
)
def test_type_hash_equals_that_of_ros_2_nodes(cls: type, digest: str) -> None:
    assert type_hash(cls) == f"RIHS01_{digest}"


def test_type_hash_of_twist() -> None:
    assert type_hash(Twist).startswith("RIHS01_9c45bf16fe09")
    assert type_hash(Twist).endswith("fb8d2a")


@pytest.mark.parametrize("name", EVERY_MESSAGE)
def test_another_tool_parses_the_definition_text_to_the_same_type(name: str) -> None:
    text, *parts = definition(EVERY_MESSAGE[name]).split("=" * 80 + "\n")
    store = Typestore()
    types = get_types_from_msg(text, name)
    for part in parts:
        head, _, body = part.partition("\n")
        types |= get_types_from_msg(body, head.removeprefix("MSG: ").replace("/", "/msg/"))
    store.register(types)
    assert store.hash_rihs01(name) == type_hash(EVERY_MESSAGE[name])


def test_packed_sequence_has_the_definition_of_a_plain_one() -> None:
    assert definition(PoseArray).startswith("std_msgs/Header header\ngeometry_msgs/Pose[] poses\n")


def test_definition_contains_array_lengths_and_constants() -> None:
    text = definition(PoseWithCovarianceStamped)
    assert "geometry_msgs/Pose pose\nfloat64[36] covariance\n" in text
    assert definition(DiagnosticStatus).startswith("byte OK=0\nbyte WARN=1\n")
    assert "uint8 NOT_CONVERGED=3\n" in definition(ObjectEvidence)
