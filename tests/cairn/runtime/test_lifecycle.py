"""A component follows its life cycle and does only what its state allows."""

import logging

import pytest

from cairn import SECOND, CairnError, every
from cairn.process_exit import ExitReport
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.std_msgs import String
from tests.cairn.runtime.part import BOOM, STEPS, Part, failing, word
from tests.cairn.runtime.running import Lockstep, taken


def test_whole_life_cycle(lockstep: Lockstep) -> None:
    part = lockstep.add(Part)
    states = [part.state]
    for step in STEPS:
        assert part.ask(step) == part.state
        states.append(part.state)

    assert states == [
        "unconfigured", "inactive", "active", "inactive", "unconfigured", "finalized"
    ]  # fmt: skip
    assert part.component.calls == list(STEPS)
    assert part.ends == [ExitReport(True, "shut down")]


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
def test_shutdown_from_any_state_releases_everything(
    lockstep: Lockstep, steps: tuple[str, ...], calls: list[str]
) -> None:
    part = lockstep.add(Part)
    for step in (*steps, "shutdown"):
        part.ask(step)

    assert part.component.calls == calls
    assert part.ends == [ExitReport(True, "shut down")]


def test_transition_from_the_wrong_state_is_rejected(lockstep: Lockstep) -> None:
    part = lockstep.add(Part)

    for step in ("activate", "deactivate", "cleanup"):
        with pytest.raises(CairnError, match=f"cannot {step} in state unconfigured; possible are"):
            part.ask(step)

    assert (part.state, part.component.calls) == ("unconfigured", [])


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


def test_status_is_published_at_each_transition_and_at_the_end(lockstep: Lockstep) -> None:
    statuses = lockstep.read("component_status", ComponentStatus)
    part = lockstep.add(failing("hear a"), name="ear", plugin="ears", parent="head", restarts=2)
    part.activate()
    lockstep.publish("word", word("b"), word("a"))
    lockstep.run()

    published = taken(statuses)
    assert [(one.state, one.reason) for one in published] == [
        ("inactive", ""), ("active", ""), ("finalized", f"hear (port word): {BOOM}")
    ]  # fmt: skip
    last = published[-1]
    assert (last.component, last.plugin, last.parent, last.restarts) == ("ear", "ears", "head", 2)
    ports = {port.port: (port.topic, port.messages) for port in last.ports}
    assert ports == {"word": ("/robot/word", 2), "echo": ("/robot/echo", 1)}


def test_reason_with_nul_or_surrogates_is_published(
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


def test_messages_and_timers_are_handled_only_while_active(lockstep: Lockstep) -> None:
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
