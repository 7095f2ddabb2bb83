"""Bags of ROS 1 and ROS 2: their streams, and the recovery of damaged ones."""

import math
import struct
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore

from cairn import SECOND, to_ns
from cairn.components.replay_devices.bag_files import BagFile
from cairn.components.replay_devices.open_recording import open_recording
from cairn.components.replay_devices.ros_bag import BagRecording
from cairn.errors import RecordingError
from tests.components.replay_devices.conftest import LEGS, OLD_BAG
from tests.patience import LIMIT_S
from tests.wording import assert_words, words_in_order

STORE = get_typestore(Stores.ROS2_HUMBLE)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
BEGIN = 1_700_000_000

Messages = list[tuple[str, int, Any]]


def of(store: Any, name: str, **fields: Any) -> Any:
    return store.types[name](**fields)


def header(t: float, frame: str, store: Any = STORE) -> Any:
    seconds, rest = divmod(round(t * SECOND), SECOND)
    stamp = of(store, "builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
    more = {} if store is STORE else {"seq": 0}
    return of(store, "std_msgs/msg/Header", stamp=stamp, frame_id=frame, **more)


def scan(t: float, store: Any = STORE, **fields: Any) -> Any:
    values = {
        "angle_min": -1.0, "angle_max": 1.0, "angle_increment": 0.5, "time_increment": 0.0,
        "scan_time": 0.1, "range_min": 0.1, "range_max": 5.0,
        "ranges": np.array([1, 2, 3, math.inf, math.nan], np.float32),
        "intensities": np.zeros(0, np.float32),
    }  # fmt: skip
    return of(
        store,
        "sensor_msgs/msg/LaserScan",
        header=header(t, "base_laser", store),
        **(values | fields),
    )


def pose(x: float, yaw: float) -> Any:
    turn = of(
        STORE, "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(yaw / 2),
        w=math.cos(yaw / 2),
    )  # fmt: skip
    place = of(STORE, "geometry_msgs/msg/Point", x=x, y=0.0, z=0.0)
    return of(STORE, "geometry_msgs/msg/Pose", position=place, orientation=turn)


def odometry(t: float, x: float, variance: float = 0.0) -> Any:
    vector = STORE.types["geometry_msgs/msg/Vector3"]
    twist = of(
        STORE, "geometry_msgs/msg/Twist", linear=vector(0.5, 0.0, 0.0),
        angular=vector(0.0, 0.0, 0.1),
    )  # fmt: skip
    covariance = np.diag([variance] * 6).ravel()
    return of(
        STORE, "nav_msgs/msg/Odometry", header=header(t, "odom"), child_frame_id="base_link",
        pose=of(
            STORE, "geometry_msgs/msg/PoseWithCovariance", pose=pose(x, 0.3), covariance=covariance
        ),
        twist=of(
            STORE, "geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)
        ),
    )  # fmt: skip


def transform(t: float, parent: str, child: str, x: float) -> Any:
    vector = STORE.types["geometry_msgs/msg/Vector3"](x, 0.0, 0.0)
    turn = of(STORE, "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0)
    moved = of(STORE, "geometry_msgs/msg/Transform", translation=vector, rotation=turn)
    one = of(
        STORE, "geometry_msgs/msg/TransformStamped", header=header(t, parent),
        child_frame_id=child, transform=moved,
    )  # fmt: skip
    return of(STORE, "tf2_msgs/msg/TFMessage", transforms=[one])


def ros2(folder: Path, messages: Messages, plugin: StoragePlugin = StoragePlugin.SQLITE3) -> Path:
    with Ros2Writer(folder, version=9, storage_plugin=plugin) as writer:
        known: dict[str, Any] = {}
        for topic, received, message in messages:
            kind = message.__msgtype__
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(known[topic], received, STORE.serialize_cdr(message, kind).tobytes())
    return folder


def ros1(path: Path, scans: int) -> Path:
    with Ros1Writer(path) as writer:
        connection = writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=ROS1)
        for k in range(scans):
            message = scan(BEGIN + k, ROS1)
            raw = ROS1.serialize_ros1(message, message.__msgtype__)
            writer.write(connection, (BEGIN + k) * SECOND, raw.tobytes())
    return path


def drive(count: int = 5) -> Messages:
    messages: Messages = []
    for k in range(count):
        at = BEGIN + k / 10
        messages.append(("/odom", round(at * SECOND), odometry(at, 0.1 * k, variance=0.01 * k)))
        messages.append(("/scan", round(at * SECOND), scan(at)))
    return messages


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_ros2_bag_gives_scans_and_odometry(tmp_path: Path, plugin: StoragePlugin) -> None:
    recording = open_recording(ros2(tmp_path / "bag", drive(), plugin))

    scans, wheels = recording.scans(), recording.odometry()
    assert scans is not None
    assert wheels is not None
    first = scans.messages[0]
    assert first.header.frame_id == "laser"
    assert [to_ns(m.header.stamp) for m in scans.messages] == scans.stamps == wheels.stamps
    assert first.ranges.tolist() == pytest.approx([1, 2, 3, math.inf, math.nan], nan_ok=True)
    assert wheels.poses[3] == pytest.approx([0.3, 0.0, 0.3])
    assert wheels.twists[3].tolist() == [0.5, 0.1]
    assert wheels.covariances[3] == pytest.approx(np.diag([0.03] * 3))
    assert recording.span() == (scans.stamps[0], scans.stamps[-1])
    assert recording.truth() is None
    assert list(recording.notes()) == []


@pytest.mark.parametrize(
    ("plugin", "suffix"), [(StoragePlugin.MCAP, ".mcap"), (StoragePlugin.SQLITE3, ".db3")]
)
def test_file_of_a_bag_without_its_folder_is_read(
    tmp_path: Path, plugin: StoragePlugin, suffix: str
) -> None:
    (file,) = ros2(tmp_path / "bag", drive(), plugin).glob(f"*{suffix}")
    bare = file.rename(tmp_path / f"alone{suffix}")

    scans = open_recording(bare).scans()

    assert scans is not None
    assert len(scans.stamps) == 5


def test_reading_that_is_given_up_can_be_closed_on_another_thread(tmp_path: Path) -> None:
    bag = BagFile(ros2(tmp_path / "bag", drive(), StoragePlugin.SQLITE3))
    messages: Any = bag.messages(lambda _: True)
    next(messages)

    with ThreadPoolExecutor(1) as pool:  # as the garbage collector does
        assert pool.submit(messages.close).exception(timeout=LIMIT_S) is None


def test_ros1_bag_is_read(tmp_path: Path) -> None:
    recording = open_recording(ros1(tmp_path / "run.bag", 3))

    scans = recording.scans()
    assert scans is not None
    assert scans.stamps == [(BEGIN + k) * SECOND for k in range(3)]
    assert recording.odometry() is None
    assert list(recording.notes()) == []


def test_real_compressed_ros1_bag_is_read() -> None:
    scans = open_recording(LEGS).scans()

    assert scans is not None
    assert len(scans.stamps) == 121
    assert scans.messages[0].ranges.size == 512
    assert np.diff(scans.stamps) / SECOND == pytest.approx(np.full(120, 0.1), abs=0.01)


def test_bag_of_the_old_format_is_read_in_sequence() -> None:
    recording = open_recording(OLD_BAG)

    scans = recording.scans()
    assert scans is not None
    assert len(scans.stamps) == 20
    assert list(recording.notes()) == []


def test_ros1_bag_with_a_broken_index_is_read_with_a_note(tmp_path: Path) -> None:
    """As in a bag of scan_tools: the record behind the first chunk claims a wrong length."""
    path = tmp_path / "broken.bag"
    with Ros1Writer(path) as writer:
        writer.chunk_threshold = 1
        connection = writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=ROS1)
        for k in range(4):
            message = scan(BEGIN + k, ROS1)
            raw = ROS1.serialize_ros1(message, message.__msgtype__)
            writer.write(connection, (BEGIN + k) * SECOND, raw.tobytes())
    data = bytearray(path.read_bytes())
    index = data.find(b"op=\x04", data.find(b"op=\x05"))
    length = data.find(struct.pack("<I", 12), index)
    data[length : length + 4] = struct.pack("<I", 1 << 30)
    path.write_bytes(data)

    recording = open_recording(path)

    scans = recording.scans()
    assert scans is not None
    assert len(scans.stamps) == 4
    notes = " ".join(recording.notes())
    assert "bytes from byte" in notes


def test_cut_off_ros1_bag_gives_its_whole_messages(tmp_path: Path) -> None:
    path = tmp_path / "cut.bag"
    with Ros1Writer(path) as writer:
        writer.chunk_threshold = 1
        connection = writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=ROS1)
        for k in range(4):
            message = scan(BEGIN + k, ROS1)
            raw = ROS1.serialize_ros1(message, message.__msgtype__)
            writer.write(connection, (BEGIN + k) * SECOND, raw.tobytes())
    data = path.read_bytes()
    chunks = [k for k in range(len(data)) if data.startswith(b"op=\x05", k)]
    path.write_bytes(data[: chunks[2] + 100])

    recording = open_recording(path)

    scans = recording.scans()
    assert scans is not None
    assert len(scans.stamps) == 2
    assert any("are damaged" in note for note in recording.notes())


@pytest.mark.parametrize("compression", [None, Ros1Writer.CompressionFormat.LZ4])
def test_what_a_chunk_that_was_cut_off_still_holds_is_read(
    tmp_path: Path, compression: Ros1Writer.CompressionFormat | None
) -> None:
    path = tmp_path / "cut.bag"
    random = np.random.default_rng(1)
    writer = Ros1Writer(path)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        writer.chunk_threshold = 1 << 30
        connection = writer.add_connection("/scan", "sensor_msgs/msg/LaserScan", typestore=ROS1)
        for k in range(400):
            ranges = random.uniform(1.0, 2.0, 720).astype(np.float32)
            message = scan(BEGIN + k, ROS1, angle_increment=2.0 / 719, ranges=ranges)
            raw = ROS1.serialize_ros1(message, message.__msgtype__)
            writer.write(connection, (BEGIN + k) * SECOND, raw.tobytes())
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])

    recording = open_recording(path)

    scans = recording.scans()
    assert scans is not None
    assert 150 < len(scans.stamps) < 210
    assert_words(" ".join(recording.notes()), "the chunk at byte", "is cut off")


def test_ros1_bag_without_readable_messages_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "wrong.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + bytes(2000))

    with pytest.raises(RecordingError, match=r"wrong.bag .* no message .* `rosbag reindex`"):
        open_recording(path)


def test_cut_off_mcap_file_is_read_up_to_there_with_a_note(tmp_path: Path) -> None:
    with (tmp_path / "cut.mcap").open("wb") as stream:
        writer = Writer(stream, chunk_size=1)
        writer.start("ros2", "test")
        schema = writer.register_schema("sensor_msgs/msg/LaserScan", "ros2msg", b"")
        channel = writer.register_channel("/scan", "cdr", schema)
        for k in range(4):
            message = scan(BEGIN + k)
            raw = STORE.serialize_cdr(message, message.__msgtype__).tobytes()
            writer.add_message(channel, (BEGIN + k) * SECOND, raw, (BEGIN + k) * SECOND)
    whole = (tmp_path / "cut.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[:-100])

    recording = open_recording(tmp_path / "cut.mcap")

    scans = recording.scans()
    assert scans is not None
    assert len(scans.stamps) == 3
    assert any("cut off at byte" in note for note in recording.notes())


def test_whole_mcap_file_without_messages_is_not_called_damaged(tmp_path: Path) -> None:
    with (tmp_path / "empty.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        writer.finish()

    with pytest.raises(RecordingError, match=r"empty.mcap holds no message: nothing was recorded$"):
        open_recording(tmp_path / "empty.mcap")


def test_mcap_file_without_readable_messages_is_rejected_with_a_remedy(tmp_path: Path) -> None:
    (file,) = ros2(tmp_path / "bag", drive(), StoragePlugin.MCAP).glob("*.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(file.read_bytes()[:1000])

    with pytest.raises(
        RecordingError,
        match=r"cut.mcap cannot be read .*cut off at byte .* `mcap recover cut.mcap`",
    ):
        open_recording(cut)


def test_mcap_file_with_another_suffix_is_read(tmp_path: Path) -> None:
    (file,) = ros2(tmp_path / "bag", drive(), StoragePlugin.MCAP).glob("*.mcap")

    scans = open_recording(file.rename(tmp_path / "run.bin")).scans()

    assert scans is not None
    assert len(scans.stamps) == 5


def test_ros1_bag_with_another_suffix_is_read(tmp_path: Path) -> None:
    path = ros1(tmp_path / "run.bag", 2).rename(tmp_path / "recording")

    scans = open_recording(path).scans()

    assert scans is not None
    assert len(scans.stamps) == 2


def test_odometry_is_computed_from_transforms_without_an_odometry_topic(tmp_path: Path) -> None:
    messages: Messages = []
    for k in range(5):
        at = BEGIN + k
        messages.append(("/scan", at * SECOND, scan(at)))
        messages.append(("/tf", at * SECOND, transform(at, "odom", "base_footprint", 0.2 * k)))
        messages.append(("/tf", at * SECOND, transform(at, "map", "odom", 7.0)))

    recording = open_recording(ros2(tmp_path / "bag", messages))

    wheels = recording.odometry()
    assert wheels is not None
    assert wheels.poses[:, 0] == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8])
    assert wheels.twists[1:, 0] == pytest.approx(np.full(4, 0.2))
    assert any("from the transforms" in note for note in recording.notes())


def test_true_poses_are_those_of_the_named_topic(tmp_path: Path) -> None:
    true = of(
        STORE, "geometry_msgs/msg/PoseStamped", header=header(BEGIN, "map"), pose=pose(3.0, 1.0)
    )
    bag = ros2(tmp_path / "bag", [*drive(), ("/mocap", BEGIN * SECOND, true)])

    truth = open_recording(bag, topics={"truth": "mocap"}).truth()

    assert truth is not None
    assert truth.poses[0] == pytest.approx([3.0, 0.0, 1.0])


def test_one_of_several_scanners_must_be_named(tmp_path: Path) -> None:
    at = BEGIN * SECOND
    bag = ros2(tmp_path / "bag", [("/front", at, scan(BEGIN)), ("/rear", at, scan(BEGIN))])

    with pytest.raises(RecordingError, match=r"several topics .* /front, /rear.* topics.scan"):
        open_recording(bag)
    with pytest.raises(
        RecordingError, match=words_in_order("topics.scan = /left", "/front, /rear")
    ):
        open_recording(bag, topics={"scan": "left"})
    scans = open_recording(bag, topics={"scan": "/rear"}).scans()
    assert scans is not None
    assert len(scans.stamps) == 1


def test_stamps_of_another_clock_are_replaced_by_times_of_receipt(tmp_path: Path) -> None:
    messages: Messages = [("/scan", (BEGIN + k) * SECOND, scan(5 + k)) for k in range(3)]

    recording = open_recording(ros2(tmp_path / "bag", messages))

    scans = recording.scans()
    assert scans is not None
    assert scans.stamps == [(BEGIN + k) * SECOND for k in range(3)]
    assert any("from another clock" in note for note in recording.notes())


def test_scan_delay_is_subtracted_from_the_stamps_of_a_bag(tmp_path: Path) -> None:
    bag = ros2(tmp_path / "bag", drive())

    late, own = open_recording(bag).scans(), open_recording(bag, scan_delay_s=0.25).scans()

    assert late is not None
    assert own is not None
    assert [a - b for a, b in zip(late.stamps, own.stamps, strict=True)] == [SECOND // 4] * 5
    assert to_ns(own.messages[0].header.stamp) == own.stamps[0]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"angle_increment": 57.3}, "angle_increment = 57.* not in degrees"),
        ({"angle_max": -1.0, "angle_increment": 0.0}, "its beams have one direction"),
    ],
)
def test_few_invalid_scans_are_left_out_and_many_rejected_with_topic_and_number(
    tmp_path: Path, fields: dict[str, float], message: str
) -> None:
    def bag(bad: int) -> Path:
        scans = [scan(BEGIN), *[scan(BEGIN + 1 + k, **fields) for k in range(bad)]]
        at = [("/scan", (BEGIN + k) * SECOND, m) for k, m in enumerate(scans)]
        return ros2(tmp_path / f"bag{bad}", at)

    few = open_recording(bag(3))
    scans = few.scans()
    assert scans is not None
    assert len(scans.stamps) == 1
    assert_words(" ".join(few.notes()), "3 of 4 messages of /scan are invalid", "message 2")
    with pytest.raises(RecordingError, match=rf"topic /scan: message 2: .*{message}.*4 of 5"):
        open_recording(bag(4))


def test_odometry_that_is_not_a_number_is_left_out(tmp_path: Path) -> None:
    at = BEGIN * SECOND
    lines = [("/odom", at, odometry(BEGIN, 0.0)), ("/odom", at + 1, odometry(BEGIN + 1, math.nan))]

    recording = open_recording(ros2(tmp_path / "bag", lines))

    wheels = recording.odometry()
    assert wheels is not None
    assert len(wheels.stamps) == 1
    assert_words(" ".join(recording.notes()), "1 of 2 messages of /odom are invalid", "message 2")


def test_bag_without_usable_topics_is_rejected_with_its_topics(tmp_path: Path) -> None:
    message = of(STORE, "std_msgs/msg/String", data="hello")
    bag = ros2(tmp_path / "bag", [("/chatter", BEGIN * SECOND, message)])

    with pytest.raises(RecordingError, match=r"nothing to replay.* /chatter \(std_msgs"):
        BagRecording(bag, {})


@pytest.mark.parametrize("damage", [lambda p: p.unlink(), lambda p: p.write_bytes(b"SQLite no")])
def test_broken_ros2_bag_is_rejected_with_a_remedy(
    tmp_path: Path, damage: Callable[[Path], Any]
) -> None:
    bag = ros2(tmp_path / "bag", drive())
    damage(next(bag.glob("*.db3")))

    with pytest.raises(RecordingError, match=r"as a ROS 2 bag .*take a fresh copy"):
        open_recording(bag)
