"""What a client keeps of the samples that it receives is bounded."""

from dataclasses import dataclass

import pytest

from cairn.bus.keys import message_key
from cairn.client import connection
from cairn.client.connection import Connection, SampleQueue
from cairn.schemas.std_msgs import String
from tests.cairn.bus.network import Network, eventually


@dataclass
class Sample:
    payload: bytes


def test_queue_of_samples_drops_the_oldest_that_are_too_long_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(connection, "KEPT_BYTES", 100)
    samples = SampleQueue()

    for size in (40, 50, 30, 20):
        samples.put(Sample(bytes(size)))

    assert [len(samples.get(timeout=0).payload) for _ in range(3)] == [50, 30, 20]
    samples.put(Sample(bytes(1_000)))
    assert len(samples.get(timeout=0).payload) == 1_000
    samples.put(Sample(bytes(100)))
    assert samples.qsize() == 1


@pytest.mark.processes
def test_false_cache_that_replies_without_end_does_not_fill_the_memory_of_a_client(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(connection, "KEPT_BYTES", 100_000)
    key = message_key(0, "/robot/word", String)
    network = Network()
    session = network.bus().session
    queryable = session.declare_queryable(
        f"{key}/@adv/**", lambda query: [query.reply(key, bytes(30_000)) for _ in range(50)]
    )
    client = Connection.open(network.endpoint)

    def sizes() -> list[int]:
        samples, complete = client.cached(key)
        return [] if complete else [len(sample.payload) for sample in samples]

    assert eventually(lambda: sizes() == [30_000] * 3)
    client.close()
    queryable.undeclare()
    network.close()
