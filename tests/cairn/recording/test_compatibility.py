"""Recordings are read by the tools of ROS 2 without conversion, with the same values."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from cairn.recording.decoding import MessageDecoder
from cairn.recording.reader import McapRecording
from cairn.testing.launching import launching
from tests.cairn.recording.recordings import BEGIN, SECOND, write_recording
from tests.cairn.recording.test_tools import drive
from tests.commands import cairn

NPM = Path(__file__).parent / "npm"
"""An independent reader of MCAP and decoder of ROS 2 messages, which npm installs."""

TALK = """
    components:
      listener: {plugin: test_listener}
      talker: {plugin: test_talker}
    """


@pytest.fixture(params=["recorded", "cut", "repaired"])
def run(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A recording in the format of the recorder, and what `cairn recording cut` makes of it.

    It also makes one of a recording that was not closed, which other tools refuse.
    """
    recorded = write_recording(tmp_path / "run.mcap", drive(), close=request.param != "repaired")
    if request.param == "recorded":
        return recorded
    out = tmp_path / "cut.mcap"
    assert cairn("recording", "cut", str(recorded), str(out), "--end", "60").code == 0
    return out


def expected(run: Path) -> list[tuple[str, int, str]]:
    decoder = MessageDecoder()
    with McapRecording(run) as recording:
        return [
            (one.channel.topic, one.log_ns, str(getattr(decoder.decode(one), "data", "")))
            for one in recording.messages()
            if one.channel.type == "std_msgs/msg/String"
        ]


def test_rosbags_reads_a_recording(run: Path) -> None:
    with AnyReader([run]) as reader:
        found = [
            (connection.topic, log_ns, reader.deserialize(raw, connection.msgtype).data)  # type: ignore[attr-defined]
            for connection, log_ns, raw in reader.messages()
            if connection.msgtype == "std_msgs/msg/String"
        ]
        poses = [
            reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in reader.messages()
            if connection.topic == "/robot/localization"
        ]

    assert found == expected(run)
    assert poses[1].pose.pose.position.x == 0.1  # type: ignore[attr-defined]


def test_mcap_ros2_support_reads_a_recording(run: Path) -> None:
    with run.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        found = list(reader.iter_decoded_messages())
        header = reader.get_header()

    texts = [
        (channel.topic, message.log_time, decoded.data)
        for schema, channel, message, decoded in found
        if schema is not None and schema.name == "std_msgs/msg/String"
    ]
    assert texts == expected(run)
    poses = [decoded for _, channel, _, decoded in found if channel.topic == "/robot/localization"]
    assert poses[1].pose.pose.position.x == 0.1
    assert header.profile == "ros2"


def test_mcap_command_finds_no_fault_in_a_recording(run: Path) -> None:
    if shutil.which("mcap") is None:
        pytest.skip("the `mcap` command (Go) is not installed")
    doctor = subprocess.run(
        ["mcap", "doctor", str(run)], capture_output=True, text=True, timeout=60, check=False
    )
    assert doctor.returncode == 0, doctor.stdout + doctor.stderr
    listed = subprocess.run(
        ["mcap", "cat", str(run), "--topics", "/robot/localization", "--json"],
        capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    rows = [json.loads(line) for line in listed.stdout.splitlines()]
    assert rows[1]["data"]["pose"]["pose"]["position"]["x"] == 0.1


@pytest.fixture(scope="module")
def robot_recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `cairn up --record` records of real processes."""
    with launching(tmp_path_factory.mktemp("robot")) as launch:
        run = launch(TALK, "--record")
        run.await_line("listener: received 20")
        assert run.stop() == 0
    return run.report / "recording.mcap"


def rows_of(path: Path) -> list[tuple[str, str, str]]:
    """Return the messages as `read_recording.mjs` does: topic, time, and a field of each type."""
    decoder = MessageDecoder()
    with McapRecording(path) as recording:
        assert {one.topic for one in recording.channels} >= {
            "/robot/words", "/rosout", "/robot/component_status", "/robot/talker/call_log",
        }  # fmt: skip
        return sorted(
            (one.channel.topic, str(one.log_ns), field_of(decoder.decode(one)))
            for one in recording.messages()
        )


def field_of(message: Any) -> str:
    if hasattr(message, "linear"):
        return f"{message.linear.x:g}"
    return str(getattr(message, "component", getattr(message, "msg", "")))


@pytest.mark.accuracy
@pytest.mark.processes
def test_rosbags_reads_a_recording_of_real_processes(robot_recording: Path) -> None:
    with AnyReader([robot_recording]) as reader:
        found = sorted(
            (connection.topic, str(log_ns), field_of(reader.deserialize(raw, connection.msgtype)))
            for connection, log_ns, raw in reader.messages()
        )

    assert found == rows_of(robot_recording)


@pytest.mark.accuracy
@pytest.mark.processes
def test_mcap_ros2_support_reads_a_recording_of_real_processes(robot_recording: Path) -> None:
    with robot_recording.open("rb") as stream:
        found = sorted(
            (channel.topic, str(message.log_time), field_of(decoded))
            for _, channel, message, decoded in make_reader(
                stream, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages()
        )

    assert found == rows_of(robot_recording)


@pytest.mark.accuracy
@pytest.mark.processes
def test_reader_of_npm_reads_a_recording_of_real_processes(
    robot_recording: Path, tmp_path: Path
) -> None:
    for program in ("node", "npm"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is missing: install the packages nodejs and npm")
    for name in ("package.json", "package-lock.json", ".npmrc"):
        shutil.copy(NPM / name, tmp_path)
    installed = subprocess.run(
        ["npm", "ci", "--no-audit", "--no-fund"], cwd=tmp_path, capture_output=True, text=True,
        timeout=250, check=False,
    )  # fmt: skip
    if installed.returncode:
        pytest.skip(f"npm cannot install the independent reader: {installed.stderr[-500:]}")

    done = subprocess.run(
        ["node", str(NPM / "read_recording.mjs"), str(tmp_path), str(robot_recording)],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip

    assert done.returncode == 0, done.stderr
    assert sorted(map(tuple, json.loads(done.stdout))) == rows_of(robot_recording)


def test_span_and_counts_agree_with_the_library(run: Path) -> None:
    with run.open("rb") as stream:
        summary = make_reader(stream).get_summary()

    assert summary is not None
    assert summary.statistics is not None
    with McapRecording(run) as recording:
        assert recording.counts.total() == summary.statistics.message_count == 7
        assert (recording.start_ns, recording.end_ns) == (BEGIN, BEGIN + 2 * SECOND)
