"""A control request is answered, refused, or found to be without an answer; never left hanging."""

import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import Future
from typing import Any

import pytest

from cairn import CairnError
from cairn.bus.control import ControlError, ControlServer, request
from cairn.bus.keys import control_key
from cairn.bus.zenoh_bus import ZenohBus
from cairn.runtime.loop import ThreadLoop
from tests.cairn.bus.network import Network
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes


NAME = "/robot/part"


class Served:
    """A component's loop and its control."""

    def __init__(self, bus: ZenohBus) -> None:
        self.loop = ThreadLoop()
        self.asked: list[tuple[str, Mapping[str, Any]]] = []
        self.entered = threading.Event()
        self.release = threading.Event()
        self.server = ControlServer(bus.session, 0, NAME, self.loop.post, self.answer)
        self.thread = threading.Thread(target=self.loop.run)
        self.thread.start()

    def answer(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        self.asked.append((verb, arguments))
        if verb == "refuse":
            raise CairnError("no, because it is late")
        if verb == "object":
            return object()
        if verb == "stop":
            self.entered.set()
            assert self.release.wait(LIMIT_S)
            self.loop.stop()
        return dict(arguments)


@pytest.fixture
def served(network: Network) -> Iterator[Served]:
    served = Served(network.bus())
    yield served
    served.release.set()
    served.loop.post(served.loop.stop)
    served.thread.join(LIMIT_S)
    served.server.close()
    assert not served.thread.is_alive()


@pytest.fixture
def asker(network: Network, served: Served) -> ZenohBus:
    bus = network.bus()
    assert bus.wait_for_peers(LIMIT_S) == []
    return bus


def ask(bus: ZenohBus, verb: str, arguments: Mapping[str, Any] | None = None) -> Any:
    return request(bus.session, 0, NAME, verb, arguments, timeout_s=LIMIT_S)


def test_the_answer_comes_back(asker: ZenohBus, served: Served) -> None:
    assert ask(asker, "echo", {"a": [1, "two", None]}) == {"a": [1, "two", None]}
    assert served.asked == [("echo", {"a": [1, "two", None]})]


def test_a_refusal_comes_back_in_the_components_words(asker: ZenohBus) -> None:
    with pytest.raises(ControlError, match=r"^no, because it is late$"):
        ask(asker, "refuse")


def test_an_answer_that_cannot_be_sent_is_an_error_and_the_loop_lives(asker: ZenohBus) -> None:
    with pytest.raises(ControlError, match="its answer cannot be sent"):
        ask(asker, "object")

    assert ask(asker, "echo") == {}


@pytest.mark.parametrize("payload", [None, b"", b"\xff", b"{}", b'{"verb": "a", "more": 1}', b"[]"])
def test_what_is_no_request_is_refused_and_the_next_answered(
    asker: ZenohBus, served: Served, payload: bytes | None
) -> None:
    replies = asker.session.get(control_key(0, NAME), payload=payload, timeout=LIMIT_S)

    (reply,) = [reply.ok.payload.to_string() for reply in replies if reply.ok is not None]
    assert "not a control request" in reply
    assert ask(asker, "echo") == {}
    assert len(served.asked) == 1


def test_nobody_there_is_an_error_that_says_so(network: Network) -> None:
    bus = network.bus()

    with pytest.raises(
        ControlError, match=r"/robot/nobody gave no answer to ping, and after \d.\d s"
    ):
        request(bus.session, 0, "/robot/nobody", "ping", timeout_s=5.0)


def test_a_name_that_nobody_can_have_is_an_error(network: Network) -> None:
    with pytest.raises(ControlError, match="/robot/#what cannot be asked"):
        request(network.bus().session, 0, "/robot/#what", "ping", timeout_s=5.0)


def test_an_answer_that_is_none_is_an_error(network: Network) -> None:
    impostor, asker = network.bus(), network.bus()
    key = control_key(0, NAME)
    queryable: Any = impostor.session.declare_queryable(
        key, lambda query: query.reply(key, b"what?")
    )
    asker.wait_for_peers(LIMIT_S)

    with pytest.raises(ControlError, match="/robot/part gave an answer that is none"):
        ask(asker, "ping")
    queryable.undeclare()


def test_a_request_behind_the_components_end_is_over_at_once(
    asker: ZenohBus, served: Served
) -> None:
    answers = [Future[Any]() for _ in range(2)]

    def wait(verb: str, answer: "Future[Any]") -> None:
        try:
            answer.set_result(request(asker.session, 0, NAME, verb, timeout_s=100.0))
        except ControlError as error:
            answer.set_exception(error)

    for verb, answer in zip(("stop", "late"), answers, strict=True):
        threading.Thread(target=wait, args=(verb, answer), daemon=True).start()
        assert served.entered.wait(LIMIT_S)
    served.release.set()

    assert answers[0].result(LIMIT_S) == {}
    with pytest.raises(ControlError, match="gave no answer to late"):
        answers[1].result(LIMIT_S)


def test_closing_ends_the_thread_and_leaves_nobody_waiting(network: Network) -> None:
    bus, asker = network.bus(), network.bus()
    server = ControlServer(bus.session, 0, NAME, lambda call: None, lambda *_: None)
    asker.wait_for_peers(LIMIT_S)
    before = threading.active_count()

    server.close()

    assert threading.active_count() == before - 1
    with pytest.raises(ControlError):
        ask(asker, "ping")
