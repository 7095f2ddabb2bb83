"""`cairn recording info|cut|merge|export`."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.writer import Writer
from PIL import Image as Picture
from pyarrow import parquet

from cairn.recording.reader import McapRecording
from cairn.schemas.builtin_interfaces import Time
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from cairn.schemas.geometry_msgs import (
    Point,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    Quaternion,
)
from cairn.schemas.sensor_msgs import Image
from cairn.schemas.std_msgs import Header
from tests.cairn.recording.recordings import BEGIN, SECOND, Sent, text, write_recording
from tests.cairn.recording.test_reader import LINE, texts
from tests.commands import cairn

STAMP = Time(sec=1_700_000_000, nanosec=7)
POSE = Pose(position=Point(x=0.1, y=-2.0), orientation=Quaternion(z=1.0, w=0.0))


def image(value: int, encoding: str = "rgb8") -> Image:
    pixels = np.full((16, 16, 3), (value, 0, 255), np.uint8)
    return Image(
        header=Header(stamp=STAMP), height=16, width=16, encoding=encoding, step=48,
        data=pixels.ravel(),
    )  # fmt: skip


def drive() -> list[Sent]:
    located = LocalizationEstimate(
        header=Header(stamp=STAMP), located=True, pose=PoseWithCovariance(pose=POSE), reason="a,b"
    )
    return [
        Sent("/robot/map", 0, text("map"), latched=True),
        Sent("/robot/truth", 1, PoseStamped(header=Header(stamp=STAMP), pose=POSE)),
        Sent("/robot/localization", 2, LocalizationEstimate(header=Header(stamp=STAMP))),
        Sent("/robot/localization", 3, located),
        Sent("/robot/left_image", 4, image(9)),
        Sent("/robot/log", SECOND, text("=1+1")),
        Sent("/robot/log", 2 * SECOND, text("second")),
    ]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "run.mcap", drive())


def test_info_lists_topics_with_publishers_attachments_and_notes(run: Path) -> None:
    run.write_bytes(run.read_bytes()[:-3])

    answer = cairn("recording", "info", str(run))
    described = cairn("recording", "info", str(run), "--json").json

    assert "time: 2023-11-14T22:13:20.000000000Z to 2023-11-14T22:13:22.000000000Z" in answer.out
    assert "/robot/log" in answer.out
    assert "attachments: run.json (11 bytes)" in answer.out
    assert f"{run}: cut off" in answer.err
    rows = {row["topic"]: row for row in described["topics"]}
    assert rows["/robot/localization"]["count"] == 2
    assert rows["/robot/map"]["publisher"] == "/robot/test"
    assert rows["/robot/map"]["latched"] == "yes"


def test_names_in_a_foreign_recording_are_shown_in_one_line_of_limited_length(
    tmp_path: Path,
) -> None:
    file = tmp_path / "foreign.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "other")
        for name in ("/a\n/forged\x1b[2J", f"/{'x' * 9_000}", *(f"/t{k}" for k in range(1_100))):
            writer.add_message(writer.register_channel(name, "cdr", 0), 1, b"", 1)
        writer.add_metadata("m", {"key": "v" * 9_000 + "\n/forged"})
        writer.finish()

    lines = cairn("recording", "info", str(file)).out.splitlines()

    assert not any(line.startswith("/forged") for line in lines)
    assert not any("\x1b" in line for line in lines)
    assert any("/a /forged" in line for line in lines)
    assert max(map(len, lines)) < 5_000
    assert len(lines) < 1_010
    assert "and 102 more: --json prints all" in lines


def test_info_of_another_format_is_that_of_show(tmp_path: Path) -> None:
    log = tmp_path / "a.log"
    log.write_text("ODOM 0 0 0 0 0 0 1.0 robot 1.0\nODOM 1 0 0 0 0 0 2.0 robot 2.0\n")

    assert "odometry: yes" in cairn("recording", "info", str(log)).out


def test_cut_keeps_latched_state_attachments_and_the_chosen_part(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "part.mcap"

    answer = cairn("recording", "cut", str(run), str(out), "--start", "0.5", "--end", "1.5")

    assert answer.code == 0, answer.err
    with McapRecording(out) as part:
        found = list(part.messages())
        assert texts(found) == ["map", "=1+1"]
        assert [one.log_ns - BEGIN for one in found] == [SECOND // 2, SECOND]
        assert found[0].publish_ns == BEGIN - 1000
        assert found[0].channel.node == "/robot/test"
        assert part.find_attachment("run.json") == b'{"seed": 7}'
        assert part.metadata["cairn"] == {"format": "1"}
    again = cairn("recording", "cut", str(run), str(out), "--topic", "log")
    assert "exists; give another name" in again.err
    forced = cairn(
        "recording", "cut", str(run), str(out), "--force", "--topic", "log", "--start", "1700000002"
    )
    assert "1 messages" in forced.out


def test_merge_puts_files_in_order_of_time(run: Path, tmp_path: Path) -> None:
    for number, (start, end) in enumerate((("0", "1"), ("1.000000001", "5"))):
        cairn(
            "recording", "cut", str(run), str(tmp_path / f"part{number}.mcap"), "--start", start,
            "--end", end,
        )  # fmt: skip
    parts = [str(tmp_path / "part1.mcap"), str(tmp_path / "part0.mcap")]
    out = tmp_path / "whole.mcap"

    answer = cairn("recording", "merge", *parts, "--out", str(out))

    assert answer.code == 0, answer.err
    with McapRecording(run) as before, McapRecording(out) as merged:
        assert list(merged.messages()) == list(before.messages())
        assert [one.name for one in merged.attachments] == ["run.json"]


def test_folder_is_merged(run: Path, tmp_path: Path) -> None:
    folder, out = tmp_path / "parts", tmp_path / "whole.mcap"
    folder.mkdir()
    cairn("recording", "cut", str(run), str(folder / "run.mcap"), "--end", "1")
    cairn("recording", "cut", str(run), str(folder / "run_2.mcap"), "--start", "1.000000001")

    answer = cairn("recording", "merge", str(folder), "--out", str(out))

    assert answer.code == 0, answer.err
    with McapRecording(run) as before, McapRecording(out) as merged:
        assert list(merged.messages()) == list(before.messages())


def test_messages_in_overlapping_files_are_merged_once(run: Path, tmp_path: Path) -> None:
    part, out = str(tmp_path / "part.mcap"), tmp_path / "whole.mcap"
    cairn("recording", "cut", str(run), part, "--end", "1")

    cairn("recording", "merge", part, str(run), "-o", str(out))

    with McapRecording(run) as before, McapRecording(out) as merged:
        assert list(merged.messages()) == list(before.messages())


def test_a_topic_or_time_that_does_not_exist_is_an_error(run: Path, tmp_path: Path) -> None:
    out = str(tmp_path / "x.mcap")

    missing = cairn("recording", "cut", str(run), out, "--topic", "scan")
    whole = cairn("recording", "cut", str(run), out, "--topic", "robot/*", "--exclude", "*_image")
    Path(out).unlink()
    wrong = cairn("recording", "cut", str(run), out, "--start", "noon")
    swapped = cairn("recording", "cut", str(run), out, "--start", "2", "--end", "1")

    assert "6 messages" in whole.out
    assert "no topic matches scan; its topics are /robot/left_image" in missing.err
    assert "--start 'noon' is not a time" in wrong.err
    assert "--start 2 is after --end 1" in swapped.err
    assert not Path(out).exists()


def test_trajectories_have_the_time_stamps_as_recorded(run: Path, tmp_path: Path) -> None:
    answer = cairn(
        "recording", "export", str(run), "--format", "tum", "--out", str(tmp_path / "out")
    )

    lines = (tmp_path / "out" / "robot.localization.tum").read_text().splitlines()
    assert lines[1:] == ["1700000000.000000007 0.1 -2.0 0.0 0.0 0.0 1.0 0.0"]
    assert (tmp_path / "out" / "robot.truth.tum").exists()
    assert (
        "because it has no header with a pose: /robot/left_image, /robot/log, /robot/map"
        in answer.err
    )


@pytest.mark.parametrize("file_format", ["csv", "parquet"])
def test_tables_have_a_row_for_each_message(run: Path, tmp_path: Path, file_format: str) -> None:
    out = tmp_path / "out"

    answer = cairn("recording", "export", str(run), "--format", file_format, "-o", str(out))

    assert answer.code == 0, answer.err
    assert "images are exported by --format png or jpeg: /robot/left_image" in answer.err
    file = out / f"robot.localization.{file_format}"
    if file_format == "csv":
        with file.open(newline="") as stream:
            rows = list(csv.DictReader(stream))
        assert rows[1]["header.stamp.nanosec"] == "7"
        assert rows[1]["reason"] == "a,b"
        assert rows[1]["located"] == "true"
        covariance = json.loads(rows[1]["pose.covariance"])
    else:
        rows = parquet.read_table(file).to_pylist()
        assert rows[1]["header.stamp.nanosec"] == 7
        covariance = rows[1]["pose.covariance"]
        assert rows[1]["log_time_ns"] == BEGIN + 3
    assert len(covariance) == 36
    assert len(rows) == 2
    assert float(rows[1]["pose.pose.position.x"]) == 0.1
    again = cairn("recording", "export", str(run), "--format", file_format, "-o", str(out))
    assert "it exists" in again.err
    assert "--force" in again.err


def test_tables_hold_images_on_request(run: Path, tmp_path: Path) -> None:
    arguments = ("--format", "parquet", "--topic", "left_image", "--out", str(tmp_path))

    assert cairn("recording", "export", str(run), *arguments).code == 0

    (row,) = parquet.read_table(tmp_path / "robot.left_image.parquet").to_pylist()
    assert row["data"] == bytes(image(9).data)


def test_definition_that_grows_with_every_level_is_refused(tmp_path: Path) -> None:
    levels = [b"".join(b"T%d[] x%d\n" % (k + 1, n) for n in range(10)) for k in range(12)]
    parts = [LINE + b"MSG: a/T%d\n" % k + level for k, level in enumerate(levels) if k]
    definition = levels[0] + b"".join(parts) + LINE + b"MSG: a/T12\nint8 end\n"
    file = tmp_path / "hostile.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "other")
        schema = writer.register_schema("a/msg/T0", "ros2msg", definition)
        writer.add_message(writer.register_channel("/x", "cdr", schema), 1, bytes(44), 1)
        writer.finish()

    answer = cairn("recording", "export", str(file), "-f", "parquet", "-o", str(tmp_path / "out"))

    assert answer.code == 1
    assert "a/msg/T0 has more than 2,000 messages" in answer.err


def test_parquet_without_pyarrow_is_an_error(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)

    answer = cairn("recording", "export", str(run), "-f", "parquet", "-o", str(tmp_path / "out"))

    assert "pip install 'cairn-robotics[parquet]'" in answer.err
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize(("file_format", "suffix"), [("png", "png"), ("jpeg", "jpg")])
def test_images_are_exported_in_color(
    run: Path, tmp_path: Path, file_format: str, suffix: str
) -> None:
    out = tmp_path / "out"

    cairn("recording", "export", str(run), "--format", file_format, "--out", str(out))

    file = out / "robot.left_image" / f"1700000000.000000007.{suffix}"
    with Picture.open(file) as picture:
        assert picture.getpixel((3, 3)) == pytest.approx((9, 0, 255), abs=4)


def test_an_image_that_is_damaged_is_left_out_with_a_note(tmp_path: Path) -> None:
    sent = [
        Sent("/camera/image", 0, image(1)),
        Sent("/camera/image", 1, image(1, "bgra8")),
        Sent("/camera/image", 2, image(1, "float")),
    ]
    file = write_recording(tmp_path / "run.mcap", sent)

    answer = cairn("recording", "export", str(file), "-f", "png", "-o", str(tmp_path / "out"))

    assert "camera.image: 1 messages" in answer.out
    assert "2 messages of /camera/image are left out, the first: " in answer.err
    assert "768 bytes" in answer.err


def test_compressed_images_are_written_as_they_are(tmp_path: Path) -> None:
    from mcap.writer import Writer

    pixels = np.full((16, 16), 77, np.uint8)
    jpeg = cv2.imencode(".jpg", pixels)[1].tobytes()
    definition = (
        b"std_msgs/Header header\nstring format\nuint8[] data\n" + b"=" * 80
        + b"\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n" + b"=" * 80
        + b"\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )  # fmt: skip
    head = (5).to_bytes(4, "little") + (6).to_bytes(4, "little")
    text_ = (1).to_bytes(4, "little") + b"\0" + bytes(3)
    data = b"\0\1\0\0" + head + text_ + text_ + len(jpeg).to_bytes(4, "little") + jpeg
    file = tmp_path / "run.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "other")
        schema = writer.register_schema("sensor_msgs/msg/CompressedImage", "ros2msg", definition)
        writer.add_message(writer.register_channel("/../image", "cdr", schema), 1, data, 1)
        writer.finish()

    cairn("recording", "export", str(file), "-f", "jpeg", "-o", str(tmp_path / "jpeg"))
    cairn("recording", "export", str(file), "-f", "png", "-o", str(tmp_path / "png"))

    name = "%2E%2E.image/5.000000006"
    assert (tmp_path / "jpeg" / f"{name}.jpg").read_bytes() == jpeg
    with Picture.open(tmp_path / "png" / f"{name}.png") as picture:
        assert picture.getpixel((3, 3)) == pytest.approx(77, abs=2)
