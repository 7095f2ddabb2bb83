import errno
import os
from collections import Counter
from pathlib import Path

import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory

from cairn.bus.codec import Codec
from cairn.bus.lockstep_bus import LockstepBus
from cairn.bus.qos import LATCHED, RELIABLE, Qos
from cairn.bus.type_hash import type_hash
from cairn.errors import CairnError
from cairn.recording.recorder import McapRecorder, RecorderSettings
from cairn.recording.tap import LockstepTap, PublisherInfo, Sample
from cairn.recording.topics import TopicPatterns
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.cairn_nav_msgs import LocalizationEstimate
from cairn.schemas.message import schema_messages, type_name
from cairn.schemas.rcl_interfaces import Log
from cairn.schemas.std_msgs import Header, String
from cairn.system.clock import SECOND

CODEC = Codec()


class FakeTap:
    def __init__(self) -> None:
        self.lost: Counter[str] = Counter()
        self.refused = 0
        self.known: dict[bytes, PublisherInfo] = {}

    def publisher(self, gid: bytes) -> PublisherInfo | None:
        return self.known.get(gid)

    def is_present(self, gid: bytes) -> bool:
        return True

    def close(self) -> None:
        pass


class Bench:
    """A recorder without a thread, on a clock that the test sets."""

    def __init__(self, path: Path, **settings: object) -> None:
        self.now = 1_000 * SECOND
        self.tap = FakeTap()
        self.sent: Counter[str] = Counter()
        self.path = path / "run.mcap"
        self.recorder = McapRecorder(
            RecorderSettings.model_validate({"keep_free_mb": 0, **settings}),
            self.path,
            {"run.json": b"{}"},
            schema_messages().get,
            now=self._tick,
            threaded=False,
        )
        self.recorder.start(self.tap)

    def _tick(self) -> int:
        self.now += 1  # as a clock does between two looks at it
        return self.now

    def send(
        self, topic: str, text: str, qos: Qos = RELIABLE, *, message: object | None = None
    ) -> None:
        message = String(data=text) if message is None else message
        gid = topic.encode().ljust(16)[:16]
        self.tap.known[gid] = PublisherInfo("/robot/node", qos)
        self.sent[topic] += 1
        self.now += SECOND // 10
        cls = type(message)
        payload = CODEC.encode(message)
        self.recorder.receive(
            Sample(
                topic, type_name(cls), type_hash(cls), payload, gid, self.sent[topic],
                self.now - 5, self.now,
            )
        )  # fmt: skip


def texts(path: Path) -> list[tuple[str, str]]:
    """Return the messages of a complete recording, decoded by an independent library."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return [
            (channel.topic, message.data)
            for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False)
        ]


def read_unfinished(path: Path) -> list[tuple[str, int]]:
    """Return topic and sequence of what can be read of a file that may end anywhere."""
    found, channels = [], {}
    with path.open("rb") as file:
        try:
            for record in StreamReader(file).records:
                if isinstance(record, Channel):
                    channels[record.id] = record.topic
                elif isinstance(record, Message):
                    found.append((channels[record.channel_id], record.sequence))
        except McapError:
            pass
    return found


def test_recording_has_messages_metadata_and_attachments_in_the_format(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.send("/robot/a", "one")
    bench.send("/robot/b", "two", LATCHED)
    bench.recorder.close()
    assert texts(bench.path) == [("/robot/a", "one"), ("/robot/b", "two")]
    with bench.path.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        first, second = summary.channels.values()
        (message, _) = [one for _, _, one in reader.iter_messages()]
        assert [one.name for one in reader.iter_attachments()] == ["run.json"]
        assert [one.metadata["format"] for one in reader.iter_metadata()] == ["1"]
    assert first.metadata["node"] == "/robot/node"
    assert first.metadata["gid"] == b"/robot/a".ljust(16).hex()
    assert first.metadata["type_hash"] == type_hash(String)
    assert (first.metadata["latched"], second.metadata["latched"]) == ("false", "true")
    assert message.publish_time == message.log_time - 5
    assert summary.schemas[1].data.startswith(b"string data")


def test_file_of_a_killed_recorder_has_all_but_the_last_chunk(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    for number in range(20):
        bench.send("/robot/a", f"text {number}")
    got = read_unfinished(bench.path)  # without closing it
    assert got == [("/robot/a", number) for number in range(1, len(got) + 1)]
    assert len(got) >= 20 - 5  # of half a second


def test_full_disk_loses_nothing_that_was_written_and_recording_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path, queue_mb=4)
    for number in range(10):
        bench.send("/robot/a", f"text {number}")
    before = read_unfinished(bench.path)
    real = os.pwrite

    def half(descriptor: int, data: memoryview, offset: int) -> int:
        if len(data) > 1:
            return real(descriptor, data[: len(data) // 2], offset)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "pwrite", half)
    for _ in range(30):
        bench.send("/robot/a", "x" * 500_000)
        assert read_unfinished(bench.path) == before
    status = bench.recorder.status()
    assert "No space left" in status.problem
    assert str(bench.path) in status.problem
    monkeypatch.undo()
    for _ in range(20):
        bench.send("/robot/a", "later")
    status = bench.recorder.close()
    assert not status.problem
    assert 0 < status.dropped["/robot/a"] < 60
    sequences = [number for _, number in read_unfinished(bench.path)]
    assert len(sequences) + status.dropped["/robot/a"] == 60
    assert sequences[-1] == 60
    with bench.path.open("rb") as file:
        records = {one.name: one.metadata for one in make_reader(file).iter_metadata()}
    assert records["cairn_losses"]["dropped /robot/a"] == str(status.dropped["/robot/a"])


def test_every_split_file_begins_with_the_latched_messages(tmp_path: Path) -> None:
    bench = Bench(tmp_path, split_s=1.0)
    bench.send("/robot/map", "old", LATCHED)
    bench.send("/robot/map", "map", LATCHED)
    for number in range(25):
        bench.send("/robot/a", str(number))
    files = bench.recorder.close().files
    assert [path.name for path in files] == ["run.mcap", "run_2.mcap", "run_3.mcap"]
    assert [texts(path)[0] for path in files[1:]] == [("/robot/map", "map")] * 2
    with_numbers = [text for path in files for topic, text in texts(path) if topic == "/robot/a"]
    assert with_numbers == [str(number) for number in range(25)]


def test_disk_limit_removes_the_oldest_files(tmp_path: Path) -> None:
    bench = Bench(tmp_path, disk_limit_mb=4, compression="none")
    for _ in range(100):
        bench.send("/robot/a", "x" * 100_000)
    status = bench.recorder.close()
    assert status.size < 5 << 20
    assert status.files == tuple(sorted(tmp_path.iterdir(), key=lambda one: int(one.stem[4:])))
    assert not bench.path.exists()


def test_topic_condition_writes_what_happened_before_and_after(tmp_path: Path) -> None:
    bench = Bench(tmp_path, last_s=2.0, after_s=1.0, triggers=["localization.health < 0.3"])
    bench.send("/robot/map", "map", LATCHED)
    healthy = LocalizationEstimate(header=Header(), health=0.9)
    for number in range(50):
        bench.send("/robot/a", str(number))
    bench.send("/robot/localization", "", message=healthy)
    assert not bench.path.exists()
    lost = LocalizationEstimate(header=Header(), health=0.1)
    bench.send("/robot/localization", "", message=lost)
    for number in range(50, 100):
        bench.send("/robot/a", str(number))
    status = bench.recorder.close()
    assert status.files == (bench.path,)
    with bench.path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        got = [(c.topic, m) for _, c, _, m in reader.iter_decoded_messages(log_time_order=False)]
        record = next(iter(reader.iter_metadata())).metadata
    assert (got[0][0], got[0][1].data) == ("/robot/map", "map")
    numbers = [int(message.data) for topic, message in got if topic == "/robot/a"]
    assert numbers == list(range(numbers[0], numbers[-1] + 1))
    assert 30 <= numbers[0] <= 34
    assert 58 <= numbers[-1] <= 63
    assert record["trigger"] == "localization.health < 0.3 (it is 0.1)"


def test_clock_that_is_set_back_changes_nothing_about_what_is_kept_and_written(
    tmp_path: Path,
) -> None:
    bench = Bench(tmp_path, last_s=2.0, after_s=1.0, trigger_on_failure=True, exclude=["/rosout"])
    for number in range(50):
        bench.send("/robot/a", str(number))
    bench.now -= 600 * SECOND
    for number in range(50, 60):
        bench.send("/robot/a", str(number))
    broken = Log(name="robot.root", msg="child failed: base: it broke")
    bench.send("/rosout", "", LATCHED, message=broken)
    for number in range(60, 100):
        bench.send("/robot/a", str(number))
    assert bench.recorder.close().files == (bench.path,)
    numbers = [int(text) for topic, text in texts(bench.path) if topic == "/robot/a"]
    assert numbers == list(range(numbers[0], numbers[-1] + 1))
    assert 38 <= numbers[0] <= 42
    assert 68 <= numbers[-1] <= 73


def test_file_is_continued_after_the_clock_was_set_back(tmp_path: Path) -> None:
    bench = Bench(tmp_path, last_s=2.0, after_s=3.0, trigger_on_failure=True, exclude=["/rosout"])
    bench.send("/robot/a", "before")
    bench.send("/rosout", "", LATCHED, message=Log(name="robot.root", msg="child failed: base: x"))
    for number in range(10):
        bench.send("/robot/a", str(number))
    bench.now -= 2 * SECOND
    for number in range(10, 60):
        bench.send("/robot/a", str(number))
    assert bench.recorder.close().files == (bench.path,)
    numbers = [int(text) for topic, text in texts(bench.path)[1:] if topic == "/robot/a"]
    assert numbers == list(range(numbers[-1] + 1))
    assert 25 <= numbers[-1] <= 40


def test_paused_recorder_repeats_what_it_missed_after_the_clock_was_set_back(
    tmp_path: Path,
) -> None:
    bench = Bench(tmp_path)
    bench.send("/robot/a", "before")
    bench.recorder.pause()
    for _ in range(10):
        bench.send("/robot/a", "paused")
    bench.now -= 600 * SECOND
    for _ in range(10):
        bench.send("/robot/map", "missed", LATCHED)
    bench.recorder.resume()
    files = bench.recorder.close().files
    assert ("/robot/map", "missed") in [one for path in files for one in texts(path)]


def test_disk_is_tried_again_after_the_clock_was_set_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(tmp_path)
    bench.send("/robot/a", "before")

    def full(descriptor: int, data: memoryview, offset: int) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "pwrite", full)
    for _ in range(20):
        bench.send("/robot/a", "later")
    assert bench.recorder.status().problem
    monkeypatch.undo()
    bench.now -= 600 * SECOND
    for _ in range(20):
        bench.send("/robot/a", "later")
    assert not bench.recorder.status().problem
    files = bench.recorder.close().files
    assert sum(len(read_unfinished(path)) for path in files) == 41


def test_status_has_the_reason_why_a_condition_cannot_be_evaluated(tmp_path: Path) -> None:
    bench = Bench(tmp_path, last_s=2.0, triggers=["localization.wealth < 0.3"])
    bench.send("/robot/localization", "", message=LocalizationEstimate(header=Header()))
    problem = bench.recorder.close().problem
    assert "LocalizationEstimate has no number wealth" in problem


def test_recorder_cannot_trigger_if_no_message_had_the_number_of_any_condition(
    tmp_path: Path,
) -> None:
    estimate = LocalizationEstimate(header=Header(), health=0.9)
    mixed = Bench(tmp_path, last_s=2.0, triggers=["*.health < 0.3"])
    wrong = Bench(tmp_path, last_s=2.0, triggers=["localization.wealth < 0.3"])
    watched = Bench(
        tmp_path,
        last_s=2.0,
        triggers=["localization.wealth < 0.3"],
        trigger_on_failure=True,
    )

    for bench in (mixed, wrong, watched):
        assert not bench.recorder.cannot_trigger
        bench.send("/robot/localization", "", message=estimate)
        bench.send("/robot/words", "without a number")

    assert not mixed.recorder.cannot_trigger
    assert wrong.recorder.cannot_trigger
    assert not watched.recorder.cannot_trigger


def test_failure_of_a_component_triggers_unless_it_is_older_than_the_recorder(
    tmp_path: Path,
) -> None:
    old = Log(name="robot.root", msg="child failed: base: it broke before")
    new = Log(name="robot.root", msg="child failed: base: it broke")
    bench = Bench(tmp_path, last_s=2.0, after_s=0.5, trigger_on_failure=True, exclude=["/rosout"])
    bench.now -= SECOND
    bench.send("/rosout", "", LATCHED, message=old)
    bench.now += SECOND
    for number in range(5):
        bench.send("/robot/a", str(number))
    assert not bench.path.exists()
    bench.send("/rosout", "", LATCHED, message=new)
    for number in range(5, 20):
        bench.send("/robot/a", str(number))
    restarted = ComponentStatus(header=Header(), component="base", reason="it broke", restarts=1)
    for message in (ComponentStatus(header=Header(), component="base"), restarted):
        bench.send("/robot/component_status", "", LATCHED, message=message)
    bench.send("/robot/a", "after")
    status = bench.recorder.close()
    assert [path.name for path in status.files] == ["run.mcap", "run_2.mcap"]
    reasons = []
    for path in status.files:
        with path.open("rb") as file:
            reasons.append(next(iter(make_reader(file).iter_metadata())).metadata["trigger"])
    assert reasons == [
        "robot.root: child failed: base: it broke", "/robot/base was restarted: it broke",
    ]  # fmt: skip


def test_condition_that_is_no_condition_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CairnError, match="write it as TOPIC"):
        Bench(tmp_path, last_s=1.0, triggers=["localization.health is low"])


def test_paused_recorder_repeats_the_latched_messages_that_it_missed(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    bench.send("/robot/a", "before")
    bench.recorder.pause()
    for number in range(5):
        bench.send("/robot/a", f"paused {number}")
    bench.send("/robot/map", "map", LATCHED)
    bench.recorder.resume()
    for _ in range(5):
        bench.send("/robot/a", "after")
    bench.recorder.close()
    got = texts(bench.path)
    assert ("/robot/map", "map") in got
    assert not [text for _, text in got[2:] if text.startswith("paused")]
    assert got[-1] == ("/robot/a", "after")


def test_lockstep_tap_delivers_what_components_publish() -> None:
    bus = LockstepBus()
    got: list[Sample] = []
    tap = LockstepTap(bus, lambda: 7, got.append, ["/robot/a"])
    node = bus.node("/robot/node", print)
    for topic in ("/robot/a", "/robot/b"):
        node.advertise(topic, String, LATCHED).publish(String(data="text"))
    tap.close()
    node.advertise("/robot/a", String, LATCHED).publish(String(data="text"))
    (sample,) = got
    assert (sample.topic, sample.sequence, sample.sent_ns, sample.received_ns) == (
        "/robot/a", 1, 7, 7,
    )  # fmt: skip
    assert CODEC.decode(String, sample.payload) == String(data="text")
    assert tap.publisher(sample.gid) == PublisherInfo("/robot/node", LATCHED)


@pytest.mark.parametrize(
    ("pattern", "topic", "expected"),
    [
        ("scan", "/robot/scan", True),
        ("scan", "/robot/front/scan", False),
        ("/**", "/rosout", True),
        ("camera/*", "/robot/camera/left", True),
        ("**/left", "/robot/camera/left", True),
        ("camera*", "/robot/camera_left", True),
        ("camera*", "/robot/camera/left", False),
    ],
)
def test_patterns_choose_topics(pattern: str, topic: str, *, expected: bool) -> None:
    assert TopicPatterns([pattern]).match(topic) is expected
