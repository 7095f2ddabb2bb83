"""Every way in which a component can fail or finish, and how its end is reported."""

from typing import Any

import pytest

from cairn import CairnError
from cairn.runtime.component import ComponentContext
from cairn.runtime.process_exit import ExitReport
from cairn.testing.lockstep import ComponentHarness
from tests.cairn.runtime.recording_component import BOOM, STEPS, RecordingComponent, failing, word
from tests.wording import assert_words


def test_failed_construction_names_component_and_cause_and_leaves_the_bus() -> None:
    class Broken(RecordingComponent):
        def __init__(self, context: ComponentContext) -> None:
            raise ValueError("no camera")

    class Exits(RecordingComponent):
        def __init__(self, context: ComponentContext) -> None:
            raise SystemExit(1)

    for broken, cause in ((Broken, "ValueError: no camera"), (Exits, "SystemExit: 1")):
        with pytest.raises(CairnError, match=f"^eye: plugin .* cannot be .*: {cause}$"):
            ComponentHarness(broken, name="eye")


@pytest.mark.parametrize("step", STEPS)
def test_failed_transition_ends_the_component_with_its_reason(step: str) -> None:
    harness = ComponentHarness(failing(step), activate=False)
    for before in STEPS[: STEPS.index(step)]:
        harness.request(before)

    with pytest.raises(CairnError, match=f"^component: {step} failed: {BOOM}$"):
        harness.request(step)

    assert harness.component.calls[-2:] == [step, "error boom"]
    assert harness.state == "finalized"
    assert harness.ends == [ExitReport(False, f"on_{step}: {BOOM}")]


@pytest.mark.parametrize("step", STEPS[:-1])
def test_component_that_recovers_from_a_failed_transition_can_be_configured_again(
    step: str,
) -> None:
    harness = ComponentHarness(failing(step, recovers=True), activate=False)
    for before in STEPS[: STEPS.index(step)]:
        harness.request(before)
    with pytest.raises(CairnError, match=f"{step} failed"):
        harness.request(step)
    assert (harness.state, harness.ends) == ("unconfigured", [])

    harness.component.fails_in = frozenset()
    harness.activate()

    assert harness.state == "active"


def test_failed_shutdown_ends_the_component() -> None:
    harness = ComponentHarness(failing("shutdown", recovers=True))

    with pytest.raises(CairnError, match="shutdown failed"):
        harness.request("shutdown")

    assert (harness.state, harness.ends) == (
        "finalized",
        [ExitReport(False, f"on_shutdown: {BOOM}")],
    )


def test_failed_handler_ends_the_component() -> None:
    harness = ComponentHarness(failing("receive a"))
    harness.publish("word", word("a"), word("b"))

    assert harness.component.calls == ["configure", "activate", "receive a", "error boom"]
    assert harness.ends == [ExitReport(False, f"receive (port word): {BOOM}")]


def test_failed_on_error_ends_the_component() -> None:
    harness = ComponentHarness(failing("receive a", recovers=ValueError("worse")))
    harness.publish("word", word("a"))

    assert harness.ends == [ExitReport(False, f"receive (port word): {BOOM}")]


def test_recovered_component_is_active_again() -> None:
    harness = ComponentHarness(failing("receive a", recovers=True))
    harness.publish("word", word("a"))
    assert harness.component.word.latest is None
    harness.publish("word", word("b"))

    assert harness.component.calls == [
        "configure", "activate", "receive a", "error boom", "configure", "activate", "receive b"
    ]  # fmt: skip
    assert (harness.state, harness.ends) == ("active", [])


def test_fourth_recovery_within_the_window_ends_the_component() -> None:
    harness = ComponentHarness(failing("receive a", recovers=True))
    for _ in range(4):
        assert harness.state == "active"
        harness.publish("word", word("a"))
        harness.run_for(1)

    assert harness.ends == [ExitReport(False, f"receive (port word): {BOOM}")]


def test_rare_recoveries_are_not_limited() -> None:
    harness = ComponentHarness(failing("receive a", recovers=True))
    for _ in range(10):
        harness.publish("word", word("a"))
        harness.run_for(4)

    assert (harness.state, harness.ends) == ("active", [])


def test_failed_recovery_is_retried_up_to_the_limit() -> None:
    harness = ComponentHarness(failing("receive a", "configure", recovers=True), activate=False)
    harness.component.fails_in = frozenset({"receive a"})
    harness.activate()
    harness.component.fails_in = frozenset({"receive a", "configure"})
    harness.publish("word", word("a"))

    assert harness.component.calls.count("configure") == 4
    assert harness.ends == [ExitReport(False, f"on_configure: {BOOM}")]


def test_finish_ends_normally_after_the_pending_messages() -> None:
    harness = ComponentHarness(RecordingComponent, activate=False)
    harness.activate()
    harness.publish("word", word("finish"), word("waiting"))

    assert harness.take("echo") == [word("finish"), word("waiting")]
    assert harness.component.calls[2:] == [
        "receive finish", "receive waiting", "deactivate", "cleanup", "shutdown"
    ]  # fmt: skip
    assert harness.ends == [ExitReport(True, "work is done")]


@pytest.mark.parametrize("step", ["configure", "activate", "deactivate"])
def test_finish_in_a_transition_ends_the_component_after_it(step: str) -> None:
    class Finishes(RecordingComponent):
        def step(self, name: str) -> None:
            super().step(name)
            if name == step:
                self.finish("enough")

    harness = ComponentHarness(Finishes, activate=False)
    for one in STEPS[: STEPS.index(step) + 1]:
        harness.request(one)

    assert harness.ends == [ExitReport(True, "enough")]
    assert harness.component.calls.count("shutdown") == 1
    assert harness.component.calls.count("deactivate") <= 1


def test_finish_in_a_request_ends_the_component() -> None:
    class Obeys(RecordingComponent):
        def on_request(self, verb: str, arguments: Any) -> str:
            self.finish(f"asked to {verb}")
            return "yes"

    harness = ComponentHarness(Obeys)

    assert harness.request("leave") == "yes"
    assert harness.ends == [ExitReport(True, "asked to leave")]


def test_failure_after_finish_is_a_failure() -> None:
    harness = ComponentHarness(failing(recovers=True))
    harness.publish("word", word("finish and fail"))
    assert (harness.state, harness.ends) == ("active", [])
    harness.publish("word", word("still there"))

    assert (harness.state, harness.ends) == ("active", [])


def test_finish_during_shutdown_ends_it_once() -> None:
    harness = ComponentHarness(RecordingComponent)
    harness.publish("word", word("finish"), handled=False)

    harness.request("deactivate")

    assert harness.component.calls == [
        "configure", "activate", "receive finish", "deactivate", "cleanup", "shutdown"
    ]  # fmt: skip
    assert (harness.state, harness.ends) == ("finalized", [ExitReport(True, "work is done")])


@pytest.mark.parametrize("step", ["deactivate", "shutdown"])
def test_failure_during_deactivation_fails_the_transition(step: str) -> None:
    harness = ComponentHarness(failing("receive a"))
    harness.publish("word", word("a"), handled=False)

    with pytest.raises(
        CairnError, match=rf"component: {step} failed: receive \(port word\): {BOOM}"
    ):
        harness.request(step)

    assert harness.component.calls == ["configure", "activate", "receive a", "error boom"]
    assert (harness.state, harness.ends) == (
        "finalized",
        [ExitReport(False, f"receive (port word): {BOOM}")],
    )


def test_finish_with_failed_shutdown_is_one_failure() -> None:
    harness = ComponentHarness(failing("cleanup"))
    harness.publish("word", word("finish"))

    assert harness.ends == [ExitReport(False, f"on_shutdown: {BOOM}")]


def test_sys_exit_is_a_failure() -> None:
    harness = ComponentHarness(RecordingComponent)
    harness.publish("word", word("exit"))

    (end,) = harness.ends
    assert_words(end.reason, "receive (port word)", "sys.exit(3)", "self.finish(reason)")
