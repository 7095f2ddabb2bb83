"""A component walks its life cycle, and every way in which a step of it can fail ends somewhere."""

import logging
from typing import Any

import pytest

from cairn.clock import SECOND
from cairn.component.component import Component, Context
from cairn.component.handlers import every, on
from cairn.component.ports import In, Out
from cairn.component.runtime import End
from cairn.errors import CairnError
from schemas.cairn_msgs import ComponentStatus
from schemas.std_msgs import String
from tests.cairn.component.running import Lockstep, taken

STEPS = ("configure", "activate", "deactivate", "cleanup", "shutdown")
BOOM = "RuntimeError: boom"


class Part(Component):
    """Notes its calls, and fails where it is told to."""

    word: In[String]
    echo: Out[String]

    fails_in: frozenset[str] = frozenset()
    recovers: Any = False

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self.calls: list[str] = []

    def step(self, name: str) -> None:
        self.calls.append(name)
        if name in self.fails_in:
            raise RuntimeError("boom")

    def on_configure(self) -> None:
        self.step("configure")

    def on_activate(self) -> None:
        self.step("activate")

    def on_deactivate(self) -> None:
        self.step("deactivate")

    def on_cleanup(self) -> None:
        self.step("cleanup")

    def on_shutdown(self) -> None:
        self.step("shutdown")

    def on_error(self, error: Exception) -> bool:
        self.calls.append(f"error {error}")
        if isinstance(self.recovers, Exception):
            raise self.recovers
        return bool(self.recovers)

    @on("word")
    def hear(self, word: String) -> None:
        self.step(f"hear {word.data}")
        if word.data == "finish":
            self.finish("all is said")
        if word.data == "finish and fail":
            self.finish("all is said")
            raise RuntimeError("boom")
        if word.data == "exit":
            raise SystemExit(3)
        self.echo.publish(word)


@pytest.fixture
def lockstep() -> Lockstep:
    return Lockstep()


def failing(*steps: str, recovers: Any = False) -> type[Part]:
    return type("Failing", (Part,), {"fails_in": frozenset(steps), "recovers": recovers})


def word(data: str) -> String:
    return String(data=data)


def test_the_whole_life(lockstep: Lockstep) -> None:
    part = lockstep.add(Part)
    states = [part.state]
    for step in STEPS:
        assert part.ask(step) == part.state
        states.append(part.state)

    assert states == [
        "unconfigured", "inactive", "active", "inactive", "unconfigured", "finalized"
    ]  # fmt: skip
    assert part.component.calls == list(STEPS)
    assert part.ends == [End(True, "shut down")]


@pytest.mark.parametrize(
    ("steps", "calls"),
    [
        ((), ["shutdown"]),
        (("configure",), ["configure", "cleanup", "shutdown"]),
        (
            ("configure", "activate"),
            ["configure", "activate", "deactivate", "cleanup", "shutdown"],
        ),
    ],
)
def test_a_shutdown_from_any_state_gives_back_all_that_was_taken(
    lockstep: Lockstep, steps: tuple[str, ...], calls: list[str]
) -> None:
    part = lockstep.add(Part)
    for step in (*steps, "shutdown"):
        part.ask(step)

    assert part.component.calls == calls
    assert part.ends == [End(True, "shut down")]


def test_a_step_that_does_not_begin_here_is_refused_and_changes_nothing(lockstep: Lockstep) -> None:
    part = lockstep.add(Part)

    for step in ("activate", "deactivate", "cleanup"):
        with pytest.raises(CairnError, match=f"cannot {step} in state unconfigured; possible are"):
            part.ask(step)

    assert (part.state, part.component.calls) == ("unconfigured", [])


def test_who_cannot_be_constructed_is_named_with_the_cause_and_leaves_the_bus(
    lockstep: Lockstep,
) -> None:
    class Broken(Part):
        def __init__(self, context: Context) -> None:
            raise ValueError("no camera")

    class Exits(Part):
        def __init__(self, context: Context) -> None:
            raise SystemExit(1)

    for broken, cause in ((Broken, "ValueError: no camera"), (Exits, "SystemExit: 1")):
        with pytest.raises(CairnError, match=f"^eye: plugin camera cannot be .*: {cause}$"):
            lockstep.add(broken, name="eye", plugin="camera")


@pytest.mark.parametrize("step", STEPS)
def test_a_step_that_fails_ends_the_component_and_says_why(lockstep: Lockstep, step: str) -> None:
    part = lockstep.add(failing(step))
    for before in STEPS[: STEPS.index(step)]:
        part.ask(before)

    with pytest.raises(CairnError, match=f"^part: {step} failed: {BOOM}$"):
        part.ask(step)

    assert part.component.calls[-2:] == [step, "error boom"]
    assert part.state == "finalized"
    assert part.ends == [End(False, f"on_{step}: {BOOM}")]


@pytest.mark.parametrize("step", STEPS[:-1])
def test_who_recovers_from_a_step_that_fails_can_be_configured_anew(
    lockstep: Lockstep, step: str
) -> None:
    part = lockstep.add(failing(step, recovers=True))
    for before in STEPS[: STEPS.index(step)]:
        part.ask(before)
    with pytest.raises(CairnError, match=f"{step} failed"):
        part.ask(step)
    assert (part.state, part.ends) == ("unconfigured", [])

    part.component.fails_in = frozenset()
    part.activate()
    lockstep.run()

    assert part.state == "active"


def test_a_shutdown_that_fails_is_an_end_nevertheless(lockstep: Lockstep) -> None:
    part = lockstep.add(failing("shutdown", recovers=True))
    part.activate()

    with pytest.raises(CairnError, match="shutdown failed"):
        part.ask("shutdown")

    assert (part.state, part.ends) == ("finalized", [End(False, f"on_shutdown: {BOOM}")])


def test_a_handler_that_fails_ends_the_component(lockstep: Lockstep) -> None:
    part = lockstep.add(failing("hear a"))
    part.activate()
    lockstep.publish("word", word("a"), word("b"))
    lockstep.run()

    assert part.component.calls == ["configure", "activate", "hear a", "error boom"]
    assert part.ends == [End(False, f"hear (port word): {BOOM}")]


def test_on_error_may_fail_as_well(lockstep: Lockstep) -> None:
    part = lockstep.add(failing("hear a", recovers=ValueError("worse")))
    part.activate()
    lockstep.publish("word", word("a"))
    lockstep.run()

    assert part.ends == [End(False, f"hear (port word): {BOOM}")]


def test_who_recovers_works_on_anew(lockstep: Lockstep) -> None:
    part = lockstep.add(failing("hear a", recovers=True))
    part.activate()
    lockstep.publish("word", word("a"))
    lockstep.run()
    assert part.component.word.latest is None
    lockstep.publish("word", word("b"))
    lockstep.run()

    assert part.component.calls == [
        "configure", "activate", "hear a", "error boom", "configure", "activate", "hear b"
    ]  # fmt: skip
    assert (part.state, part.ends) == ("active", [])


def test_recovering_has_a_limit(lockstep: Lockstep) -> None:
    part = lockstep.add(failing("hear a", recovers=True))
    part.activate()
    for _ in range(4):
        assert part.state == "active"
        lockstep.publish("word", word("a"))
        lockstep.run_until(lockstep.executor.now() + SECOND)

    assert part.ends == [End(False, f"hear (port word): {BOOM}")]


def test_recovering_now_and_then_has_none(lockstep: Lockstep) -> None:
    part = lockstep.add(failing("hear a", recovers=True))
    part.activate()
    for _ in range(10):
        lockstep.publish("word", word("a"))
        lockstep.run_until(lockstep.executor.now() + 4 * SECOND)

    assert (part.state, part.ends) == ("active", [])


def test_a_recovery_that_fails_is_tried_again_until_it_is_too_often(lockstep: Lockstep) -> None:
    part = lockstep.add(failing("hear a", "configure", recovers=True))
    part.component.fails_in = frozenset({"hear a"})
    part.activate()
    part.component.fails_in = frozenset({"hear a", "configure"})
    lockstep.publish("word", word("a"))
    lockstep.run()

    assert part.component.calls.count("configure") == 4
    assert part.ends == [End(False, f"on_configure: {BOOM}")]


def test_finishing_is_a_normal_end_behind_what_waits_already(lockstep: Lockstep) -> None:
    part = lockstep.add(Part)
    heard = lockstep.read("echo", String)
    part.activate()
    lockstep.publish("word", word("finish"), word("waiting"))
    lockstep.run()

    assert taken(heard) == [word("finish"), word("waiting")]
    assert part.component.calls[2:] == [
        "hear finish", "hear waiting", "deactivate", "cleanup", "shutdown"
    ]  # fmt: skip
    assert part.ends == [End(True, "all is said")]


@pytest.mark.parametrize("step", ["configure", "activate", "deactivate"])
def test_finishing_in_a_step_ends_the_component_behind_it(lockstep: Lockstep, step: str) -> None:
    class Finishes(Part):
        def step(self, name: str) -> None:
            super().step(name)
            if name == step:
                self.finish("enough")

    part = lockstep.add(Finishes)
    for one in STEPS[: STEPS.index(step) + 1]:
        part.ask(one)

    assert part.ends == [End(True, "enough")]
    assert part.component.calls.count("shutdown") == 1
    assert part.component.calls.count("deactivate") <= 1


def test_finishing_in_the_answer_to_a_request_ends_the_component(lockstep: Lockstep) -> None:
    class Obeys(Part):
        def on_request(self, verb: str, arguments: Any) -> str:
            self.finish(f"told to {verb}")
            return "yes"

    part = lockstep.add(Obeys)
    part.activate()

    assert part.ask("leave") == "yes"
    assert part.ends == [End(True, "told to leave")]


def test_who_finishes_and_fails_has_failed(lockstep: Lockstep) -> None:
    part = lockstep.add(failing(recovers=True))
    part.activate()
    lockstep.publish("word", word("finish and fail"))
    lockstep.run()
    assert (part.state, part.ends) == ("active", [])
    lockstep.publish("word", word("still there"))
    lockstep.run()

    assert (part.state, part.ends) == ("active", [])


def test_finishing_while_the_last_messages_are_handled_ends_it_once(lockstep: Lockstep) -> None:
    part = lockstep.add(Part)
    part.activate()
    lockstep.publish("word", word("finish"))

    part.ask("deactivate")

    assert part.component.calls == [
        "configure", "activate", "hear finish", "deactivate", "cleanup", "shutdown"
    ]  # fmt: skip
    assert (part.state, part.ends) == ("finalized", [End(True, "all is said")])


@pytest.mark.parametrize("step", ["deactivate", "shutdown"])
def test_failing_while_the_last_messages_are_handled_fails_the_step(
    lockstep: Lockstep, step: str
) -> None:
    part = lockstep.add(failing("hear a"))
    part.activate()
    lockstep.publish("word", word("a"))

    with pytest.raises(CairnError, match=rf"part: {step} failed: hear \(port word\): {BOOM}"):
        part.ask(step)

    assert part.component.calls == ["configure", "activate", "hear a", "error boom"]
    assert (part.state, part.ends) == ("finalized", [End(False, f"hear (port word): {BOOM}")])


def test_a_finish_whose_shutdown_fails_is_one_failure(lockstep: Lockstep) -> None:
    part = lockstep.add(failing("cleanup"))
    part.activate()
    lockstep.publish("word", word("finish"))
    lockstep.run()

    assert part.ends == [End(False, f"on_shutdown: {BOOM}")]


def test_calling_exit_is_a_failure_like_others(lockstep: Lockstep) -> None:
    part = lockstep.add(Part)
    part.activate()
    lockstep.publish("word", word("exit"))
    lockstep.run()

    (end,) = part.ends
    assert end.reason == "hear (port word): it called sys.exit(3); use self.finish(reason)"


def test_only_an_active_component_publishes(lockstep: Lockstep) -> None:
    class Chatty(Part):
        def step(self, name: str) -> None:
            super().step(name)
            self.echo.publish(word(name))

    heard = lockstep.read("echo", String)
    part = lockstep.add(Chatty)
    for step in STEPS[:-1]:
        part.ask(step)
    part.activate()
    part.ask("shutdown")

    assert [one.data for one in taken(heard)] == ["activate", "deactivate"] * 2


def test_its_status_tells_of_each_step_and_of_the_end(lockstep: Lockstep) -> None:
    statuses = lockstep.read("component_status", ComponentStatus)
    part = lockstep.add(failing("hear a"), name="ear", plugin="ears", parent="head", restarts=2)
    part.activate()
    lockstep.publish("word", word("b"), word("a"))
    lockstep.run()

    told = taken(statuses)
    assert [(one.state, one.reason) for one in told] == [
        ("inactive", ""), ("active", ""), ("finalized", f"hear (port word): {BOOM}")
    ]  # fmt: skip
    last = told[-1]
    assert (last.component, last.plugin, last.parent, last.restarts) == ("ear", "ears", "head", 2)
    ports = {port.port: (port.topic, port.messages) for port in last.ports}
    assert ports == {"word": ("/robot/word", 2), "echo": ("/robot/echo", 1)}


def test_a_reason_that_no_message_can_carry_is_told_nevertheless(
    lockstep: Lockstep, caplog: pytest.LogCaptureFixture
) -> None:
    # What pytest captures goes to another process where tests run in parallel: UTF-8 only.
    caplog.set_level(logging.CRITICAL + 1, "cairn")

    class Odd(Part):
        def step(self, name: str) -> None:
            if name.startswith("hear"):
                raise RuntimeError("\0 and \ud800")

    statuses = lockstep.read("component_status", ComponentStatus)
    part = lockstep.add(Odd)
    part.activate()
    lockstep.publish("word", word("a"))
    lockstep.run()

    assert len(part.ends) == 1
    assert taken(statuses)[-1].reason == "hear (port word): RuntimeError: ? and ?"


def test_no_message_is_handled_and_no_timer_runs_but_when_active(lockstep: Lockstep) -> None:
    class Ticking(Part):
        @every(hz=1)
        def tick(self) -> None:
            self.step(f"tick {self.clock.now() // SECOND}")

    part = lockstep.add(Ticking)
    part.ask("configure")
    lockstep.publish("word", word("a"))
    lockstep.run_until(2 * SECOND)
    part.ask("activate")
    lockstep.run_until(4 * SECOND)
    part.ask("deactivate")
    lockstep.publish("word", word("b"))
    lockstep.run_until(6 * SECOND)
    part.ask("activate")
    lockstep.run_until(8 * SECOND)

    assert [call for call in part.component.calls if call.startswith(("tick", "hear"))] == [
        "tick 3", "tick 4", "tick 7", "tick 8"
    ]  # fmt: skip
