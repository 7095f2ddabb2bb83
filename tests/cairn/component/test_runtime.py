"""What a running component can rely on: handlers, parameters, randomness, status, complaints."""

import logging
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import Field

from cairn.bus.lockstep_bus import LockstepBus
from cairn.bus.qos import LATCHED, RELIABLE
from cairn.component.component import Component, Context
from cairn.component.handlers import every, handlers_of, on
from cairn.component.parameters import Config, ParameterRefused
from cairn.component.ports import In, Out
from cairn.component.rosout import RosoutHandler
from cairn.component.runtime import End
from cairn.errors import CairnError
from schemas.geometry_msgs import Twist, Vector3
from schemas.rcl_interfaces import Log
from schemas.std_msgs import String
from tests.cairn.component.running import LIMIT_S, Lockstep, Threaded, taken


class Limits(Config):
    high: float = Field(1.0, gt=0, le=5, description="Greatest speed [m/s].")


class BaseConfig(Config):
    gain: float = Field(0.5, ge=0, le=1, description="Gain [1].")
    limits: Limits = Field(default_factory=Limits, description="Limits.")


class Base(Component):
    """Hears words, has parameters, drives."""

    config: BaseConfig
    word: In[String] = In(qos=RELIABLE.with_depth(5))
    map: In[String] = In(qos=LATCHED)
    cmd_vel: Out[Twist]

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self.calls: list[str] = []

    @on("word")
    def hear(self, word: String) -> None:
        self.calls.append(word.data)

    @on("map")
    def chart(self, word: String) -> None:
        self.calls.append(f"map {word.data}")


@pytest.fixture
def lockstep() -> Lockstep:
    return Lockstep()


def word(data: str) -> String:
    return String(data=data)


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


def test_an_override_without_a_decorator_is_no_handler(lockstep: Lockstep) -> None:
    class Deaf(Base):
        def hear(self, word: String) -> None:
            self.calls.append("deaf")

    part = lockstep.add(Deaf)
    part.activate()
    lockstep.publish("word", word("a"))
    lockstep.run()

    assert part.component.calls == []


def test_a_method_has_one_decorator() -> None:
    with pytest.raises(CairnError, match=r"hear has two of the decorators @on and @every"):

        class _Twice:
            @on("word")
            @every(hz=1)
            def hear(self, word: String) -> None: ...


def test_a_handler_of_no_input_is_refused_with_the_inputs() -> None:
    class Odd(Base):
        @on("cmd_vel")
        def odd(self, twist: Twist) -> None: ...

    with pytest.raises(CairnError, match="no input port cmd_vel; the inputs are word, map"):
        handlers_of(Odd)


def test_a_component_whose_handlers_cannot_be_bound_leaves_no_node_behind() -> None:
    class Odd(Base):
        @on("nothing")
        def odd(self, twist: Twist) -> None: ...

    lockstep = Lockstep()
    with pytest.raises(CairnError, match="there is no input port nothing"):
        lockstep.add(Odd)


def test_deactivation_handles_what_waits_but_no_more_than_a_port_holds(
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


def test_a_latched_input_is_there_again_after_reactivation(lockstep: Lockstep) -> None:
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


def test_counts_of_a_port_outlive_a_reactivation(lockstep: Lockstep) -> None:
    part = lockstep.add(Base)
    part.ask("configure")
    for _ in range(2):
        part.ask("activate")
        lockstep.publish("word", *[word(str(number)) for number in range(8)])
        part.ask("deactivate")

    (status, *_) = part.runtime.status().ports
    assert (status.port, status.messages, status.dropped) == ("word", 10, 6)


def test_parameters_change_while_it_runs_all_or_none(lockstep: Lockstep) -> None:
    part = lockstep.add(Base, parameters={"gain": 0.25})
    part.activate()

    part.ask("set_parameters", **{"gain": 0.75, "limits.high": 2})
    assert part.component.config == BaseConfig(gain=0.75, limits=Limits(high=2.0))
    with pytest.raises(ParameterRefused, match=r"limits\.high = 9 refused"):
        part.ask("set_parameters", **{"gain": 0.1, "limits.high": 9})

    assert part.component.config == BaseConfig(gain=0.75, limits=Limits(high=2.0))
    assert {one["name"]: one["value"] for one in part.ask("parameters")} == {
        "gain": 0.75, "limits.high": 2.0
    }  # fmt: skip


def test_a_component_may_refuse_parameters_or_fail_at_it_and_keeps_the_old(
    lockstep: Lockstep,
) -> None:
    class Picky(Base):
        def on_parameters(self, new: Config) -> None:
            assert isinstance(new, BaseConfig)
            if new.gain < self.config.gain:
                raise ParameterRefused("gain may only grow while it drives")
            if new.gain > 0.9:
                raise ZeroDivisionError("dear me")

    part = lockstep.add(Picky)
    part.activate()
    with pytest.raises(ParameterRefused, match=r"^gain may only grow while it drives$"):
        part.ask("set_parameters", gain=0.1)
    with pytest.raises(CairnError, match="part: set_parameters failed: ZeroDivisionError: dear me"):
        part.ask("set_parameters", gain=1.0)

    assert part.component.config.gain == 0.5
    assert part.state == "active"


def test_an_unknown_request_is_refused_and_one_that_fails_leaves_it_active(
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
        ("dance", "^part does not know the request dance$"),
        ("fail", "^part: fail failed: KeyError: 'dear me'$"),
        ("exit", r"^it called sys\.exit\(1\)"),
    ):
        with pytest.raises(CairnError, match=refusal):
            part.ask(verb)

    assert part.state == "active"


def test_refused_parameters_are_named_before_it_exists(lockstep: Lockstep) -> None:
    with pytest.raises(CairnError, match=r"base: parameters refused: (.|\n)*gain"):
        lockstep.add(Base, name="base", parameters={"gain": 7})


def test_randomness_comes_from_seed_and_name_alone(lockstep: Lockstep) -> None:
    def drawn(name: str, seed: int, **more: Any) -> list[float]:
        part = lockstep.add(Base, name=name, seed=seed, **more)
        return [float(number) for number in part.component.random.random(3)]

    first = drawn("left", 1)
    assert drawn("left", 1, restarts=3, parent="x", robot="other") == first
    assert drawn("right", 1) != first
    assert drawn("left", 2) != first


def test_a_nan_that_it_would_publish_fails_it_naming_field_and_port(
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


def test_a_message_of_another_type_fails_it_naming_component_and_port(lockstep: Lockstep) -> None:
    class Confused(Base):
        @on("word")
        def hear(self, word: String) -> None:
            self.cmd_vel.publish(word)  # type: ignore[arg-type]

    part = lockstep.add(Confused, name="base")
    part.activate()
    lockstep.publish("word", word("a"))
    lockstep.run()

    assert part.ends[0].reason == (
        "hear (port word): base: port cmd_vel writes geometry_msgs/msg/Twist, "
        "not std_msgs/msg/String"
    )


class Slow(Base):
    """Stays in a handler until it is let go."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self.within = threading.Semaphore(0)
        self.release = threading.Semaphore(0)
        self.at_once = 0
        self.most_at_once = 0

    def stay(self) -> None:
        self.at_once += 1
        self.most_at_once = max(self.most_at_once, self.at_once)
        self.within.release()
        assert self.release.acquire(timeout=LIMIT_S)
        self.at_once -= 1

    @on("word")
    def hear(self, word: String) -> None:
        self.stay()

    @every(hz=1000)
    def tick(self) -> None:
        self.stay()

    def on_request(self, verb: str, arguments: Any) -> str:
        self.stay()
        return "done"


@pytest.fixture
def slow() -> Iterator[Threaded]:
    threaded = Threaded(Slow, LockstepBus(), name="slow")
    yield threaded
    component = threaded.runtime.component
    assert isinstance(component, Slow)
    component.release.release(1_000_000)
    threaded.close()


def test_its_status_tells_the_handler_it_is_in_and_for_how_long(slow: Threaded) -> None:
    component = slow.runtime.component
    assert isinstance(component, Slow)
    assert slow.runtime.status().handler == ""
    slow.activate()
    assert component.within.acquire(timeout=LIMIT_S)

    first, second = slow.runtime.status(), slow.runtime.status()

    assert first.handler == "tick"
    assert 0 <= first.handler_s < second.handler_s
    assert first.state == "active"


def test_timers_messages_and_requests_are_handled_one_at_a_time(slow: Threaded) -> None:
    component = slow.runtime.component
    assert isinstance(component, Slow)
    slow.activate()
    assert component.within.acquire(timeout=LIMIT_S)
    for _ in range(20):
        slow.loop.deliver(lambda: slow.runtime.run("hear", component.hear, word("a")))
        slow.loop.post(lambda: slow.runtime.run("hear", component.hear, word("b")))
    component.release.release(60)

    assert slow.ask("wait") == "done"
    assert component.most_at_once == 1


def test_timers_that_overload_it_do_not_keep_it_from_requests(slow: Threaded) -> None:
    component = slow.runtime.component
    assert isinstance(component, Slow)
    slow.activate()
    component.release.release(1_000_000)

    assert [slow.ask("wait") for _ in range(20)] == ["done"] * 20
    assert slow.ask("deactivate") == "inactive"


def test_a_log_record_never_fails_who_logs(
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


def test_a_component_that_finishes_ends_its_thread() -> None:
    class Finishes(Base):
        def on_activate(self) -> None:
            self.finish("nothing to do")

    part = Threaded(Finishes, LockstepBus())
    part.activate()

    assert part.ended.wait(LIMIT_S)
    part.thread.join(LIMIT_S)
    assert not part.thread.is_alive()
    assert part.end == End(True, "nothing to do")
