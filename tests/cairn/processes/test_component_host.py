"""A component on a thread of this process, which answers requests and ends as a child does."""

import json
import queue
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar

import pytest
import zenoh

from cairn import CairnError, Component, every
from cairn.bus.control import ControlError, ControlRequest, request
from cairn.bus.keys import control_key
from cairn.bus.zenoh_bus import ZenohBus
from cairn.processes.child import ChildUnavailable
from cairn.processes.component_process import ComponentHost
from cairn.runtime.child_spec import ChildSpec
from cairn.runtime.launch_request import LaunchRequest, RunContext
from cairn.testing.launching import LIMIT_S, new_endpoint
from tests.cairn.bus.network import router_at
from tests.wording import assert_words, words_in_order

pytestmark = pytest.mark.processes


class Idle(Component):
    """Does nothing."""


class Wordy(Component):
    """Answers with the length of what it is sent, when a test allows it."""

    request_max_bytes = MappingProxyType({"long": 200_000})
    urgent_requests = frozenset({"halt"})
    entered: ClassVar[threading.Event]
    allowed: ClassVar[threading.Event]

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        self.entered.set()
        assert self.allowed.wait(LIMIT_S)
        return len(arguments.get("text", ""))


class Brief(Component):
    """Finishes at its first tick."""

    @every(hz=100)
    def tick(self) -> None:
        self.finish("that was all")


class Refusing(Component):
    """Finishes while it is configured."""

    def on_configure(self) -> None:
        self.finish("nothing to do")


class Slow(Component):
    """Is configured only when a test allows it."""

    entered: ClassVar[threading.Event]
    allowed: ClassVar[threading.Event]

    def on_configure(self) -> None:
        self.entered.set()
        assert self.allowed.wait(LIMIT_S)


class Broken(Component):
    """Cannot be configured."""

    def on_configure(self) -> None:
        raise ValueError("no device")


@pytest.fixture
def endpoint() -> str:
    return new_endpoint()


@pytest.fixture
def bus(endpoint: str) -> Iterator[ZenohBus]:
    bus = ZenohBus(router_at(endpoint))
    yield bus
    bus.close()


def hosted(bus: ZenohBus, endpoint: str, component: type[Component]) -> ComponentHost:
    host = ComponentHost(
        LaunchRequest(
            name="thing",
            spec=ChildSpec(plugin=f"{__name__}:{component.__name__}"),
            parent="root",
            context=RunContext(endpoints=(endpoint,)),
        ),
        bus,
    )
    host.start()
    return host


def test_requests_make_the_transitions_of_the_life_cycle(bus: ZenohBus, endpoint: str) -> None:
    host = hosted(bus, endpoint, Idle)

    answers = [host.request(verb, LIMIT_S) for verb in ("configure", "activate", "shutdown")]

    assert answers == ["inactive", "active", "finalized"]
    assert host.ended.wait(LIMIT_S)
    assert host.exit_report is not None
    assert (host.exit_report.normal, host.exit_report.reason) == (True, "shut down")
    host.close()


def test_transitions_of_the_life_cycle_are_rejected_from_the_bus(
    bus: ZenohBus, endpoint: str
) -> None:
    host = hosted(bus, endpoint, Idle)
    host.request("configure", LIMIT_S)

    for verb in ("activate", "cleanup", "shutdown"):
        with pytest.raises(ControlError, match=words_in_order("thing", verb, "hold", "root")):
            request(bus.session, 0, "/robot/thing", verb, timeout_s=LIMIT_S)
    parameters = request(bus.session, 0, "/robot/thing", "parameters", timeout_s=LIMIT_S)
    assert {one["name"] for one in parameters} == {"log_level", "service_introspection"}

    assert host.heartbeat().state == "inactive"
    host.request("shutdown", LIMIT_S)
    host.close()


def test_component_declares_which_requests_may_be_long_and_which_are_urgent(
    bus: ZenohBus, endpoint: str
) -> None:
    Wordy.entered, Wordy.allowed = threading.Event(), threading.Event()
    host = hosted(bus, endpoint, Wordy)
    replies: queue.Queue[str] = queue.Queue()

    def send(verb: str, text: str = "") -> None:
        def note(reply: zenoh.Reply) -> None:
            assert reply.ok is not None
            replies.put(reply.ok.payload.to_string())

        handler: Any = zenoh.handlers.Callback(note, indirect=False)
        payload = ControlRequest(arguments={"text": text}).model_dump_json()
        key = control_key(0, "/robot/thing", verb)
        bus.session.get(key, handler, payload=payload, timeout=LIMIT_S)

    send("long", "x" * 100_000)
    assert Wordy.entered.wait(LIMIT_S)
    for _ in range(100):
        send("short")
    assert all("busy" in replies.get(timeout=LIMIT_S) for _ in range(60))
    send("halt")
    send("short", "x" * 100_000)
    while "65,536" not in (reply := replies.get(timeout=LIMIT_S)):  # all before it are received
        assert "busy" in reply
    Wordy.allowed.set()
    answers = [json.loads(replies.get(timeout=LIMIT_S)) for _ in range(34)]

    values = [answer["value"] for answer in answers if answer["error"] is None]
    assert values[0] == 100_000
    assert len(values) == 34
    host.request("shutdown", LIMIT_S)
    host.close()


def test_component_that_finishes_has_a_normal_exit_report(bus: ZenohBus, endpoint: str) -> None:
    host = hosted(bus, endpoint, Brief)
    host.request("configure", LIMIT_S)
    host.request("activate", LIMIT_S)

    assert host.ended.wait(LIMIT_S)

    assert host.exit_report is not None
    assert (host.exit_report.normal, host.exit_report.reason) == (True, "that was all")
    host.close()


def test_request_to_a_component_that_has_ended_raises_with_the_reason_of_its_end(
    bus: ZenohBus, endpoint: str
) -> None:
    host = hosted(bus, endpoint, Refusing)
    assert host.request("configure", LIMIT_S) == "finalized"

    with pytest.raises(ChildUnavailable, match="nothing to do"):
        host.request("activate", LIMIT_S)

    host.close()


def test_request_that_is_not_answered_in_time_names_the_handler_but_not_the_component(
    bus: ZenohBus, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for event in ("entered", "allowed"):
        monkeypatch.setattr(Slow, event, threading.Event(), raising=False)
    host = hosted(bus, endpoint, Slow)
    configured = host.send_request("configure")
    assert Slow.entered.wait(LIMIT_S)

    # The supervisor that logs it begins with the name itself.
    with pytest.raises(ChildUnavailable, match=r"^no answer within 0.0 s; it is in on_configure$"):
        host.request("activate", 0.0)

    Slow.allowed.set()
    assert configured.result(LIMIT_S) == "inactive"
    host.request("shutdown", LIMIT_S)
    host.close()


def test_start_canceled_while_the_zygote_imports_starts_no_process(
    bus: ZenohBus, endpoint: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    host = hosted(bus, endpoint, Idle)
    spawned = []

    class Importing:
        """A zygote; the start is canceled while it imports."""

        def __init__(self, *_: object) -> None:
            host.cancel_starts()

        def spawn(self, name: str, *_: object, **__: object) -> None:
            spawned.append(name)

        def close(self) -> None:
            """Do nothing."""

    monkeypatch.setattr("cairn.processes.component_process.ZygoteClient", Importing)
    child = LaunchRequest(
        name="child",
        spec=ChildSpec(plugin=f"{__name__}:Idle"),
        context=RunContext(endpoints=(endpoint,), log_folder=str(tmp_path)),
    )
    with pytest.raises(CairnError, match="a stop was requested"):
        host.launch_child(child, lambda: None)

    assert spawned == []
    host.close()


def test_failing_transition_raises_and_ends_the_component(bus: ZenohBus, endpoint: str) -> None:
    host = hosted(bus, endpoint, Broken)

    with pytest.raises(CairnError, match="configure failed: ValueError: no device"):
        host.request("configure", LIMIT_S)

    assert host.ended.wait(LIMIT_S)
    assert host.exit_report is not None
    assert (host.exit_report.normal, host.exit_report.reason) == (
        False,
        "on_configure: ValueError: no device",
    )
    host.close()


def test_loop_that_fails_has_an_abnormal_exit_report(
    bus: ZenohBus, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    host = hosted(bus, endpoint, Idle)

    def defect(*_: object) -> None:
        raise KeyError("a defect of ours")

    monkeypatch.setattr(host.runtime, "request", defect)
    with pytest.raises(ChildUnavailable, match="a defect of ours"):
        host.request("configure", LIMIT_S)

    assert host.ended.wait(LIMIT_S)
    assert host.exit_report is not None
    assert not host.exit_report.normal
    assert_words(host.exit_report.reason, "loop", "KeyError: 'a defect of ours'")
    host.close()
