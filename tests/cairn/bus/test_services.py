"""The contract of services on every bus: Zenoh between processes and within one, and lockstep."""

import queue
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest

from cairn.bus.bus import Bus, Call, Node, ServiceError, ServiceServer
from cairn.bus.lockstep_bus import LockstepBus
from cairn.bus.services import MOST_PENDING
from cairn.bus.session import open_client
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.example_interfaces.srv import AddTwoInts
from cairn.schemas.message import InvalidMessage
from cairn.schemas.std_srvs.srv import SetBool, Trigger
from tests.cairn.bus.network import SECRET, Network, eventually, node, stop
from tests.patience import LIMIT_S
from tests.sweeps import sampled
from tests.wording import assert_words

SERVICE = "/robot/add"
Outcome = Any
"""A response or a `ServiceError`."""


@dataclass
class Pair:
    """The bus of the server and that of the client."""

    servers: Bus
    clients: Bus

    def wait_for_peers(self) -> None:
        assert self.servers.wait_for_peers(LIMIT_S) == []
        assert self.clients.wait_for_peers(LIMIT_S) == []


@pytest.fixture(
    params=[
        pytest.param("two processes", marks=pytest.mark.processes),
        pytest.param("one process", marks=pytest.mark.processes),
        "lockstep",
    ]
)
def pair(request: pytest.FixtureRequest) -> Iterator[Pair]:
    if request.param == "lockstep":
        memory = LockstepBus()
        yield Pair(memory, memory)
        return
    network = Network()
    try:
        bus = network.bus()
        yield Pair(bus, bus if request.param == "one process" else network.bus())
    finally:
        network.close()


class Serving:
    """A server whose calls can be waited for."""

    def __init__(self, node: Node, name: str = SERVICE, service: Any = AddTwoInts) -> None:
        self._waiting = threading.Semaphore(0)
        self.server: ServiceServer = node.serve(name, service, self._waiting.release)

    def next(self) -> Call:
        assert self._waiting.acquire(timeout=LIMIT_S), "no call came"
        call = self.server.take()
        assert call is not None
        return call


class Calling:
    """A client whose outcomes can be waited for."""

    def __init__(self, node: Node, name: str = SERVICE, service: Any = AddTwoInts) -> None:
        self._outcomes: queue.Queue[Outcome] = queue.Queue()
        self.client = node.client(name, service, lambda call: call())

    def call(self, request: Any, timeout_s: float = LIMIT_S) -> None:
        self.client.call(request, self._outcomes.put, self._outcomes.put, timeout_s)

    def next(self) -> Outcome:
        return self._outcomes.get(timeout=LIMIT_S)

    def is_silent(self) -> bool:
        return self._outcomes.empty()


def added(call: Call) -> AddTwoInts.Response:
    return AddTwoInts.Response(sum=call.request.a + call.request.b)


def test_response_reaches_the_client(pair: Pair) -> None:
    serving = Serving(node(pair.servers, "/robot/adder"))
    calling = Calling(node(pair.clients, "/robot/asker"))
    pair.wait_for_peers()
    assert eventually(lambda: calling.client.is_available)

    calling.call(AddTwoInts.Request(a=2, b=40))
    call = serving.next()
    assert (call.request, call.sequence) == (AddTwoInts.Request(a=2, b=40), 1)
    call.reply(added(call))

    assert calling.next() == AddTwoInts.Response(sum=42)
    assert (serving.server.received, calling.client.sent) == (1, 1)


def test_thousand_concurrent_calls_are_served_in_order(pair: Pair) -> None:
    serving = Serving(node(pair.servers, "/robot/adder"))
    calling = Calling(node(pair.clients, "/robot/asker"))
    pair.wait_for_peers()

    for number in range(1000):
        calling.call(AddTwoInts.Request(a=number, b=1))
    calls = [serving.next() for _ in range(1000)]
    assert [call.request.a for call in calls] == list(range(1000))
    assert {call.client for call in calls} == {calls[0].client}
    for call in calls:
        call.reply(added(call))

    assert [calling.next().sum for _ in range(1000)] == list(range(1, 1001))
    assert serving.server.refused == 0


def test_call_can_be_answered_later_and_in_any_order(pair: Pair) -> None:
    serving = Serving(node(pair.servers, "/robot/adder"))
    calling = Calling(node(pair.clients, "/robot/asker"))
    pair.wait_for_peers()

    for number in (1, 2):
        calling.call(AddTwoInts.Request(a=number))
    first, second = serving.next(), serving.next()
    second.reply(added(second))
    assert calling.next().sum == 2
    first.reply(added(first))
    assert calling.next().sum == 1


def test_refusal_reaches_the_client_with_its_reason(pair: Pair) -> None:
    serving = Serving(node(pair.servers, "/robot/adder"))
    calling = Calling(node(pair.clients, "/robot/asker"))
    pair.wait_for_peers()

    calling.call(AddTwoInts.Request())
    serving.next().refuse("the adder rests")

    error = calling.next()
    assert isinstance(error, ServiceError)
    assert str(error) == "the adder rests"


def test_call_without_a_server_fails_at_once(pair: Pair) -> None:
    calling = Calling(node(pair.clients, "/robot/asker"))
    pair.wait_for_peers()

    assert not calling.client.is_available
    calling.call(AddTwoInts.Request())

    error = calling.next()
    assert isinstance(error, ServiceError)
    assert f"{SERVICE}: there is no server of this type" in str(error)


def test_server_that_closes_refuses_its_pending_calls(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cairn.bus.services._LAST_ANSWERS_S", LIMIT_S / 4)
    serving = Serving(node(pair.servers, "/robot/adder"))
    calling = Calling(node(pair.clients, "/robot/asker"))
    pair.wait_for_peers()
    calling.call(AddTwoInts.Request())
    call = serving.next()
    calling.call(AddTwoInts.Request())
    serving._waiting.acquire(timeout=LIMIT_S)

    serving.server.close()
    assert "/robot/adder does not serve it any more" in str(calling.next())
    call.reply(added(call))
    assert calling.next() == AddTwoInts.Response(sum=0)
    assert eventually(lambda: not calling.client.is_available)


def test_server_with_another_type_is_reported_by_both_and_never_called(pair: Pair) -> None:
    problems: queue.Queue[str] = queue.Queue()
    serving = Serving(pair.servers.node("/robot/adder", problems.put), SERVICE, Trigger)
    calling = Calling(pair.clients.node("/robot/asker", problems.put), SERVICE, SetBool)
    pair.wait_for_peers()

    found = {problems.get(timeout=LIMIT_S) for _ in range(2)}
    assert {f"service {SERVICE}" in one for one in found} == {True}
    assert any("/robot/adder uses it with type std_srvs/srv/Trigger" in one for one in found)
    calling.call(SetBool.Request(data=True))
    assert isinstance(calling.next(), ServiceError)
    assert serving.server.take() is None


def test_response_of_another_class_is_an_error_of_the_server(pair: Pair) -> None:
    serving = Serving(node(pair.servers, "/robot/adder"))
    calling = Calling(node(pair.clients, "/robot/asker"))
    pair.wait_for_peers()
    calling.call(AddTwoInts.Request())
    call = serving.next()

    with pytest.raises(TypeError, match="not a example_interfaces/srv/AddTwoInts_Response"):
        call.reply(Trigger.Response())
    call.refuse("failed")
    assert str(calling.next()) == "failed"


def test_too_many_waiting_calls_are_refused_and_the_others_served(pair: Pair) -> None:
    serving = Serving(node(pair.servers, "/robot/adder"))
    calling = Calling(node(pair.clients, "/robot/asker"))
    pair.wait_for_peers()

    for number in range(MOST_PENDING + 100):
        calling.call(AddTwoInts.Request(a=number))
    refusals = [calling.next() for _ in range(100)]
    assert {type(one) for one in refusals} == {ServiceError}
    assert "too many calls wait already" in str(refusals[0])
    for number in range(MOST_PENDING):
        call = serving.next()
        assert call.request.a == number
        call.reply(added(call))
    assert [calling.next().sum for _ in range(MOST_PENDING)] == list(range(MOST_PENDING))
    assert serving.server.refused == 100


def test_closed_client_gets_no_answer(pair: Pair) -> None:
    serving = Serving(node(pair.servers, "/robot/adder"))
    calling = Calling(node(pair.clients, "/robot/asker"))
    other = Calling(node(pair.clients, "/robot/other"))
    pair.wait_for_peers()
    calling.call(AddTwoInts.Request())
    call = serving.next()

    calling.client.close()
    call.reply(added(call))
    calling.call(AddTwoInts.Request())
    other.call(AddTwoInts.Request(a=7))
    last = serving.next()
    last.reply(added(last))
    assert other.next().sum == 7
    assert calling.is_silent()


SERVER = """
import signal, sys
from cairn.bus.session import open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.example_interfaces.srv import AddTwoInts

bus = ZenohBus(open_peer([sys.argv[1]], secret=sys.argv[2]), secret=sys.argv[2])
server = bus.node("/robot/adder", print).serve(
    sys.argv[3], AddTwoInts, lambda: print("called", flush=True)
)
print("ready", flush=True)
signal.pause()
"""


@pytest.mark.processes
@pytest.mark.parametrize("mode", sampled(["peer", "script"]))
def test_client_of_a_killed_server_gets_an_error_long_before_its_time_limit(mode: str) -> None:
    network = Network()
    program = [sys.executable, "-c", SERVER, network.endpoint, SECRET, SERVICE]
    script = ZenohBus(open_client([network.endpoint]))
    calling = Calling(node(network.bus() if mode == "peer" else script, "/robot/asker"))
    try:
        for _ in range(3):  # one call of four is sent while Zenoh closes the connection
            with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as server:
                try:
                    assert server.stdout is not None
                    assert server.stdout.readline() == "ready\n"
                    assert eventually(lambda: calling.client.is_available)
                    for _ in range(10):
                        calling.call(AddTwoInts.Request(a=1), timeout_s=100 * LIMIT_S)
                    assert [server.stdout.readline() for _ in range(10)] == ["called\n"] * 10

                    server.kill()
                    for _ in range(10):
                        error = calling.next()
                        assert isinstance(error, ServiceError)
                        assert_words(str(error), SERVICE, "ended")
                    calling.call(AddTwoInts.Request(a=1), timeout_s=100 * LIMIT_S)
                    error = calling.next()
                    assert isinstance(error, ServiceError)
                    assert re.search("no server|the server ended", str(error))
                finally:
                    server.kill()
    finally:
        script.close()
        network.close()


MANY_CALLS = """
import signal, sys
from cairn.bus.session import open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.std_srvs.srv import Trigger
from tests.cairn.bus.network import eventually

bus = ZenohBus(open_peer([sys.argv[1]], secret=sys.argv[2]), secret=sys.argv[2])
client = bus.node("/robot/paused", print).client(sys.argv[3], Trigger, lambda call: call())
assert eventually(lambda: client.is_available)
for _ in range(1500):
    client.call(Trigger.Request(), lambda response: None, lambda error: None, 1000.0)
signal.pause()
"""


@pytest.mark.accuracy
@pytest.mark.processes
def test_client_that_never_reads_does_not_stop_the_server() -> None:
    network = Network()
    program = [sys.executable, "-c", MANY_CALLS, network.endpoint, SECRET, SERVICE]
    try:
        servers, clients = network.bus(), network.bus()
        serving = Serving(node(servers, "/robot/adder"), service=Trigger)
        calling = Calling(node(clients, "/robot/asker"), service=Trigger)
        assert clients.wait_for_peers(LIMIT_S) == []
        with subprocess.Popen(program, text=True) as paused:
            try:
                calls = [serving.next() for _ in range(1500)]
                stop(paused)
                for call in calls:  # 60 MB, which no buffer holds
                    call.reply(Trigger.Response(message="x" * 40_000))

                assert serving.server._replies.unsent  # type: ignore[attr-defined]
            finally:
                paused.kill()
        assert eventually(lambda: not serving.server._replies.unsent)  # type: ignore[attr-defined]
        calling.call(Trigger.Request())
        serving.next().reply(Trigger.Response(message="served"))
        assert calling.next() == Trigger.Response(message="served")
    finally:
        network.close()


@pytest.mark.processes
def test_invalid_request_is_refused_with_the_reason() -> None:
    network = Network()
    try:
        servers, clients = network.bus(), network.bus()
        serving = Serving(node(servers, "/robot/adder"))
        calling = Calling(node(clients, "/robot/asker"))
        assert clients.wait_for_peers(LIMIT_S) == []
        replies: queue.Queue[Any] = queue.Queue()
        for payload in (b"\x00\x01\x00\x00\x01", bytes(10_000)):
            clients.session.get(
                calling.client._key,  # type: ignore[attr-defined]
                replies.put,
                payload=payload,
            )
            if len(payload) == 5:
                assert serving._waiting.acquire(timeout=LIMIT_S)
                with pytest.raises(InvalidMessage, match="AddTwoInts_Request"):
                    serving.server.take()
            error = replies.get(timeout=LIMIT_S).err.payload.to_string()
            assert ("invalid request" if len(payload) == 5 else "10,000 bytes") in error
        assert (serving.server.invalid, serving.server.refused) == (1, 1)
    finally:
        network.close()
