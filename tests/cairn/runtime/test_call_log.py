"""The call log: what a component was called with, read and published, in order."""

import random
from pathlib import Path

import pytest
import yaml

from cairn import Component, In, Out, every, on
from cairn.runtime.call_log import CALL_LOG_QOS
from cairn.runtime.call_records import CallLogError, RecordDecoder, RecordEncoder, RecordKind
from cairn.schemas.cairn_msgs import CallBatch
from cairn.schemas.geometry_msgs import Vector3
from cairn.testing.lockstep import DeploymentHarness

Kind = RecordKind


class Doubler(Component):
    number: In[Vector3]
    double: Out[Vector3]

    @on("number")
    def receive(self, number: Vector3) -> None:
        self.number_at = self.clock.now()
        self.post(lambda: self.double.publish(Vector3(x=2.0 * number.x)))

    @every(hz=1)
    def tick(self) -> None:
        self.log.debug("subscribed: %s", self.double.has_subscribers)


def doubler(tmp_path: Path, *, call_log: bool) -> DeploymentHarness:
    page = {
        "cairn": 1,
        "call_log": call_log,
        "external_topics": ["number"],
        "components": {"doubler": {"plugin": f"{__name__}:Doubler"}},
    }
    file = tmp_path / "doubler.yaml"
    file.write_text(yaml.safe_dump(page))
    return DeploymentHarness(file)


def test_call_log_has_the_calls_with_what_they_read_and_published(tmp_path: Path) -> None:
    with doubler(tmp_path, call_log=True) as run:
        batches = run.read("doubler/call_log", CallBatch, CALL_LOG_QOS)
        run.publish("number", Vector3(x=1.0))
        run.run_for(1.5)
        run.run.shutdown()
    decoder = RecordDecoder()
    records = [
        record for one in batches.messages for record in decoder.decode(one.records.tobytes())
    ]
    assert batches.messages[0].first == 0
    assert sum(one.count for one in batches.messages) == len(records)
    kinds = [record[0] for record in records if record[0] is not Kind.TIME]
    calls = [kind for kind in kinds if kind.begins_call]
    assert calls[:5] == [Kind.START, Kind.TRANSITION, Kind.TRANSITION, Kind.MESSAGE, Kind.POSTED]
    assert Kind.TIMERS in calls[5:]
    (message,) = [record for record in records if record[0] is Kind.MESSAGE]
    assert (message[1], message[3]) == ("number", 1)
    after = records[records.index(message) + 1]
    assert after == (Kind.TIME, 0)
    assert records[records.index((Kind.POSTED,)) + 1] == (Kind.SENT, "double", 1)
    assert (Kind.NO_SUBSCRIBERS, "double") in records
    assert kinds[-1] is Kind.ENDED


def test_component_without_call_log_publishes_none(tmp_path: Path) -> None:
    with doubler(tmp_path, call_log=False) as run:
        batches = run.read("doubler/call_log", CallBatch, CALL_LOG_QOS)
        run.run_for(2.0)
    assert batches.messages == []


def test_records_survive_encoding_in_batches() -> None:
    chance = random.Random(5)
    gids = [chance.randbytes(16) for _ in range(3)]
    records = [
        chance.choice(
            [
                (Kind.MESSAGE, f"port{i % 4}", gids[i % 3], chance.randrange(-5, 2**62)),
                (Kind.TIME, chance.randrange(-(2**62), 2**62)),
                (Kind.REQUEST, "go", '{"to": "Zürich"}'),
                (Kind.SENT, "pose", i),
                (Kind.TIMERS,),
            ]
        )
        for i in range(500)
    ]
    encoder, decoder = RecordEncoder(), RecordDecoder()
    decoded = []
    for start in range(0, len(records), 100):
        data = bytearray()
        for record in records[start : start + 100]:
            encoder.encode(record, data)
        decoded += list(decoder.decode(bytes(data)))
    assert decoded == records


@pytest.mark.parametrize(
    "data",
    [b"\xff", b"\x02\x05", b"\x11" + b"\x80" * 20, b"\x07\x00\x7fshort", b"\x01\x00\x01\xff"],
)
def test_damaged_records_are_rejected(data: bytes) -> None:
    with pytest.raises(CallLogError):
        list(RecordDecoder().decode(data))
