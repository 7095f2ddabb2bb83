"""The guarantees of a running component: handlers, randomness, error reports, log."""

import logging
from typing import Any

import pytest

from cairn import LATCHED, CairnError, Out, every, on
from cairn.runtime.ports import handlers_of
from cairn.runtime.rosout import RosoutHandler
from cairn.schemas.geometry_msgs import Twist, Vector3
from cairn.schemas.rcl_interfaces import Log
from cairn.schemas.std_msgs import String
from tests.cairn.runtime.base import Base, word
from tests.cairn.runtime.running import Lockstep, taken


def test_handlers_of_one_port_are_called_in_order_of_declaration_bases_first(
    lockstep: Lockstep,
) -> None:
    class More(Base):
        @on("word")
        def again(self, word: String) -> None:
            self.calls.append(f"again {word.data}")

        @on("word")
        def hear(self, word: String) -> None:
            self.calls.append(f"better {word.data}")

    part = lockstep.add(More)
    part.activate()
    lockstep.publish("word", word("a"))
    lockstep.run()

    assert part.component.calls == ["better a", "again a"]
    assert part.component.word.latest == word("a")


def test_override_without_a_decorator_is_not_a_handler(lockstep: Lockstep) -> None:
    class Deaf(Base):
        def hear(self, word: String) -> None:
            self.calls.append("deaf")

    part = lockstep.add(Deaf)
    part.activate()
    lockstep.publish("word", word("a"))
    lockstep.run()

    assert part.component.calls == []


def test_second_decorator_on_a_method_is_rejected() -> None:
    with pytest.raises(CairnError, match=r"hear has two of the decorators @on and @every"):

        class _Twice:
            @on("word")
            @every(hz=1)
            def hear(self, word: String) -> None: ...


def test_handler_of_a_missing_input_is_rejected_and_the_inputs_listed() -> None:
    class Odd(Base):
        @on("cmd_vel")
        def odd(self, twist: Twist) -> None: ...

    with pytest.raises(CairnError, match="no input port cmd_vel; the inputs are word, map"):
        handlers_of(Odd)


def test_component_with_invalid_handlers_leaves_no_node() -> None:
    class Odd(Base):
        @on("nothing")
        def odd(self, twist: Twist) -> None: ...

    lockstep = Lockstep()
    with pytest.raises(CairnError, match="there is no input port nothing"):
        lockstep.add(Odd)


def test_deactivation_handles_pending_messages_up_to_the_depth(
    lockstep: Lockstep,
) -> None:
    class Echo(Base):
        again: Out[String]

        @on("word")
        def hear(self, word: String) -> None:
            self.calls.append(word.data)
            self.again.publish(word)

    part = lockstep.add(Echo, topics={"again": "word"})
    part.activate()
    lockstep.publish("word", word("a"))

    part.ask("deactivate")

    assert part.component.calls == ["a"] * 5
    assert part.state == "inactive"


def test_latched_input_is_received_again_after_reactivation(lockstep: Lockstep) -> None:
    part = lockstep.add(Base)
    lockstep.publish("map", word("first"), qos=LATCHED)
    for _ in range(2):
        part.activate() if part.state == "unconfigured" else part.ask("activate")
        lockstep.run()
        part.ask("deactivate")
    assert part.component.calls == ["map first"] * 2
    assert part.component.map.latest == word("first")

    part.ask("cleanup")

    assert part.component.map.latest is None


def test_port_counters_survive_reactivation(lockstep: Lockstep) -> None:
    part = lockstep.add(Base)
    part.ask("configure")
    for _ in range(2):
        part.ask("activate")
        lockstep.publish("word", *[word(str(number)) for number in range(8)])
        part.ask("deactivate")

    (status, *_) = part.runtime.status().ports
    assert (status.port, status.messages, status.dropped) == ("word", 10, 6)


def test_unknown_and_failed_requests_leave_the_component_active(
    lockstep: Lockstep,
) -> None:
    class Obeys(Base):
        def on_request(self, verb: str, arguments: Any) -> Any:
            if verb == "fail":
                raise KeyError("dear me")
            if verb == "exit":
                raise SystemExit(1)
            return super().on_request(verb, arguments)

    part = lockstep.add(Obeys)
    part.activate()
    for verb, refusal in (
        ("dance", "^part: unknown request dance$"),
        ("fail", "^part: fail failed: KeyError: 'dear me'$"),
        ("exit", r"^it called sys\.exit\(1\)"),
    ):
        with pytest.raises(CairnError, match=refusal):
            part.ask(verb)

    assert part.state == "active"


def test_randomness_depends_on_seed_and_name_alone(lockstep: Lockstep) -> None:
    def drawn(name: str, seed: int, **more: Any) -> list[float]:
        part = lockstep.add(Base, name=name, seed=seed, **more)
        return [float(number) for number in part.component.random.random(3)]

    first = drawn("left", 1)
    assert drawn("left", 1, restarts=3, parent="x", robot="other") == first
    assert drawn("right", 1) != first
    assert drawn("left", 2) != first


def test_publishing_nan_fails_the_component_and_names_field_and_port(
    lockstep: Lockstep, caplog: pytest.LogCaptureFixture
) -> None:
    class Diverges(Base):
        @on("word")
        def hear(self, word: String) -> None:
            self.cmd_vel.publish(Twist(linear=Vector3(x=float("nan"))))

    commands = lockstep.read("cmd_vel", Twist)
    part = lockstep.add(Diverges, name="base")
    part.activate()
    lockstep.publish("word", word("a"))
    lockstep.run()

    (end,) = part.ends
    invalid = "InvalidMessage: geometry_msgs/msg/Vector3: x = nan"
    assert end.reason.startswith(f"hear (port word): {invalid}")
    assert end.reason.endswith("(for port cmd_vel)")
    assert [record.name for record in caplog.records if "x = nan" in record.message] == [
        "cairn.robot.base"
    ]
    assert taken(commands) == []


def test_publishing_another_type_fails_the_component_and_names_the_port(lockstep: Lockstep) -> None:
    class Confused(Base):
        @on("word")
        def hear(self, word: String) -> None:
            self.cmd_vel.publish(word)  # type: ignore[arg-type]

    part = lockstep.add(Confused, name="base")
    part.activate()
    lockstep.publish("word", word("a"))
    lockstep.run()

    assert part.ends[0].reason == (
        "hear (port word): base: port cmd_vel publishes geometry_msgs/msg/Twist, "
        "not std_msgs/msg/String"
    )


def test_log_record_never_fails_the_component(
    lockstep: Lockstep, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Logs(Base):
        @on("word")
        def hear(self, word: String) -> None:
            self.log.warning("odd \0 %s", "\ud800")
            self.log.warning("two %s %s", "only one")
            self.log.warning("after")

    part = lockstep.add(Logs, name="logs")
    # What pytest captures goes to another process where tests run in parallel: UTF-8 only.
    monkeypatch.setattr(part.runtime.log, "propagate", False)
    entries = lockstep.read("/rosout", Log)
    handler = RosoutHandler(part.runtime.node)
    part.runtime.log.addHandler(handler)
    raising, logging.raiseExceptions = logging.raiseExceptions, False
    try:
        part.activate()
        lockstep.publish("word", word("a"))
        lockstep.run()
    finally:
        logging.raiseExceptions = raising
        part.runtime.log.removeHandler(handler)

    assert [(entry.level, entry.msg) for entry in taken(entries)] == [
        (30, "odd ? ?"), (30, "after")
    ]  # fmt: skip
    assert part.state == "active"
