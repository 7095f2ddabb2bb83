"""`cairn recording show` prints and draws the contents of a recording."""

import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cairn import SECOND
from cairn.components.replay_devices.drawing import rough_map
from cairn.components.replay_devices.recording import OdometryStream, ScanStream
from cairn.schemas.sensor_msgs import LaserScan
from tests.commands import cairn
from tests.components.replay_devices.conftest import FR079, LEGS, OLD_BAG, Write, flaser, odom
from tests.components.replay_devices.test_ros_bag import Messages, odometry, ros2, scan
from tests.components.replay_devices.wild_logs import NONE, Defects, office_drive, wild_log
from tests.wording import assert_words

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("file", "count"), [(LEGS, 121), (OLD_BAG, 20)])
def test_bag_of_a_urg_is_shown_with_its_scanner(file: Path, count: int) -> None:
    shown = cairn("recording", "show", str(file), "--json").json

    (stream,) = shown["streams"]
    assert (stream["replayed_as"], stream["topic"]) == ("scan", "/scan")
    assert (stream["type"], stream["count"]) == ("sensor_msgs/msg/LaserScan", count)
    assert stream["rate_hz"] == pytest.approx(10.0, abs=0.1)
    assert stream["span_s"] == pytest.approx((count - 1) / 10.0, abs=0.1)
    assert shown["scanner"]["beams"] == 512
    assert shown["scanner"]["last_deg"] - shown["scanner"]["first_deg"] == pytest.approx(
        179.6, abs=1
    )
    assert shown["scanner"]["range_max_m"] == pytest.approx(5.6)
    assert (shown["odometry"], shown["true_poses"]) == (False, False)


def test_table_names_streams_and_missing_ones() -> None:
    answer = cairn("recording", "show", str(LEGS))

    assert "scan         /scan  sensor_msgs/msg/LaserScan    121     11.96      10.03" in answer.out
    assert "scanner: 179.6 deg (-90.0 to 89.6), 512 beams of 0.352 deg, 0.02 to 5.6 m" in answer.out
    assert "odometry: none\ntrue poses: none\n" in answer.out


@pytest.mark.accuracy
def test_corrected_log_has_odometry_and_true_poses() -> None:
    shown = cairn("recording", "show", str(FR079), "--json").json

    kinds = {row["replayed_as"]: (row["topic"], row["count"]) for row in shown["streams"]}
    assert kinds == {"odom": ("ODOM", 8951), "scan": ("FLASER", 2765), "truth": ("FLASER", 2765)}
    assert (shown["odometry"], shown["true_poses"]) == (True, True)
    assert any("driving backwards" in note for note in shown["notes"])


@pytest.mark.accuracy
def test_data_set_without_scanner_is_shown_and_drawn(dataset: Path, tmp_path: Path) -> None:
    picture = tmp_path / "way.png"

    answer = cairn("recording", "show", str(dataset), "--robot", "2", "--out", str(picture))

    assert "scanner: none\nodometry: yes\ntrue poses: yes\n" in answer.out
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_other_topics_are_counted_and_truth_can_be_named(tmp_path: Path) -> None:
    messages: Messages = [
        ("/scan", SECOND, scan(1.0)),
        ("/odom", SECOND, odometry(1.0, 0.0)),
        ("/mocap", SECOND, odometry(1.0, 0.0)),
    ]
    path = ros2(tmp_path / "run", messages)

    shown = cairn("recording", "show", str(path), "--json").json
    kinds = {row["topic"]: (row["replayed_as"], row["count"]) for row in shown["streams"]}
    assert kinds == {"/mocap": (None, 1), "/odom": ("odom", 1), "/scan": ("scan", 1)}
    assert shown["true_poses"] is False

    shown = cairn("recording", "show", str(path), "--truth", "/mocap", "--json").json
    assert shown["true_poses"] is True


def test_one_of_several_topics_must_be_named(tmp_path: Path) -> None:
    path = ros2(tmp_path / "run", [("/front", SECOND, scan(1.0)), ("/rear", SECOND, scan(1.0))])

    refused = cairn("recording", "show", str(path))
    assert refused.code == 1
    assert "several topics" in refused.err
    assert "--scan" in refused.err
    shown = cairn("recording", "show", str(path), "--scan", "/rear", "--json").json
    kinds = {row["topic"]: row["replayed_as"] for row in shown["streams"]}
    assert kinds == {"/front": None, "/rear": "scan"}


def test_drawing_has_scans_and_with_odometry_a_map(write: Write, tmp_path: Path) -> None:
    log = write(odom(1.0, 0.0), odom(2.0, 0.5), flaser(1.5, 0.25))
    alone, both = tmp_path / "alone.png", tmp_path / "both.png"

    for file, picture in ((LEGS, alone), (log, both)):
        answer = cairn("recording", "show", str(file), "--out", str(picture))
        assert answer.code == 0
        assert f"{picture} written" in answer.err
    one, two = (Image.open(file).size for file in (alone, both))
    assert two[0] > 1.8 * one[0]


def test_scans_are_transformed_by_the_odometry_at_their_time() -> None:
    """A post at (3, 1) is measured between two records of a robot that drives and turns."""
    poses = np.array([[0.0, 1.0, 0.0], [2.0, 1.0, 0.0], [3.0, 0.0, 3.1], [3.0, 0.0, -3.1]])
    odometry = OdometryStream(
        [0, 2 * SECOND, 3 * SECOND, 4 * SECOND], poses, np.zeros(0), np.zeros(0)
    )
    measurements = [
        (0, 0.0, 3.0),
        (1, 0.0, 2.0),
        (2, 0.0, 1.0),
        (3.5, -0.5 * math.pi, 1.0),
        (5, 0.0, 1.0),
    ]
    stamps = [round(at * SECOND) for at, _, _ in measurements]
    scans = ScanStream(
        stamps,
        [
            LaserScan(
                angle_min=bearing, angle_max=bearing + 0.1, angle_increment=0.1, range_min=0.1,
                range_max=9.0, ranges=np.array([meters, math.inf], np.float32),
            )
            for _, bearing, meters in measurements
        ],
        stamps,
    )  # fmt: skip

    points = rough_map(scans, odometry)

    assert points == pytest.approx(np.array([[3.0, 1.0]] * 4), abs=1e-6)  # the last is too late


def test_unwritable_drawing_is_an_error(tmp_path: Path) -> None:
    answer = cairn("recording", "show", str(LEGS), "--out", str(tmp_path / "picture.xyz"))

    assert answer.code == 1
    assert "picture.xyz cannot be written" in answer.err


@pytest.mark.accuracy
def test_mount_and_quality_of_times_are_shown(write: Write) -> None:
    log = write(*wild_log(office_drive(), "FLASER", Defects()).lines)

    answer = cairn("recording", "info", str(log))

    assert (
        "mount: x 0.100 m, y 0.000 m, yaw 0.0 deg on base_link, by FLASER records\n" in answer.out
    )
    assert "yaw by motion: 0.2 deg, standard deviation 0.5 deg\n" in answer.out
    assert "times of scan: 617 records; every 0.200 s, jitter 0.0" in answer.out
    assert_words(
        answer.out, "out of order by up to 0.4", "left out, which contradict the scans",
        "12 gaps, the longest 2.2 s", "40 in bursts", "7 duplicates left out",
        "40 times corrected by up to 0.78",
    )  # fmt: skip
    assert_words(answer.err, "3 of 1872 records are bad", "line 101", "line 1872")
    assert "check the mount" not in answer.err
    shown = cairn("recording", "info", str(log), "--json").json
    assert shown["mount"]["x_m"] == 0.1
    assert shown["mount"]["source"] == "FLASER records"
    assert shown["times"]["scan"]["bursts"] == 40
    assert abs(shown["yaw_by_motion"]["yaw_deg"]) < 1.0


@pytest.mark.accuracy
def test_mount_that_the_motion_contradicts_is_hinted_at(write: Write) -> None:
    drive = office_drive((0.1, 0.0, 1.0))
    log = write(*wild_log(drive, "FLASER", NONE, mount=(0.1, 0.0, 0.0)).lines)

    answer = cairn("recording", "show", str(log))

    assert_words(
        answer.err, "scanner's yaw is 57.", "not 0.0 deg, as by FLASER records", "check the mount"
    )


def test_rough_map_has_the_scans_at_the_mount() -> None:
    stamps = [0, SECOND]
    odometry = OdometryStream(stamps, np.zeros((2, 3)), np.zeros(0), np.zeros(0))
    scan = LaserScan(
        angle_min=0.0, angle_max=0.1, angle_increment=0.1, range_min=0.1, range_max=9.0,
        ranges=np.array([2.0, math.inf], np.float32),
    )  # fmt: skip

    points = rough_map(ScanStream(stamps, [scan] * 2, stamps), odometry, (0.5, 0.0, math.pi / 2))

    assert points == pytest.approx(np.array([[0.5, 2.0]] * 2), abs=1e-6)
