"""`cairn recording info` of an MCAP recording shows the mount with which a map is built."""

import math
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag2 import StoragePlugin

from cairn import SECOND
from cairn.components.replay_devices import recorded_frames
from cairn.components.replay_devices.open_recording import open_recording
from cairn.components.replay_devices.recorded_frames import read_frames
from cairn.recording.reader import McapRecording
from tests.commands import cairn
from tests.components.replay_devices.test_ros_bag import (
    BEGIN,
    STORE,
    Messages,
    odometry,
    of,
    ros2,
    scan,
)
from tests.components.replay_devices.test_scanner_mount import fixed, tf
from tests.wording import assert_words

pytestmark = pytest.mark.slow

AT = BEGIN * SECOND
URDF = """<robot name="r"><link name="base_link"/><link name="base_laser"/>
  <joint name="b" type="fixed"><parent link="base_link"/>
  <child link="base_laser"/><origin xyz="0.2 0 0.05" rpy="3.14159265 0 0.25"/></joint></robot>"""
DESCRIBED = of(STORE, "std_msgs/msg/String", data=URDF)
TILTED = tf(fixed("base_link", "base_laser", (0.2, 0.0, 0.1), (0.0, 0.8, 0.0)))
COLUMN = tf(fixed("base_link", "column", (0.2, 0.1, 1.0), (0.0, 0.0, math.pi / 2)))
ON_COLUMN = tf(fixed("column", "/base_laser", (0.3, 0.0, 0.1), (0.0, 0.0, 0.1)))


def bag(folder: Path, *more: tuple[str, Any]) -> Path:
    """A ROS 2 bag of MCAP with a scan, odometry and more."""
    messages: Messages = [("/scan", AT, scan(BEGIN)), ("/odom", AT, odometry(BEGIN, 0.0))]
    messages += [(topic, AT + k, message) for k, (topic, message) in enumerate(more)]
    return ros2(folder / "bag", messages, StoragePlugin.MCAP)


@pytest.mark.parametrize(
    "more",
    [
        [("/tf_static", COLUMN), ("/tf_static", ON_COLUMN)],
        [("/robot_description", DESCRIBED)],
        [("/robot_description", DESCRIBED), ("/robot/tf_static", COLUMN)],
        [("/tf_static", COLUMN)],
        [("/tf_static", TILTED)],
        [],
    ],
)
def test_info_shows_the_mount_that_the_whole_recording_gives(
    tmp_path: Path, more: list[tuple[str, Any]]
) -> None:
    path = bag(tmp_path, *more)
    whole = open_recording(path)

    with McapRecording(path) as recording:
        frames = read_frames(recording)

    assert frames.mount == whole.mount()
    assert frames.scanner == "base_laser"
    assert frames.odometry == ("base_link", "odom")
    scans = whole.scans()
    assert scans is not None
    assert frames.scan is not None
    assert frames.scan.angle_min == scans.messages[0].angle_min  # mirrored, if it is upside down
    assert frames.notes == list(whole.notes())


def test_mount_and_frames_are_printed(tmp_path: Path) -> None:
    path = bag(tmp_path, ("/tf_static", COLUMN), ("/tf_static", ON_COLUMN))

    out = cairn("recording", "info", str(path)).out

    assert "scanner: 114.6 deg" in out
    assert "frame base_laser on /scan\n" in out
    assert "mount: x 0.200 m, y 0.400 m, yaw 95.7 deg on base_link, by /tf_static\n" in out
    assert "odometry: frame base_link in odom\n" in out
    assert "frames: column on base_link (0.2, 0.1, 1) m, base_laser on column (0.3" in out
    values = cairn("recording", "info", str(path), "--json").json
    assert values["mount"]["y_m"] == pytest.approx(0.4)
    assert [one["frame"] for one in values["frames"]] == ["column", "base_laser"]


def test_scans_of_several_robots_have_no_mount_but_a_note(tmp_path: Path) -> None:
    messages: Messages = [("/a/scan", AT, scan(BEGIN)), ("/b/scan", AT, scan(BEGIN))]
    path = ros2(tmp_path / "bag", messages, StoragePlugin.MCAP)

    answer = cairn("recording", "info", str(path))

    assert "mount" not in answer.out
    assert_words(answer.err, "/a/scan, /b/scan", "--scan")


def test_damaged_transform_is_noted(tmp_path: Path) -> None:
    path = bag(tmp_path, ("/tf_static", COLUMN))
    (file,) = path.glob("*.mcap")
    data = file.read_bytes()
    assert data.count(b"\x07\x00\x00\x00column\x00") == 1
    file.write_bytes(data.replace(b"\x07\x00\x00\x00column\x00", b"\xff\xff\xff\x7fcolumn\x00"))

    answer = cairn("recording", "info", str(path))

    assert answer.code == 0
    assert "mount: neither in tf_static nor described" in answer.out
    assert_words(answer.err, "/tf_static", "cannot be read")


def test_reading_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorded_frames, "_MOST_MESSAGES", 1)
    path = bag(tmp_path, ("/tf_static", COLUMN), ("/tf_static", ON_COLUMN))

    with McapRecording(path) as recording:
        frames = read_frames(recording)

    assert [link.child for link in frames.links] == ["column"]
    assert_words(" ".join(frames.notes), "only the first 1 messages of /tf_static", "show")
