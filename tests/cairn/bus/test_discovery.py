"""Once a process has waited for its peers, not even the first message is lost."""

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any

import pytest
import zenoh
from zenoh.handlers import FifoChannel

from cairn import LATCHED, RELIABLE
from cairn.bus.discovery import PeerLinks, QueryableWatcher, _peers_of_router, _Query
from cairn.bus.keys import session_key
from cairn.bus.session import open_peer, session_id
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.std_msgs import String
from cairn.testing.launching import new_endpoint
from tests.cairn.bus.network import SECRET, Network, Reader, eventually, node, router_process, stop
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes


class _AnsweringAfterEvents:
    """A session that answers which peers it has only after a link event has been handled."""

    def __init__(self) -> None:
        self.info = self
        self.asked = 0
        self.on_link_event: Any = None

    def zid(self) -> str:
        return "1"

    def declare_transport_events_listener(self, callback: Any, *, history: bool) -> None:
        del callback, history

    def peers_zid(self) -> list[str]:
        self.asked += 1
        if self.on_link_event is None:
            return []
        event = threading.Thread(target=self.on_link_event, args=(None,), daemon=True)
        event.start()
        event.join(LIMIT_S)
        assert not event.is_alive(), "the link event waits for the thread that asks"
        return ["2"] if self.asked > 5 else []

    def routers_zid(self) -> list[str]:
        return []


def test_zenoh_is_not_asked_while_its_link_events_must_wait(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    session: Any = _AnsweringAfterEvents()
    links = PeerLinks(session)
    session.on_link_event = links._on_link_event
    monkeypatch.setattr(links, "has_left", lambda zid, timeout_s: False)
    assert links.wait_for_link("2", time.monotonic() + LIMIT_S, lambda: False)
    assert not links.wait_for_link("3", time.monotonic() + 0.1, lambda: False)


class Participant:
    """A node that publishes and receives on the topic that all participants share."""

    def __init__(self, bus: ZenohBus, name: str) -> None:
        self.bus = bus
        self.name = name
        own = node(bus, f"/robot/{name}")
        self.reader = Reader(own, "/robot/word", String, RELIABLE.with_depth(1000))
        self.writer = own.advertise("/robot/word", String, RELIABLE)

    def publish(self, word: str) -> None:
        self.writer.publish(String(data=word))


def test_first_message_of_a_joining_process_reaches_all_and_vice_versa(
    network: Network,
) -> None:
    present = [Participant(network.bus(), f"present{number}") for number in range(3)]
    for one in present:
        assert one.bus.wait_for_peers(LIMIT_S) == []

    for turn in range(20):
        bus = network.bus()
        joiner = Participant(bus, f"joiner{turn}")
        assert bus.wait_for_peers(LIMIT_S) == []
        joiner.publish(f"hello {turn}")
        present[turn % 3].publish(f"welcome {turn}")

        for one in present:
            assert {one.reader.next().data for _ in range(2)} == {
                f"hello {turn}",
                f"welcome {turn}",
            }
        assert {joiner.reader.next().data for _ in range(2)} == {f"hello {turn}", f"welcome {turn}"}
        bus.close()


def test_processes_that_join_at_the_same_time_receive_each_others_messages(
    network: Network,
) -> None:
    count = 5
    for turn in range(6):
        together = threading.Barrier(count, timeout=LIMIT_S)
        heard: dict[int, set[str]] = {}

        def join(number: int) -> None:
            bus = network.bus()
            one = Participant(bus, f"one{turn}{number}")  # noqa: B023 - ends within the turn
            together.wait()  # noqa: B023
            assert bus.wait_for_peers(LIMIT_S) == []
            together.wait()  # noqa: B023
            one.publish(f"from {number}")
            heard[number] = {one.reader.next().data for _ in range(count)}  # noqa: B023
            together.wait()  # noqa: B023
            bus.close()

        threads = [threading.Thread(target=join, args=(number,)) for number in range(count)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(LIMIT_S * 2)

        everything = {f"from {number}" for number in range(count)}
        assert heard == dict.fromkeys(range(count), everything)


@pytest.mark.accuracy
def test_latched_publishers_that_come_and_go_do_not_delay_discovery(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A link that no longer works would otherwise be closed soon, and its other end not waited for.
    monkeypatch.setattr("cairn.bus.session.LEASE_MS", 3_600_000)
    for _ in range(40):
        network = Network()
        coming, other = network.bus(), network.bus()
        part = node(coming, "/robot/part")
        for word in ("a", "b"):
            latched = part.advertise("/robot/state", String, LATCHED)
            latched.publish(String(data=word))
            latched.close()

        assert other.wait_for_peers(LIMIT_S) == []
        network.close()


@pytest.mark.accuracy
def test_repeatedly_started_processes_lose_no_message(network: Network) -> None:
    bus = network.bus()
    here = node(bus, "/robot/here")
    ear = Reader(here, "/robot/word", String, RELIABLE)
    answers = here.advertise("/robot/answer", String, RELIABLE)
    assert bus.wait_for_peers(LIMIT_S) == []

    for turn in range(5):
        with process(network, f"turn{turn}") as (peer, _, output):
            assert output.readline() == "ready []\n"
            answers.publish(String(data=str(turn)))
            assert output.readline() == f"received {turn}\n"
            assert ear.next() == String(data=f"first of turn{turn}")
            peer.kill()

    assert ear.subscription.dropped == 0


def test_successor_of_a_killed_publisher_is_received_without_false_drops(network: Network) -> None:
    bus = network.bus()
    ear = Reader(node(bus, "/robot/ear"), "/robot/word", String, RELIABLE.with_depth(50))
    for _ in range(2):
        with process(network, "mouth") as (peer, order, output):
            assert output.readline() == "ready []\n"
            for number in range(20):
                order.write(f"{number}\n")
            order.flush()
            assert ear.next().data == "first of mouth"
            assert [word.data for word in ear.next_of(20)] == [str(n) for n in range(20)]
            peer.kill()

    assert (ear.subscription.received, ear.subscription.dropped) == (42, 0)


def test_stopped_process_is_reported_and_does_not_delay_the_others(network: Network) -> None:
    other = Participant(network.bus(), "other")
    with process(network, "hanging") as (peer, _, output):
        assert output.readline() == "ready []\n"
        assert other.reader.next().data == "first of hanging"
        stop(peer)
        joiner = Participant(network.bus(), "joiner")

        began = time.monotonic()
        assert joiner.bus.wait_for_peers(LIMIT_S) == [f"process {peer.pid}"]
        assert time.monotonic() - began < LIMIT_S / 4
        joiner.publish("received nevertheless")
        assert other.reader.next().data == "received nevertheless"


@pytest.mark.parametrize("description", [b"", b"[" * 100_000, b'{"sessions": 1e999}', b"{}"])
def test_false_description_of_a_router_names_no_peers(description: bytes) -> None:
    assert _peers_of_router(description) is None


def test_router_that_does_not_answer_in_time_does_not_mean_that_a_process_has_left() -> None:
    with router_process() as (endpoint, router), open_peer([endpoint]) as session:
        links = PeerLinks(session)
        assert eventually(lambda: links.has_left("0123", LIMIT_S))
        stop(router)

        assert not links.has_left("0123", 0.2)
        links.close()


def test_process_that_leaves_before_answering_is_not_waited_for(network: Network) -> None:
    bus = network.bus()
    mute = open_peer([network.endpoint], secret=SECRET)
    leaves = threading.Timer(0.3, mute.close)
    leaves.start()
    try:
        assert bus.wait_for_peers(LIMIT_S / 4) == []
    finally:
        leaves.join()


def test_link_that_outlives_the_session_of_its_process_is_not_waited_for(
    network: Network,
) -> None:
    bus = network.bus()
    endpoint = new_endpoint()
    config = zenoh.Config()
    for key, value in {
        "mode": "peer",
        # As of a closed session of Cairn: linked, not to the router, and without declarations.
        "id": session_id(SECRET),
        "listen/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as closed:
        zid = str(closed.info.zid())
        joiner = ZenohBus(open_peer([network.endpoint, endpoint], secret=SECRET), secret=SECRET)
        try:
            assert eventually(lambda: zid in map(str, joiner.session.info.peers_zid()))
            assert joiner.wait_for_peers(LIMIT_S / 4) == []
            assert bus.wait_for_peers(LIMIT_S / 4) == []
        finally:
            joiner.close()


def test_killed_process_is_not_waited_for(network: Network) -> None:
    bus = network.bus()
    with process(network, "killed") as (peer, _, output):
        assert output.readline() == "ready []\n"
        peer.kill()
        peer.wait(LIMIT_S)

        assert eventually(lambda: bus.wait_for_peers(0.2) == [])


def test_silent_sessions_of_others_delay_one_start_shortly_and_no_further_one(
    network: Network,
) -> None:
    present = Participant(network.bus(), "present")
    with ExitStack() as stack:
        for _ in range(8):
            mute = stack.enter_context(open_peer([network.endpoint], secret="not of the run"))
            pending = mute.declare_queryable(session_key(str(mute.info.zid())), FifoChannel(9))
            stack.callback(pending.undeclare)
        began = time.monotonic()
        unreached = present.bus.wait_for_peers(LIMIT_S)
        joiner = Participant(network.bus(), "joiner")

        assert len(unreached) == 8
        assert all("not of this run" in name for name in unreached)
        assert joiner.bus.wait_for_peers(LIMIT_S) == []  # the present one has handed them on
        assert time.monotonic() - began < LIMIT_S / 4
        joiner.publish("received nevertheless")
        assert present.reader.next().data == "received nevertheless"


def test_reply_of_another_session_does_not_pass_for_that_of_a_process_of_the_run(
    network: Network,
) -> None:
    joiner = network.bus()
    with (
        open_peer([network.endpoint], secret=SECRET) as mute,
        open_peer([network.endpoint]) as forger,
    ):
        key = session_key(str(mute.info.zid()))
        forger.declare_queryable(key, lambda query: query.reply(key, bytes(40)))
        assert eventually(lambda: any(reply.ok for reply in joiner.session.get(key)))

        assert f"process {os.getpid()}" in joiner.wait_for_peers(0.5)


def test_replies_that_nobody_reads_are_kept_up_to_a_limit(network: Network) -> None:
    joiner = network.bus()
    with open_peer([network.endpoint]) as liar, QueryableWatcher(joiner.session, KEY) as watcher:

        def reply(query: zenoh.Query) -> None:
            for _ in range(60):
                query.reply(KEY, bytes(900_000))

        liar.declare_queryable(KEY, reply)
        assert watcher.wait(LIMIT_S)
        query = _Query(joiner.session, KEY, LIMIT_S)
        assert query.ended.wait(LIMIT_S)

    assert 1 << 20 < sum(len(payload) for _, payload in query.take()) <= 16 << 20


def test_false_queryables_for_all_sessions_do_not_delay_discovery(network: Network) -> None:
    present = Participant(network.bus(), "present")
    with open_peer([network.endpoint], secret="not of the run") as mute:
        pending = mute.declare_queryable(session_key("*"), FifoChannel(99))
        joiner = Participant(network.bus(), "joiner")
        began = time.monotonic()
        unreached = joiner.bus.wait_for_peers(LIMIT_S)

        assert all("not of this run" in name for name in unreached)
        assert time.monotonic() - began < LIMIT_S / 4
        joiner.publish("received nevertheless")
        assert present.reader.next().data == "received nevertheless"
        pending.undeclare()


def test_stopped_process_does_not_delay_the_end_of_another(network: Network) -> None:
    with process(network, "hanging") as (peer, _, output):
        assert output.readline() == "ready []\n"
        bus = network.bus()
        assert bus.wait_for_peers(LIMIT_S) == []
        stop(peer)
        began = time.monotonic()
        bus.close()
        assert time.monotonic() - began < 8.0, "zenoh has waited for the stopped process"


@contextmanager
def process(
    network: Network, name: str
) -> Iterator[tuple["subprocess.Popen[str]", IO[str], IO[str]]]:
    """A peer in a process of its own: the process, its input and its output."""
    script = str(Path(__file__).with_name("peer.py"))
    program = [sys.executable, script, network.endpoint, name, SECRET]
    with subprocess.Popen(
        program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as peer:
        assert peer.stdin is not None
        assert peer.stdout is not None
        try:
            yield peer, peer.stdin, peer.stdout
        finally:
            peer.kill()


KEY = "@cairn/0/component/robot/base"


def test_watcher_returns_at_once_if_the_queryable_exists(network: Network) -> None:
    asking, answering = network.bus().session, network.bus().session
    answering.declare_queryable(KEY, lambda _: None)

    with QueryableWatcher(asking, KEY) as watcher:
        assert watcher.wait(LIMIT_S)
