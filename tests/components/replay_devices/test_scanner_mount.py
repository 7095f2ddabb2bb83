"""The scanner's mount is read from a bag: by static transforms, or by the robot's description."""

import math
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from cairn import SECOND
from cairn.components.replay_devices.open_recording import open_recording
from cairn.components.replay_devices.recording import Recording, ScannerMount
from cairn.planar.scans import beams_of
from tests.components.replay_devices.test_ros_bag import (
    BEGIN,
    STORE,
    Messages,
    header,
    odometry,
    of,
    ros2,
    scan,
    transform,
)
from tests.wording import assert_words

pytestmark = pytest.mark.slow

AT = BEGIN * SECOND
Numbers = tuple[float, float, float]
Numbers4 = tuple[float, float, float, float]


def quaternion(roll: float, pitch: float, yaw: float) -> Numbers4:
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def fixed(parent: str, child: str, xyz: Numbers, rpy: Numbers, store: Any = STORE) -> Any:
    x, y, z, w = quaternion(*rpy)
    moved = of(
        store,
        "geometry_msgs/msg/Transform",
        translation=of(store, "geometry_msgs/msg/Vector3", x=xyz[0], y=xyz[1], z=xyz[2]),
        rotation=of(store, "geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
    )
    return of(
        store,
        "geometry_msgs/msg/TransformStamped",
        header=header(BEGIN, parent, store),
        child_frame_id=child,
        transform=moved,
    )


def tf(*transforms: Any) -> Any:
    return of(STORE, "tf2_msgs/msg/TFMessage", transforms=list(transforms))


def opened(tmp_path: Path, *more: tuple[str, Any]) -> Recording:
    messages: Messages = [("/scan", AT, scan(BEGIN)), ("/odom", AT, odometry(BEGIN, 0.0))]
    messages += [(topic, AT, message) for topic, message in more]
    return open_recording(ros2(tmp_path / "bag", messages))


def mount(recording: Recording) -> ScannerMount:
    found = recording.mount()
    assert found is not None
    return found


def test_mount_is_composed_of_static_transforms(tmp_path: Path) -> None:
    column = fixed("/base_link", "column", (0.2, 0.1, 1.0), (0.0, 0.0, math.pi / 2))
    laser = fixed("column", "base_laser", (0.3, 0.0, 0.1), (0.0, 0.0, 0.1))

    found = mount(opened(tmp_path, ("/tf_static", tf(column)), ("/tf_static", tf(laser))))

    assert found.pose == pytest.approx((0.2, 0.4, math.pi / 2 + 0.1), abs=1e-6)
    assert (found.upside_down, found.base, found.source) == (False, "base_link", "/tf_static")


def test_mount_is_on_the_frame_that_odometry_moves(tmp_path: Path) -> None:
    """Here `base_footprint` is the parent of `base_link`, which odometry moves."""
    base = fixed("base_footprint", "base_link", (0.5, 0.0, 0.1), (0.0, 0.0, 0.0))
    laser = fixed("base_link", "base_laser", (0.3, 0.0, 0.1), (0.0, 0.0, 0.0))

    found = mount(opened(tmp_path, ("/robot/tf_static", tf(base, laser))))
    assert found.pose == pytest.approx((0.3, 0.0, 0.0))
    assert found.base == "base_link"

    messages: Messages = [("/scan", AT, scan(BEGIN)), ("/tf_static", AT, tf(base, laser))]
    found = mount(open_recording(ros2(tmp_path / "other", messages)))
    assert found.pose == pytest.approx((0.8, 0.0, 0.0))
    assert found.base == "base_footprint"


def test_scans_of_a_scanner_upside_down_are_mirrored(tmp_path: Path) -> None:
    """The first beam, on the scanner's right, is on the robot's left."""
    laser = fixed("base_link", "base_laser", (0.2, 0.0, 0.1), (math.pi, 0.0, 0.4))

    recording = opened(tmp_path, ("/tf_static", tf(laser)))

    found, scans = mount(recording), recording.scans()
    assert scans is not None
    assert found.upside_down
    assert found.pose == pytest.approx((0.2, 0.0, 0.4), abs=1e-6)
    beams = beams_of(scans.messages[0], found.pose)
    # Angles of the bag's scan are -1.0, -0.5, ... with ranges 1, 2, ...
    assert beams.angles == pytest.approx([1.4, 0.9, 0.4, -0.1, -0.6], abs=1e-6)
    assert beams.ranges[:3] == pytest.approx([1.0, 2.0, 3.0])


def test_scanner_turned_over_by_its_pitch_is_upside_down_and_looks_back(tmp_path: Path) -> None:
    laser = fixed("base_link", "base_laser", (0.2, 0.0, 0.1), (0.0, math.pi, 0.0))

    found = mount(opened(tmp_path, ("/tf_static", tf(laser))))

    assert found.upside_down
    assert abs(found.pose[2]) == pytest.approx(math.pi, abs=1e-5)


def test_tilted_scanner_has_no_mount_in_the_plane_but_a_note(tmp_path: Path) -> None:
    laser = fixed("base_link", "base_laser", (0.2, 0.0, 0.1), (0.0, 0.5, 0.0))

    recording = opened(tmp_path, ("/tf_static", tf(laser)))

    assert recording.mount() is None
    assert_words(" ".join(recording.notes()), "base_laser is tilted by 29 degrees on base_link")


def test_transforms_that_vary_are_no_mount(tmp_path: Path) -> None:
    turned = [fixed("base_link", "base_laser", (0.2, 0, 0), (0, 0, 0.1 * k)) for k in range(3)]

    recording = opened(tmp_path, *[("/tf", tf(one)) for one in turned])

    assert recording.mount() is None


def test_robot_description_gives_the_mount_if_transforms_do_not(tmp_path: Path) -> None:
    urdf = """<?xml version="1.0"?><robot name="r">
      <link name="base_link"/><link name="plate"/><link name="base_laser"/><link name="wheel"/>
      <joint name="a" type="fixed"><parent link="base_link"/><child link="plate"/>
        <origin xyz="0.1 0 0.2"/></joint>
      <joint name="b" type="fixed"><parent link="plate"/><child link="base_laser"/>
        <origin xyz="0.2 0 0.05" rpy="3.14159265 0 0.25"/></joint>
      <joint name="c" type="continuous"><parent link="base_link"/><child link="wheel"/></joint>
    </robot>"""
    described = of(STORE, "std_msgs/msg/String", data=urdf)

    recording = opened(
        tmp_path,
        ("/robot_description", described),
        ("/tf", transform(BEGIN, "odom", "base_link", 1.0)),
    )

    found = mount(recording)
    assert found.pose == pytest.approx((0.3, 0.0, 0.25), abs=1e-6)
    assert (found.upside_down, found.source) == (True, "/robot_description")


def test_damaged_description_is_noted(tmp_path: Path) -> None:
    entity = '<!DOCTYPE r [<!ENTITY a "b">]><robot>&a;</robot>'
    described = of(STORE, "std_msgs/msg/String", data=entity)

    recording = opened(tmp_path, ("/robot_description", described))

    assert recording.mount() is None
    assert_words(" ".join(recording.notes()), "/robot_description", "document type", "name the")


def test_latched_transforms_of_ros1_give_the_mount(tmp_path: Path) -> None:
    """In ROS 1 static transforms are also published again and again on /tf."""
    path = tmp_path / "run.bag"
    kind = "tf2_msgs/msg/TFMessage"
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register({kind: STORE.fielddefs[kind]})
    laser = fixed("base_link", "base_laser", (0.25, 0.0, 0.1), (0.0, 0.0, 0.0), store)
    with Ros1Writer(path) as writer:
        scans = writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=store)
        frames = writer.add_connection("/tf", kind, typestore=store)
        for k in range(3):
            at = (BEGIN + k) * SECOND
            message = scan(BEGIN + k, store)
            writer.write(scans, at, store.serialize_ros1(message, message.__msgtype__).tobytes())
            raw = store.serialize_ros1(store.types[kind](transforms=[laser]), kind)
            writer.write(frames, at, raw.tobytes())

    found = mount(open_recording(path))

    assert found.pose == pytest.approx((0.25, 0.0, 0.0))
    assert found.source == "/tf"


def test_bag_without_transforms_has_no_mount(tmp_path: Path) -> None:
    recording = opened(tmp_path)

    assert recording.mount() is None
    assert list(recording.notes()) == []
