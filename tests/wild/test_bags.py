"""Recordings as other people's programs write them; README.md has the sources of the cases."""

from __future__ import annotations

import copy
import math
import shutil
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode
from rosbags.rosbag2 import Writer as Ros2Writer

from cairn import SECOND
from cairn.components.replay_devices.open_recording import open_recording
from cairn.components.replay_devices.recording import Recording
from cairn.components.replay_devices.ros_bag import BagRecording
from cairn.components.slam.mapping import Mapper
from cairn.errors import RecordingError
from cairn.planar.scans import Rays, beams_of
from tests.components.replay_devices.test_ros_bag import (
    BEGIN,
    ROS1,
    STORE,
    drive,
    of,
    ros2,
    scan,
    transform,
)
from tests.wording import assert_words

MIDDLE = (0.0, 0.0, 0.0)


def counts(recording: Recording) -> tuple[int, int]:
    """Return the numbers of scans and of poses of odometry."""
    scans, wheels = recording.scans(), recording.odometry()
    return len(scans.stamps) if scans else 0, len(wheels.stamps) if wheels else 0


def notes(recording: Recording) -> str:
    return " ".join(recording.notes())


def mcap(
    path: Path, messages: list[tuple[str, int, Any]], encoding: str = "cdr", **times: int
) -> Path:
    """Write an MCAP file with type names as in ROS 1, in either encoding."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channels: dict[str, int] = {}
        for topic, received, message in messages:
            kind = message.__msgtype__
            if topic not in channels:
                name, schema = kind.replace("/msg/", "/"), writer.register_schema
                number = schema(name, "ros1msg" if encoding == "ros1" else "ros2msg", b"")
                channels[topic] = writer.register_channel(topic, encoding, number)
            data = STORE.serialize_cdr(message, kind)
            if encoding == "ros1":
                data = ROS1.serialize_ros1(message, kind)
            at = times.get("log_time", received)
            writer.add_message(channels[topic], at, data.tobytes(), received)
        writer.finish()
    return path


def as_ros1(message: Any) -> Any:
    """Return a scan with the header of ROS 1."""
    stamp = message.header.stamp
    made = copy.copy(message)
    made.header = of(
        ROS1, "std_msgs/msg/Header", seq=0, frame_id="laser",
        stamp=of(ROS1, "builtin_interfaces/msg/Time", sec=stamp.sec, nanosec=stamp.nanosec),
    )  # fmt: skip
    return made


def test_scans_without_ranges_are_left_out(tmp_path: Path) -> None:
    lines = drive(8)
    for _, _, message in lines[1:12:2]:
        message.ranges = np.zeros(0, np.float32)

    recording = open_recording(ros2(tmp_path / "bag", lines))

    assert counts(recording) == (2, 8)
    assert_words(notes(recording), "6 of 8 messages of /scan are left out", "no ranges")


def test_map_can_start_with_a_scan_without_beams() -> None:
    none = np.zeros(0)
    mapper = Mapper(10.0)

    mapper.add_scan(0, MIDDLE, Rays(np.zeros((0, 2)), none, none, 10.0))
    mapper.add_scan(SECOND, MIDDLE, Rays(np.zeros((0, 2)), none, none, 10.0))
    mapper.finish()

    assert mapper.poses().tolist() == [[0.0] * 3] * 2


def test_range_of_zero_is_no_obstacle_on_the_scanner(tmp_path: Path) -> None:
    lines = drive(3)
    for _, _, message in lines[1::2]:
        message.range_min, message.ranges[:2] = 0.0, 0.0

    scans = open_recording(ros2(tmp_path / "bag", lines)).scans()

    assert scans is not None
    assert np.isnan(beams_of(scans.messages[0], MIDDLE).ranges[:2]).all()


def test_time_between_beams_in_nanoseconds_is_not_used(tmp_path: Path) -> None:
    lines = drive(3)
    for _, _, message in lines[1::2]:
        message.time_increment = 153333.3

    recording = open_recording(ros2(tmp_path / "bag", lines))

    scans = recording.scans()
    assert scans is not None
    assert {one.time_increment for one in scans.messages} == {0.0}
    assert "3 of 3 scans are repaired: time_increment makes a sweep longer" in notes(recording)


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0, 0.0), (0.0, 0.0, math.nan, 1.0)])
def test_transform_without_a_rotation_is_no_odometry(
    tmp_path: Path, rotation: tuple[float, ...]
) -> None:
    at = [("/tf", (BEGIN + k) * SECOND, transform(BEGIN + k, "odom", "base_link", 0.1 * k))
          for k in range(5)]  # fmt: skip
    turn = at[2][2].transforms[0].transform.rotation
    turn.x, turn.y, turn.z, turn.w = rotation

    recording = open_recording(ros2(tmp_path / "bag", at))

    assert counts(recording) == (0, 4)
    assert "1 of 5 messages of /tf are invalid and left out" in notes(recording)


@pytest.mark.parametrize("received", [True, False], ids=["with", "without"])
def test_single_stamp_of_0_does_not_make_a_recording_of_decades(
    tmp_path: Path, received: bool
) -> None:
    lines = drive(40)
    lines[1][2].header.stamp.sec = 0
    if not received:  # as of a recorder that waits for simulated time
        lines[1] = ("/scan", 0, lines[1][2])

    recording = open_recording(ros2(tmp_path / "bag", lines))

    begin, end = recording.span()
    assert (end - begin) / SECOND == pytest.approx(3.9)
    assert counts(recording)[0] == (40 if received else 39)
    said = "1 stamps on /scan are wrong" if received else "1 of 40 messages of /scan are left out"
    assert said in notes(recording)


def test_stamps_are_kept_where_there_are_no_times_of_receipt(tmp_path: Path) -> None:
    recording = open_recording(mcap(tmp_path / "run.mcap", drive(5), log_time=0))

    begin, end = recording.span()
    assert begin == BEGIN * SECOND
    assert (end - begin) / SECOND == pytest.approx(0.4)
    assert "have no times of receipt: their stamps are used" in notes(recording)


def test_recording_of_a_simulation_has_the_speed_of_the_robot(tmp_path: Path) -> None:
    slow = [(topic, BEGIN * SECOND * 2 + 4 * (at - BEGIN * SECOND), m) for topic, at, m in drive(9)]

    recording = open_recording(ros2(tmp_path / "bag", slow))

    begin, end = recording.span()
    assert (end - begin) / SECOND == pytest.approx(0.8)
    assert "from one clock, another one than the bag's: kept" in notes(recording)


@pytest.mark.parametrize("encoding", ["cdr", "ros1"])
def test_mcap_files_have_types_by_their_ros1_names_too(tmp_path: Path, encoding: str) -> None:
    lines = [(t, at, m) for t, at, m in drive(5) if t == "/scan"]
    if encoding == "ros1":
        lines = [(t, at, as_ros1(m)) for t, at, m in lines]

    recording = open_recording(mcap(tmp_path / "run.mcap", lines, encoding))

    assert counts(recording) == (5, 0)


def test_databases_of_a_killed_recorder_are_read_without_metadata(tmp_path: Path) -> None:
    bag = ros2(tmp_path / "bag", drive(5))
    (bag / "metadata.yaml").unlink()

    assert counts(open_recording(bag)) == (5, 5)


def test_missing_file_of_a_bag_is_named_and_the_others_are_read(tmp_path: Path) -> None:
    bag = ros2(tmp_path / "bag", drive(5))
    described = bag / "metadata.yaml"
    text = described.read_text()
    file = next(bag.glob("*.db3"))
    more = text.replace(f"- {file.name}\n", f"- bag_9.db3\n  - {file.name}\n", 1)
    assert more != text
    described.write_text(more)

    recording = open_recording(bag)

    assert counts(recording) == (5, 5)
    assert "the file bag_9.db3 that metadata.yaml names is missing" in notes(recording)
    file.rename(bag / "renamed.db3")
    assert counts(open_recording(bag)) == (5, 5)
    (bag / "renamed.db3").unlink()
    with pytest.raises(RecordingError, match=r"the file bag_9.db3 that metadata.yaml names"):
        open_recording(bag)


def test_messages_in_the_log_beside_a_database_are_read(tmp_path: Path) -> None:
    lines = drive(10)
    bag = ros2(tmp_path / "bag", lines[:10])
    file = next(bag.glob("*.db3"))
    with sqlite3.connect(file, isolation_level=None) as connection:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.execute("PRAGMA wal_autocheckpoint = 0")
        for topic, received, message in lines[10:]:
            connection.execute(
                "INSERT INTO messages (topic_id, timestamp, data) VALUES "
                "((SELECT id FROM topics WHERE name = ?), ?, ?)",
                (topic, received, STORE.serialize_cdr(message, message.__msgtype__).tobytes()),
            )
        left = tmp_path / "left"
        left.mkdir()
        for suffix in ("", "-wal"):
            shutil.copyfile(f"{file}{suffix}", left / f"run.db3{suffix}")
    connection.close()
    before = sorted((one.name, one.stat().st_size) for one in left.iterdir())

    assert counts(open_recording(left / "run.db3")) == (10, 10)
    assert sorted((one.name, one.stat().st_size) for one in left.iterdir()) == before


def test_database_of_compressed_messages_is_read_without_its_folder(tmp_path: Path) -> None:
    writer = Ros2Writer(tmp_path / "bag", version=9)
    writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    with writer:
        topic = writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=STORE)
        for k in range(5):
            raw = STORE.serialize_cdr(scan(BEGIN + k), "sensor_msgs/msg/LaserScan")
            writer.write(topic, (BEGIN + k) * SECOND, raw.tobytes())

    assert counts(open_recording(tmp_path / "bag")) == (5, 0)
    assert counts(open_recording(next((tmp_path / "bag").glob("*.db3")))) == (5, 0)


def test_message_that_cannot_be_decoded_is_left_out(tmp_path: Path) -> None:
    bag = ros2(tmp_path / "bag", drive(5))
    with sqlite3.connect(next(bag.glob("*.db3"))) as connection:
        connection.execute("UPDATE messages SET data = x'' WHERE id = 4")
    connection.close()

    recording = open_recording(bag)

    assert counts(recording) == (4, 5)
    assert "a message of /scan is damaged" in notes(recording)


def test_variances_of_minus_1_and_velocities_of_0_are_replaced(tmp_path: Path) -> None:
    lines = drive(30)
    for _, _, message in lines[::2]:
        message.pose.covariance = np.full(36, -1.0)
        message.twist.twist.linear.x = 0.0

    recording = open_recording(ros2(tmp_path / "bag", lines))

    wheels = recording.odometry()
    assert wheels is not None
    assert (np.diagonal(wheels.covariances, axis1=1, axis2=2) >= 0.0).all()
    assert wheels.twists[5, 0] == pytest.approx(math.cos(0.3))
    assert "velocities are computed from the poses" in notes(recording)


def test_several_cameras_alone_are_named(tmp_path: Path) -> None:
    image = of(
        STORE, "sensor_msgs/msg/Image", header=scan(BEGIN).header, height=1, width=1,
        encoding="mono8", is_bigendian=0, step=1, data=np.zeros(1, np.uint8),
    )  # fmt: skip
    lines = [(topic, BEGIN * SECOND, image) for topic in ("/front/image_raw", "/depth/image_raw")]

    with pytest.raises(RecordingError, match=r"only images, and .*topics.left_image"):
        BagRecording(ros2(tmp_path / "bag", lines), {})


def test_nearest_echoes_are_replayed_as_a_scan(tmp_path: Path) -> None:
    echo = STORE.types["sensor_msgs/msg/LaserEcho"]
    one = scan(BEGIN)
    fields = {
        name: getattr(one, name)
        for name in ("header", "angle_min", "angle_max", "angle_increment", "time_increment",
                     "scan_time", "range_min", "range_max")
    }  # fmt: skip
    ranges = [echo(np.array(echoes, np.float32)) for echoes in ([1, 4], [2], [], [3], [1])]
    message = of(
        STORE, "sensor_msgs/msg/MultiEchoLaserScan", **fields, ranges=ranges, intensities=[]
    )

    scans = open_recording(ros2(tmp_path / "bag", [("/echoes", BEGIN * SECOND, message)])).scans()

    assert scans is not None
    assert scans.messages[0].ranges.tolist() == [1.0, 2.0, math.inf, 3.0, 1.0]
