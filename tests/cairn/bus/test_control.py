"""A control request gets a reply, a rejection, or an error that no reply will arrive."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from typing import Any

import pytest
import zenoh

from cairn import CairnError
from cairn.bus.control import ControlError, ControlServer, answering, request
from cairn.bus.keys import control_key
from cairn.bus.session import open_client
from cairn.bus.zenoh_bus import ZenohBus
from cairn.runtime.loop import ThreadLoop
from tests.cairn.bus.network import Network, eventually, fail_test
from tests.patience import LIMIT_S
from tests.wording import words_in_order

pytestmark = pytest.mark.processes


NAME = "/robot/base"


class ServedComponent:
    """A component's loop and its control server."""

    def __init__(self, bus: ZenohBus) -> None:
        self.loop = ThreadLoop()
        self.requests: list[tuple[str, Mapping[str, Any]]] = []
        self.entered = threading.Event()
        self.release = threading.Event()
        self.posted = 0
        self.server = ControlServer(
            bus.session, 0, NAME, self.post, self.answer, {"long": 200_000}, {"urgent"}
        )
        self.thread = threading.Thread(target=self.loop.run)
        self.thread.start()

    def post(self, call: Callable[[], None]) -> None:
        self.posted += 1
        self.loop.post(call)

    def answer(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        self.requests.append((verb, arguments))
        if verb == "reject":
            raise CairnError("it is too late")
        if verb == "object":
            return object()
        if verb == "much":
            return "x" * 2_000_000
        if verb in ("stop", "wait"):
            self.entered.set()
            assert self.release.wait(LIMIT_S)
        if verb == "stop":
            self.loop.stop()
        return dict(arguments)


@pytest.fixture
def served(network: Network) -> Iterator[ServedComponent]:
    served = ServedComponent(network.bus())
    yield served
    served.release.set()
    served.loop.post(served.loop.stop)
    served.thread.join(LIMIT_S)
    served.server.close()
    assert not served.thread.is_alive()


@pytest.fixture
def client(network: Network, served: ServedComponent) -> ZenohBus:
    bus = network.bus()
    assert bus.wait_for_peers(LIMIT_S) == []
    return bus


def send_request(bus: ZenohBus, verb: str, arguments: Mapping[str, Any] | None = None) -> Any:
    return request(bus.session, 0, NAME, verb, arguments, timeout_s=LIMIT_S)


def test_request_returns_the_reply(client: ZenohBus, served: ServedComponent) -> None:
    assert send_request(client, "echo", {"a": [1, "two", None]}) == {"a": [1, "two", None]}
    assert served.requests == [("echo", {"a": [1, "two", None]})]


def test_rejection_raises_the_components_error(client: ZenohBus) -> None:
    with pytest.raises(ControlError, match=r"^it is too late$"):
        send_request(client, "reject")


def test_reply_that_is_not_json_is_an_error_and_the_loop_continues(client: ZenohBus) -> None:
    with pytest.raises(ControlError, match="the reply is not JSON"):
        send_request(client, "object")

    assert send_request(client, "echo") == {}


@pytest.mark.parametrize(
    "payload",
    [
        None,
        b"",
        b"\xff",
        b'{"more": 1}',
        b"[]",
        b'{"arguments": {"a": NaN}}',
        b'{"arguments": {"a": 1e999}}',
        b'{"arguments": {"a": 18446744073709551616}}',
        b'{"arguments": {"a": ' + b"9" * 5000 + b"}}",
        b'{"arguments": {"a": ' + b"[" * 110 + b"]" * 110 + b"}}",
        b"[" * 60_000,
        b'{"arguments": {"a": "' + b"x" * 65_536 + b'"}}',
    ],
    ids=lambda payload: "none" if payload is None else str(payload[:45]),
)
def test_invalid_request_is_rejected_and_the_next_is_served(
    client: ZenohBus, served: ServedComponent, payload: bytes | None
) -> None:
    replies = client.session.get(control_key(0, NAME, "echo"), payload=payload, timeout=LIMIT_S)

    (reply,) = [reply.ok.payload.to_string() for reply in replies if reply.ok is not None]
    assert "invalid control request" in reply
    assert send_request(client, "echo") == {}
    assert len(served.requests) == 1


def test_declared_verb_accepts_longer_requests(client: ZenohBus, served: ServedComponent) -> None:
    text = "x" * 100_000

    assert send_request(client, "long", {"text": text}) == {"text": text}
    with pytest.raises(ControlError, match=words_in_order("invalid", "echo", "65,536")):
        send_request(client, "echo", {"text": text})


def test_longer_request_than_any_component_accepts_is_not_sent(client: ZenohBus) -> None:
    with pytest.raises(ControlError, match=words_in_order(NAME, "echo", "262,144", "send less")):
        send_request(client, "echo", {"text": "x" * 300_000})


def test_too_long_reply_is_an_error(client: ZenohBus) -> None:
    with pytest.raises(ControlError, match=words_in_order("reply", "2,000,0", "1,048,576")):
        send_request(client, "much")


def test_false_queryable_that_replies_without_end_does_not_reach_the_client(
    network: Network,
) -> None:
    impostor = network.bus()
    replied = threading.Event()

    def reply(query: Any) -> None:
        query.reply(query.key_expr, bytes(20_000_000))
        replied.set()

    queryable: Any = impostor.session.declare_queryable(control_key(0, NAME), reply)
    with open_client([network.endpoint]) as session:

        def is_asked() -> bool:
            # Until the declaration has arrived, nothing answers either.
            with pytest.raises(ControlError, match="no reply"):
                request(session, 0, NAME, "echo", timeout_s=LIMIT_S)
            return replied.is_set()

        assert eventually(is_asked)
    queryable.undeclare()


def test_flood_of_requests_is_refused_and_an_urgent_one_is_answered(
    client: ZenohBus, served: ServedComponent
) -> None:
    """Without a limit, the requests and their arguments would fill the memory."""
    key, refused = control_key(0, NAME, "echo"), threading.Semaphore(0)

    def count(reply: zenoh.Reply) -> None:
        if reply.ok is not None and "busy" in reply.ok.payload.to_string():
            refused.release()

    blocked = threading.Thread(target=send_request, args=(client, "wait"))
    blocked.start()
    assert served.entered.wait(LIMIT_S)
    handler: Any = zenoh.handlers.Callback(count, indirect=False)
    for _ in range(100):
        client.session.get(key, handler, payload=b"{}", timeout=LIMIT_S)
    for _ in range(100 - 32):
        assert refused.acquire(timeout=LIMIT_S)
    urgent = Future[Any]()
    stopping = threading.Thread(
        target=lambda: urgent.set_result(send_request(client, "urgent", {"now": True}))
    )
    stopping.start()
    assert eventually(lambda: served.posted == 1 + 32 + 1)
    served.release.set()

    assert urgent.result(LIMIT_S) == {"now": True}
    assert [verb for verb, _ in served.requests].count("echo") == 32
    blocked.join(LIMIT_S)
    stopping.join(LIMIT_S)


def test_urgent_request_is_received_while_no_other_is_read(network: Network) -> None:
    """Before, a flood of requests displaced it from the ring that all of them shared."""
    reading, go_on = threading.Event(), threading.Event()

    def post(call: Callable[[], None]) -> None:
        if threading.current_thread() is not urgent_thread:
            reading.set()
            assert go_on.wait(LIMIT_S)
        call()

    bus, client = network.bus(), network.bus()
    server = ControlServer(bus.session, 0, NAME, post, lambda verb, _: verb, {}, {"urgent"})
    urgent_thread = server._readers[1].thread
    try:
        client.wait_for_peers(LIMIT_S)
        flood: Any = zenoh.handlers.RingChannel(1)
        for _ in range(300):
            client.session.get(control_key(0, NAME, "echo"), flood, payload=b"{}", timeout=LIMIT_S)
        assert reading.wait(LIMIT_S)

        assert send_request(client, "urgent") == "urgent"
    finally:
        go_on.set()
        server.close()


def test_request_to_a_missing_component_raises_no_reply(network: Network) -> None:
    bus = network.bus()

    with pytest.raises(
        ControlError,
        match=words_in_order("/robot/missing", "ping"),
    ):
        request(bus.session, 0, "/robot/missing", "ping", timeout_s=5.0)


def test_request_to_an_impossible_name_is_an_error(network: Network) -> None:
    with pytest.raises(ControlError, match="/robot/#what: cannot send the request"):
        request(network.bus().session, 0, "/robot/#what", "ping", timeout_s=5.0)


def test_invalid_reply_is_an_error(network: Network) -> None:
    impostor, client = network.bus(), network.bus()
    key = control_key(0, NAME)
    queryable: Any = impostor.session.declare_queryable(
        key, lambda query: query.reply(key, b"what?")
    )
    client.wait_for_peers(LIMIT_S)

    with pytest.raises(ControlError, match="/robot/base: invalid reply"):
        send_request(client, "ping")
    queryable.undeclare()


def test_request_queued_when_the_component_ends_fails_at_once(
    client: ZenohBus, served: ServedComponent
) -> None:
    answers = [Future[Any]() for _ in range(2)]

    def wait(verb: str, answer: "Future[Any]") -> None:
        try:
            answer.set_result(request(client.session, 0, NAME, verb, timeout_s=100.0))
        except ControlError as error:
            answer.set_exception(error)

    for verb, answer in zip(("stop", "late"), answers, strict=True):
        threading.Thread(target=wait, args=(verb, answer), daemon=True).start()
        assert served.entered.wait(LIMIT_S)
    served.release.set()

    assert answers[0].result(LIMIT_S) == {}
    with pytest.raises(ControlError, match="no reply to late"):
        answers[1].result(LIMIT_S)


def test_closing_stops_the_thread_and_fails_pending_requests(network: Network) -> None:
    bus, client = network.bus(), network.bus()
    server = ControlServer(bus.session, 0, NAME, lambda call: None, lambda *_: None)
    client.wait_for_peers(LIMIT_S)
    serving = [thread for thread in threading.enumerate() if thread.name == "cairn control"]
    assert serving

    server.close()

    for thread in serving:
        thread.join(LIMIT_S)
        assert not thread.is_alive()
    with pytest.raises(ControlError):
        send_request(client, "ping")


def test_silent_and_lying_queryables_do_not_hide_the_component(network: Network) -> None:
    bus, other = network.bus(), network.bus()
    served = ServedComponent(bus)
    silent: Any = zenoh.handlers.FifoChannel(99)
    false = other.session.declare_queryable(control_key(0, NAME), silent, complete=True)
    lying = other.session.declare_queryable(
        "@cairn/0/component/robot/*/*", lambda query: query.reply(query.key_expr, b"?")
    )
    with open_client([network.endpoint]) as client:
        assert eventually(lambda: list(answering(client, 0, "robot", 0.2)) == [NAME])
        began = time.monotonic()
        assert request(client, 0, NAME, "echo", {"x": 1}, timeout_s=LIMIT_S) == {"x": 1}
        assert time.monotonic() - began < LIMIT_S / 4
    false.undeclare()
    lying.undeclare()
    served.release.set()
    request(bus.session, 0, NAME, "stop", timeout_s=LIMIT_S)
    served.thread.join(LIMIT_S)
    served.server.close()


def test_busy_component_answers_a_ping_and_a_token_alone_does_not(network: Network) -> None:
    served = ServedComponent(network.bus())
    other = network.bus()
    ghost = other.node("/robot/ghost", fail_test)
    with open_client([network.endpoint]) as client:
        # Until the router knows the queryable, a request ends at once.
        assert eventually(lambda: list(answering(client, 0, "*", LIMIT_S)) == [NAME])
        waiting = threading.Thread(
            target=lambda: request(client, 0, NAME, "stop", timeout_s=LIMIT_S)
        )
        waiting.start()
        assert served.entered.wait(LIMIT_S)
        assert list(answering(client, 0, "*", LIMIT_S)) == [NAME]
        served.release.set()
        waiting.join(LIMIT_S)
    ghost.close()
    served.thread.join(LIMIT_S)
    served.server.close()
