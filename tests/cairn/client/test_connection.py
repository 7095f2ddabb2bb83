"""What a client keeps of the samples that it receives is bounded."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

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


_READ_AND_ASK = """
import os, threading, time
from cairn.bus.graph import read_graph
from cairn.client.connection import Connection
from tests.cairn.bus.network import Network

network = Network()
bus = network.bus()
tokens = [bus.session.liveliness().declare_token(f"@ros2_lv/0/x/{i}") for i in range(200)]
client = Connection.open(network.endpoint)
assert client.is_alive()

def read():
    while True:
        read_graph(client.session, "@ros2_lv/0/**")

for _ in range(3):
    threading.Thread(target=read, daemon=True).start()
end = time.monotonic() + 0.5
while time.monotonic() < end:
    assert client.is_alive()
other = Connection.open(network.endpoint)
other.close()
assert not other.is_alive()
os._exit(0)
"""


@pytest.mark.accuracy
@pytest.mark.processes
def test_connection_is_checked_while_other_threads_read_the_graph() -> None:
    # In a process of its own: a deadlock with the GIL would stop the time limit of the test, too.
    root = Path(__file__).parents[3]
    done = subprocess.run(
        [sys.executable, "-c", _READ_AND_ASK],
        cwd=root,
        timeout=60.0,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
