"""Recordings in order of time, at any time, and when they are cut off or damaged."""

from __future__ import annotations

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType, Writer

from cairn.bus.codec import to_plain
from cairn.errors import RecordingError
from cairn.recording.decoding import MessageDecoder
from cairn.recording.mcap_file import RecordedMessage
from cairn.recording.reader import McapRecording
from cairn.schemas.geometry_msgs import Point
from tests.cairn.recording.recordings import BEGIN, CODEC, SECOND, Sent, text, write_recording

DECODER = MessageDecoder()
LINE = b"=" * 80 + b"\n"


def texts(messages: list[RecordedMessage]) -> list[str]:
    return [DECODER.decode(one).data for one in messages]


def run(count: int = 10) -> list[Sent]:
    sent = [Sent("/robot/map", 0, text("map"), latched=True)]
    for k in range(count):
        sent.append(Sent("/robot/scan", k * SECOND, text(f"scan {k}")))
        sent.append(Sent("/robot/state", k * SECOND + 1, text(f"state {k}"), latched=True))
    return sent


def test_summary_describes_a_recording(tmp_path: Path) -> None:
    file = write_recording(tmp_path / "run.mcap", run())

    with McapRecording(file) as recording:
        assert (recording.start_ns, recording.end_ns) == (BEGIN, BEGIN + 9 * SECOND + 1)
        counts = {one.topic: recording.counts[one] for one in recording.channels}
        assert counts == {"/robot/map": 1, "/robot/scan": 10, "/robot/state": 10}
        scan = next(one for one in recording.channels if one.topic == "/robot/scan")
        assert (scan.node, scan.type, scan.latched) == ("/robot/test", "std_msgs/msg/String", False)
        assert recording.find_attachment("run.json") == b'{"seed": 7}'
        assert recording.metadata["cairn"] == {"format": "1"}
        assert recording.notes == []


def test_messages_come_in_order_of_time_by_span_and_topic(tmp_path: Path) -> None:
    """Also where the chunks of a file overlap, and not in the order in which it was written."""
    sent = [Sent("/a", at, text(str(at))) for at in (5, 1, 9, 3, 3, 2)]
    file = write_recording(tmp_path / "run.mcap", sent, chunk_size=90)

    with McapRecording(file) as recording:
        every = list(recording.messages())
        assert texts(every) == ["1", "2", "3", "3", "5", "9"]
        assert [one.sequence for one in every] == [2, 6, 4, 5, 1, 3]
        assert texts(list(recording.messages(BEGIN + 2, BEGIN + 5))) == ["2", "3", "3", "5"]
        assert list(recording.messages(channels=[])) == []


def test_a_player_gets_the_state_of_latched_topics_at_a_time(tmp_path: Path) -> None:
    file = write_recording(tmp_path / "run.mcap", run())

    with McapRecording(file) as recording:
        assert texts(recording.latched_at(BEGIN + 4 * SECOND)) == ["map", "state 3"]
        assert texts(recording.latched_at(BEGIN + 4 * SECOND + 1)) == ["map", "state 4"]
        assert recording.latched_at(BEGIN - 1) == []
        assert recording.latched_at(BEGIN, channels=[]) == []
        after = recording.messages(BEGIN + 8 * SECOND)
        assert texts(list(after)) == ["scan 8", "state 8", "scan 9", "state 9"]


def test_latched_state_is_that_of_the_last_process_of_a_publisher(tmp_path: Path) -> None:
    before = write_recording(tmp_path / "a.mcap", [Sent("/map", 0, text("old"), latched=True)])
    restarted = [
        Sent("/other", 1, text("x")),
        Sent("/map", 2, text("new"), latched=True),
    ]
    after = write_recording(tmp_path / "b.mcap", restarted)

    with McapRecording([after, before]) as recording:
        assert len(recording.channels) == 3
        assert texts(recording.latched_at(BEGIN + 5)) == ["new"]


def test_files_of_one_recording_are_one_and_repeated_messages_come_once(tmp_path: Path) -> None:
    latched = Sent("/map", 1, text("map"), latched=True, sequence=1)
    write_recording(tmp_path / "run_1.mcap", [latched, Sent("/scan", 2, text("first"))])
    write_recording(tmp_path / "run_2.mcap", [latched, Sent("/scan", 3, text("second"))])

    with McapRecording(tmp_path) as recording:
        assert [file.name for file in recording.files] == ["run_1.mcap", "run_2.mcap"]
        assert texts(list(recording.messages())) == ["map", "first", "second"]


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_recording_cut_off_at_any_byte_gives_all_whole_messages(
    tmp_path: Path, compression: CompressionType
) -> None:
    """As after `kill -9` of the recorder; the note has the byte."""
    file = write_recording(tmp_path / "whole.mcap", run(3), close=False, compression=compression)
    data = file.read_bytes()
    counts = []
    for size in [*range(0, len(data), 41), len(data)]:
        cut = tmp_path / "cut.mcap"
        cut.write_bytes(data[:size])
        if size < 8:
            with pytest.raises(RecordingError, match=r"cut.mcap: is not an MCAP file"):
                McapRecording(cut)
            continue
        with McapRecording(cut) as recording:
            assert any("cut off" in note and "byte" in note for note in recording.notes)
            counts.append(len(list(recording.messages())))
            assert counts[-1] == recording.counts.total()
    assert counts == sorted(counts)
    assert counts[-1] == 7
    if compression is CompressionType.NONE:
        assert set(counts) == set(range(8))
    with McapRecording(file) as recording:
        assert recording.find_attachment("run.json") == b'{"seed": 7}'
        assert texts(recording.latched_at(BEGIN + SECOND)) == ["map", "state 0"]


@pytest.mark.parametrize("compression", list(CompressionType))
def test_what_a_chunk_that_was_cut_off_still_holds_is_read(
    tmp_path: Path, compression: CompressionType
) -> None:
    random = np.random.default_rng(1)
    names = [random.bytes(2500).hex() for _ in range(400)]
    scans = [Sent("/scan", k, text(name)) for k, name in enumerate(names)]
    file = write_recording(
        tmp_path / "run.mcap", scans, compression=compression, chunk_size=4_000_000
    )
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])

    with McapRecording(file) as recording:
        (note,) = recording.notes
        assert "cut off" in note
        found = texts(list(recording.messages()))
        assert recording.counts.total() == len(found)
    assert found == names[: len(found)]
    assert 150 < len(found) < 205  # compressors emit whole blocks


def test_a_recording_without_chunks_or_index_is_read(tmp_path: Path) -> None:
    plain = write_recording(tmp_path / "plain.mcap", run(), use_chunking=False)
    bare = write_recording(
        tmp_path / "bare.mcap",
        run(),
        index_types=IndexType.NONE,
        use_statistics=False,
        repeat_channels=False,
        repeat_schemas=False,
    )
    for file in (plain, bare):
        with McapRecording(file) as recording:
            assert recording.counts.total() == len(list(recording.messages())) == 21
            assert texts(recording.latched_at(BEGIN + SECOND)) == ["map", "state 0"]
            assert recording.notes == []


def test_a_damaged_chunk_is_left_out_with_a_note(tmp_path: Path) -> None:
    file = write_recording(tmp_path / "run.mcap", run(), compression=CompressionType.NONE)
    data = bytearray(file.read_bytes())
    at = data.find(b"scan 4")
    data[at] ^= 1
    file.write_bytes(data)

    with McapRecording(file) as recording:
        found = list(recording.messages())
        assert len(found) == 20
        assert any("checksum differs" in note for note in recording.notes), recording.notes


def test_a_damaged_summary_is_not_used(tmp_path: Path) -> None:
    file = write_recording(tmp_path / "run.mcap", run())
    data = bytearray(file.read_bytes())
    data[-60] ^= 0xFF
    file.write_bytes(data)

    with McapRecording(file) as recording:
        assert len(list(recording.messages())) == 21
        assert any("summary is damaged" in note for note in recording.notes)


def test_messages_of_an_unknown_type_are_decoded_by_their_definition(tmp_path: Path) -> None:
    definition = (
        b"my_msgs/Inner[] items\nfloat32[3] v\nstring name\nuint8 class 7\n"
        + LINE
        + b"MSG: my_msgs/Inner\nint32 k\n"
    )
    data = (
        b"\0\1\0\0" + struct.pack("<III", 2, 5, 6) + struct.pack("<3fI3sB", 1, 2, 3, 3, b"ab\0", 9)
    )
    file = tmp_path / "foreign.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "other")
        schema = writer.register_schema("my_msgs/msg/Outer", "ros2msg", definition)
        writer.add_message(writer.register_channel("/x", "cdr", schema), 1, data, 1)
        point = writer.register_schema("geometry_msgs/msg/Point", "ros2msg", b"float64 x\n")
        other = writer.register_channel("/p", "cdr", point, {"type_hash": "RIHS01_0"})
        writer.add_message(other, 2, b"\0\1\0\0" + struct.pack("<d", 4.0), 2)
        known = writer.register_channel("/q", "cdr", point)
        writer.add_message(known, 3, CODEC.encode(Point(x=5.0)), 3)
        none = writer.register_schema("my_msgs/msg/None", "ros2msg", b"")
        writer.add_message(writer.register_channel("/n", "cdr", none), 4, data, 4)
        json = writer.register_channel("/j", "json", none)
        writer.add_message(json, 5, b"{}", 5)
        writer.finish()

    with McapRecording(file) as recording:
        outer, changed, point_, undefined, json_ = recording.messages()
        assert to_plain(DECODER.decode(outer)) == {
            "items": [{"k": 5}, {"k": 6}], "v": [1.0, 2.0, 3.0], "name": "ab", "class": 9
        }  # fmt: skip
        assert DECODER.decode(changed) == {"x": 4.0}  # another definition of the name
        assert DECODER.decode(point_) == Point(x=5.0)
        with pytest.raises(RecordingError, match=r"/n: message 0 .* not hold its definition"):
            DECODER.decode(undefined)
        with pytest.raises(RecordingError, match=r"/j: .* 'json' is not cdr"):
            DECODER.decode(json_)


def nested(levels: int) -> bytes:
    types = [LINE + b"MSG: a/T%d\nT%d x\n" % (k, k + 1) for k in range(1, levels)]
    return b"T1[] all\n" + b"".join(types) + LINE + b"MSG: a/T%d\n" % levels


HOSTILE: dict[str, tuple[bytes, bytes, str]] = {
    "levels": (nested(12), struct.pack("<I", 3_000) + bytes(3_000), "more messages than"),
    "strings": (b"string[4000000000] all\n", b"", "4,000,000,000 elements"),
    "recursive": (b"T again\n", b"", "recursion"),
    "code": (b"__import__('os').abort() x\n", b"", "parse"),
    "long": (b"int32 x\n" * 50_000, b"", "400,000 bytes"),
    "array": (b"uint8[4000000000] x\n", b"", "buffer"),
    "undefined": (b"missing/Type x\n", b"", "missing"),
    "binary": (b"\xff\xfe", b"", "utf-8"),
}


@pytest.mark.parametrize(("definition", "data", "reason"), HOSTILE.values(), ids=HOSTILE)
def test_hostile_definitions_are_refused(
    tmp_path: Path, definition: bytes, data: bytes, reason: str
) -> None:
    file = tmp_path / "hostile.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "other")
        schema = writer.register_schema("a/msg/T", "ros2msg", definition)
        writer.add_message(writer.register_channel("/x", "cdr", schema), 1, b"\0\1\0\0" + data, 1)
        writer.finish()

    with McapRecording(file) as recording:
        (message,) = recording.messages()
        tracemalloc.start()
        with pytest.raises(RecordingError, match=f"(?i)/x: .*{reason}"):
            DECODER.decode(message)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 20_000_000
