"""A component follows its life cycle and does only what its state allows."""

import logging
from collections.abc import Iterator

import pytest

from cairn import SECOND, CairnError, every
from cairn.runtime.process_exit import ExitReport
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.testing.lockstep import ComponentHarness
from tests.cairn.runtime.recording_component import BOOM, STEPS, RecordingComponent, failing, word
from tests.wording import assert_words


def test_whole_life_cycle() -> None:
    harness = ComponentHarness(RecordingComponent, activate=False)
    states = [harness.state]
    for step in STEPS:
        assert harness.request(step) == harness.state
        states.append(harness.state)

    assert states == [
        "unconfigured", "inactive", "active", "inactive", "unconfigured", "finalized"
    ]  # fmt: skip
    assert harness.component.calls == list(STEPS)
    assert harness.ends == [ExitReport(True, "shut down")]


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
    steps: tuple[str, ...], calls: list[str]
) -> None:
    harness = ComponentHarness(RecordingComponent, activate=False)
    for step in (*steps, "shutdown"):
        harness.request(step)

    assert harness.component.calls == calls
    assert harness.ends == [ExitReport(True, "shut down")]


def test_transition_from_the_wrong_state_is_rejected() -> None:
    harness = ComponentHarness(RecordingComponent, activate=False)

    for step in ("activate", "deactivate", "cleanup"):
        with pytest.raises(CairnError, match=f"cannot {step} in state unconfigured; possible are"):
            harness.request(step)

    assert (harness.state, harness.component.calls) == ("unconfigured", [])


def test_only_an_active_component_publishes() -> None:
    class Chatty(RecordingComponent):
        def step(self, name: str) -> None:
            super().step(name)
            self.echo.publish(word(name))

    harness = ComponentHarness(Chatty, activate=False)
    for step in STEPS[:-1]:
        harness.request(step)
    harness.activate()
    harness.request("shutdown")

    assert [one.data for one in harness.take("echo")] == ["activate", "deactivate"] * 2


def test_status_is_published_at_each_transition_and_at_the_end() -> None:
    harness = ComponentHarness(failing("receive a"), name="arm", restarts=2, activate=False)
    statuses = harness.read("component_status", ComponentStatus)
    harness.activate()
    harness.publish("word", word("b"), word("a"))

    published = statuses.take()
    assert [(one.state, one.reason) for one in published] == [
        ("inactive", ""), ("active", ""), ("finalized", f"receive (port word): {BOOM}")
    ]  # fmt: skip
    last = published[-1]
    plugin = f"{RecordingComponent.__module__}:Failing"
    assert (last.component, last.plugin, last.restarts) == ("arm", plugin, 2)
    ports = {port.port: (port.topic, port.messages) for port in last.ports}
    assert ports == {"word": ("/robot/word", 2), "echo": ("/robot/echo", 1)}


@pytest.fixture
def no_log() -> Iterator[None]:
    """Nothing is logged: pytest passes what it captures between processes, in UTF-8 only."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


@pytest.mark.usefixtures("no_log")
def test_reason_with_nul_or_surrogates_is_published() -> None:

    class Odd(RecordingComponent):
        def step(self, name: str) -> None:
            if name.startswith("receive"):
                raise RuntimeError("\0 and \ud800")

    harness = ComponentHarness(Odd)
    statuses = harness.read("component_status", ComponentStatus)
    harness.publish("word", word("a"))

    assert len(harness.ends) == 1
    assert_words(statuses.take()[-1].reason, "receive (port word)", "RuntimeError: ? and ?")


def test_messages_and_timers_are_handled_only_while_active() -> None:
    class Ticking(RecordingComponent):
        @every(hz=1)
        def tick(self) -> None:
            self.step(f"tick {self.clock.now() // SECOND}")

    harness = ComponentHarness(Ticking, activate=False)
    harness.request("configure")
    harness.publish("word", word("a"))
    harness.run_to(2 * SECOND)
    harness.request("activate")
    harness.run_to(4 * SECOND)
    harness.request("deactivate")
    harness.publish("word", word("b"))
    harness.run_to(6 * SECOND)
    harness.request("activate")
    harness.run_to(8 * SECOND)

    assert [call for call in harness.component.calls if call.startswith(("tick", "receive"))] == [
        "tick 3", "tick 4", "tick 7", "tick 8"
    ]  # fmt: skip
