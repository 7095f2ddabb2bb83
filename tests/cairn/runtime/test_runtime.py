"""The guarantees of a running component: handlers, randomness, error reports, log."""

import logging
from typing import Any

import pytest

from cairn import CairnError, Out, every, on
from cairn.bus.lockstep_bus import LockstepBus
from cairn.runtime.handlers import handlers_of
from cairn.runtime.rosout import RosoutHandler
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.schemas.rcl_interfaces import Log
from cairn.schemas.std_msgs import String
from cairn.testing.lockstep import ComponentHarness
from tests.cairn.runtime.base import Base, word
from tests.wording import assert_words, words_in_order


def test_handlers_of_one_port_are_called_in_order_of_declaration_bases_first() -> None:
    class More(Base):
        @on("word")
        def again(self, word: String) -> None:
            self.calls.append(f"again {word.data}")

        @on("word")
        def receive(self, word: String) -> None:
            self.calls.append(f"better {word.data}")

    harness = ComponentHarness(More)
    harness.publish("word", word("a"))

    assert harness.component.calls == ["better a", "again a"]
    assert harness.component.word.latest == word("a")


def test_override_without_a_decorator_is_not_a_handler() -> None:
    class Deaf(Base):
        def receive(self, word: String) -> None:
            self.calls.append("deaf")

    harness = ComponentHarness(Deaf)
    harness.publish("word", word("a"))

    assert harness.component.calls == []


def test_second_decorator_on_a_method_is_rejected() -> None:
    with pytest.raises(CairnError, match=words_in_order("receive", "@on", "@every")):

        class _Twice:
            @on("word")
            @every(hz=1)
            def receive(self, word: String) -> None: ...


def test_handler_of_a_missing_input_is_rejected_and_the_inputs_listed() -> None:
    class Odd(Base):
        @on("cmd_vel")
        def odd(self, twist: Twist) -> None: ...

    with pytest.raises(CairnError, match=words_in_order("cmd_vel", "word, map")):
        handlers_of(Odd)


def test_component_with_invalid_handlers_leaves_no_node() -> None:
    class Odd(Base):
        @on("nothing")
        def odd(self, twist: Twist) -> None: ...

    with pytest.raises(CairnError, match="there is no input port nothing"):
        ComponentHarness(Odd)


def test_deactivation_handles_pending_messages_up_to_the_depth() -> None:
    class Echo(Base):
        again: Out[String]

        @on("word")
        def receive(self, word: String) -> None:
            self.calls.append(word.data)
            self.again.publish(word)

    harness = ComponentHarness(Echo, topics={"again": "word"})
    harness.publish("word", word("a"), handled=False)

    harness.request("deactivate")

    assert harness.component.calls == ["a"] * 5
    assert harness.state == "inactive"


def test_latched_input_is_received_again_after_reactivation() -> None:
    harness = ComponentHarness(Base, activate=False)
    harness.publish("map", word("first"))
    for _ in range(2):
        harness.activate() if harness.state == "unconfigured" else harness.request("activate")
        harness.run_for(0)
        harness.request("deactivate")
    assert harness.component.calls == ["map first"] * 2
    assert harness.component.map.latest == word("first")

    harness.request("cleanup")

    assert harness.component.map.latest is None


def test_port_counters_survive_reactivation() -> None:
    harness = ComponentHarness(Base, activate=False)
    harness.request("configure")
    for _ in range(2):
        harness.request("activate")
        harness.publish("word", *[word(str(number)) for number in range(8)], handled=False)
        harness.request("deactivate")

    (status, *_) = harness.runtime.status().ports
    assert (status.port, status.messages, status.dropped) == ("word", 10, 6)


def test_unknown_and_failed_requests_leave_the_component_active() -> None:
    class Obeys(Base):
        def on_request(self, verb: str, arguments: Any) -> Any:
            if verb == "fail":
                raise KeyError("broken request")
            if verb == "exit":
                raise SystemExit(1)
            return super().on_request(verb, arguments)

    harness = ComponentHarness(Obeys)
    for verb, refusal in (
        ("dance", "^component: unknown request dance$"),
        ("fail", "^component: fail failed: KeyError: 'broken request'$"),
        ("exit", r"^it called sys\.exit\(1\)"),
    ):
        with pytest.raises(CairnError, match=refusal):
            harness.request(verb)

    assert harness.state == "active"


def test_randomness_depends_on_seed_and_name_alone() -> None:
    def drawn(name: str, seed: int, **more: Any) -> list[float]:
        harness = ComponentHarness(Base, name=name, seed=seed, activate=False, **more)
        return [float(number) for number in harness.component.random.random(3)]

    first = drawn("left", 1)
    assert drawn("left", 1, restarts=3, robot="other") == first
    assert drawn("right", 1) != first
    assert drawn("left", 2) != first


def test_publishing_nan_fails_the_component_and_names_field_and_port(
    caplog: pytest.LogCaptureFixture,
) -> None:
    class Diverges(Base):
        @on("word")
        def receive(self, word: String) -> None:
            self.cmd_vel.publish(Twist(linear=Vector3(x=float("nan"))))

    harness = ComponentHarness(Diverges, name="base")
    harness.publish("word", word("a"))

    (end,) = harness.ends
    invalid = "InvalidMessage: geometry_msgs/msg/Vector3: x = nan"
    assert end.reason.startswith(f"receive (port word): {invalid}")
    assert end.reason.endswith("(for port cmd_vel)")
    assert [record.name for record in caplog.records if "x = nan" in record.message] == [
        "cairn.robot.base"
    ]
    assert harness.take("cmd_vel") == []


def test_publishing_another_type_fails_the_component_and_names_the_port() -> None:
    class Confused(Base):
        @on("word")
        def receive(self, word: String) -> None:
            self.cmd_vel.publish(word)  # type: ignore[arg-type]

    harness = ComponentHarness(Confused, name="base")
    harness.publish("word", word("a"))

    assert_words(
        harness.ends[0].reason,
        "base",
        "port cmd_vel",
        "geometry_msgs/msg/Twist",
        "std_msgs/msg/String",
    )


def test_log_record_never_fails_the_component(monkeypatch: pytest.MonkeyPatch) -> None:
    class Logs(Base):
        @on("word")
        def receive(self, word: String) -> None:
            self.log.warning("odd \0 %s", "\ud800")
            self.log.warning("two %s %s", "only one")
            self.log.warning("after")

    harness = ComponentHarness(Logs, name="logs", activate=False)
    # What pytest captures goes to another process where tests run in parallel: UTF-8 only.
    monkeypatch.setattr(harness.runtime.log, "propagate", False)
    entries = harness.read("/rosout", Log)
    handler = RosoutHandler(harness.runtime.node)
    harness.runtime.log.addHandler(handler)
    raising, logging.raiseExceptions = logging.raiseExceptions, False
    try:
        harness.activate()
        harness.publish("word", word("a"))
    finally:
        logging.raiseExceptions = raising
        harness.runtime.log.removeHandler(handler)

    assert [(entry.level, entry.msg) for entry in entries.take()] == [
        (30, "odd ? ?"), (30, "after")
    ]  # fmt: skip
    assert harness.state == "active"


def test_processes_that_were_not_discovered_are_named_at_activation(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(LockstepBus, "wait_for_peers", lambda *_: ["process 7", "process 8"])
    ComponentHarness(Base)

    (warning,) = [record for record in caplog.records if record.levelno == logging.WARNING]
    assert_words(warning.getMessage(), "process 7, process 8", "`ps PID`", "restarted")
