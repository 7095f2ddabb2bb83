"""Every way in which a component can fail or finish, and how its end is reported."""

from typing import Any

import pytest

from cairn import SECOND, CairnError
from cairn.process_exit import ExitReport
from cairn.runtime.component import ComponentContext
from cairn.schemas.std_msgs import String
from tests.cairn.runtime.part import BOOM, STEPS, Part, failing, word
from tests.cairn.runtime.running import Lockstep, taken


def test_failed_construction_names_component_and_cause_and_leaves_the_bus(
    lockstep: Lockstep,
) -> None:
    class Broken(Part):
        def __init__(self, context: ComponentContext) -> None:
            raise ValueError("no camera")

    class Exits(Part):
        def __init__(self, context: ComponentContext) -> None:
            raise SystemExit(1)

    for broken, cause in ((Broken, "ValueError: no camera"), (Exits, "SystemExit: 1")):
        with pytest.raises(CairnError, match=f"^eye: plugin camera cannot be .*: {cause}$"):
            lockstep.add(broken, name="eye", plugin="camera")


@pytest.mark.parametrize("step", STEPS)
def test_failed_transition_ends_the_component_with_its_reason(
    lockstep: Lockstep, step: str
) -> None:
    part = lockstep.add(failing(step))
    for before in STEPS[: STEPS.index(step)]:
        part.ask(before)

    with pytest.raises(CairnError, match=f"^part: {step} failed: {BOOM}$"):
        part.ask(step)

    assert part.component.calls[-2:] == [step, "error boom"]
    assert part.state == "finalized"
    assert part.ends == [ExitReport(False, f"on_{step}: {BOOM}")]


@pytest.mark.parametrize("step", STEPS[:-1])
def test_component_that_recovers_from_a_failed_transition_can_be_configured_again(
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


def test_failed_shutdown_ends_the_component(lockstep: Lockstep) -> None:
    part = lockstep.add(failing("shutdown", recovers=True))
    part.activate()

    with pytest.raises(CairnError, match="shutdown failed"):
        part.ask("shutdown")

    assert (part.state, part.ends) == ("finalized", [ExitReport(False, f"on_shutdown: {BOOM}")])


def test_failed_handler_ends_the_component(lockstep: Lockstep) -> None:
    part = lockstep.add(failing("hear a"))
    part.activate()
    lockstep.publish("word", word("a"), word("b"))
    lockstep.run()

    assert part.component.calls == ["configure", "activate", "hear a", "error boom"]
    assert part.ends == [ExitReport(False, f"hear (port word): {BOOM}")]


def test_failed_on_error_ends_the_component(lockstep: Lockstep) -> None:
    part = lockstep.add(failing("hear a", recovers=ValueError("worse")))
    part.activate()
    lockstep.publish("word", word("a"))
    lockstep.run()

    assert part.ends == [ExitReport(False, f"hear (port word): {BOOM}")]


def test_recovered_component_is_active_again(lockstep: Lockstep) -> None:
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


def test_fourth_recovery_within_the_window_ends_the_component(lockstep: Lockstep) -> None:
    part = lockstep.add(failing("hear a", recovers=True))
    part.activate()
    for _ in range(4):
        assert part.state == "active"
        lockstep.publish("word", word("a"))
        lockstep.run_until(lockstep.executor.now() + SECOND)

    assert part.ends == [ExitReport(False, f"hear (port word): {BOOM}")]


def test_rare_recoveries_are_not_limited(lockstep: Lockstep) -> None:
    part = lockstep.add(failing("hear a", recovers=True))
    part.activate()
    for _ in range(10):
        lockstep.publish("word", word("a"))
        lockstep.run_until(lockstep.executor.now() + 4 * SECOND)

    assert (part.state, part.ends) == ("active", [])


def test_failed_recovery_is_retried_up_to_the_limit(lockstep: Lockstep) -> None:
    part = lockstep.add(failing("hear a", "configure", recovers=True))
    part.component.fails_in = frozenset({"hear a"})
    part.activate()
    part.component.fails_in = frozenset({"hear a", "configure"})
    lockstep.publish("word", word("a"))
    lockstep.run()

    assert part.component.calls.count("configure") == 4
    assert part.ends == [ExitReport(False, f"on_configure: {BOOM}")]


def test_finish_ends_normally_after_the_pending_messages(lockstep: Lockstep) -> None:
    part = lockstep.add(Part)
    heard = lockstep.read("echo", String)
    part.activate()
    lockstep.publish("word", word("finish"), word("waiting"))
    lockstep.run()

    assert taken(heard) == [word("finish"), word("waiting")]
    assert part.component.calls[2:] == [
        "hear finish", "hear waiting", "deactivate", "cleanup", "shutdown"
    ]  # fmt: skip
    assert part.ends == [ExitReport(True, "all is said")]


@pytest.mark.parametrize("step", ["configure", "activate", "deactivate"])
def test_finish_in_a_transition_ends_the_component_after_it(lockstep: Lockstep, step: str) -> None:
    class Finishes(Part):
        def step(self, name: str) -> None:
            super().step(name)
            if name == step:
                self.finish("enough")

    part = lockstep.add(Finishes)
    for one in STEPS[: STEPS.index(step) + 1]:
        part.ask(one)

    assert part.ends == [ExitReport(True, "enough")]
    assert part.component.calls.count("shutdown") == 1
    assert part.component.calls.count("deactivate") <= 1


def test_finish_in_a_request_ends_the_component(lockstep: Lockstep) -> None:
    class Obeys(Part):
        def on_request(self, verb: str, arguments: Any) -> str:
            self.finish(f"asked to {verb}")
            return "yes"

    part = lockstep.add(Obeys)
    part.activate()

    assert part.ask("leave") == "yes"
    assert part.ends == [ExitReport(True, "asked to leave")]


def test_failure_after_finish_is_a_failure(lockstep: Lockstep) -> None:
    part = lockstep.add(failing(recovers=True))
    part.activate()
    lockstep.publish("word", word("finish and fail"))
    lockstep.run()
    assert (part.state, part.ends) == ("active", [])
    lockstep.publish("word", word("still there"))
    lockstep.run()

    assert (part.state, part.ends) == ("active", [])


def test_finish_during_shutdown_ends_it_once(lockstep: Lockstep) -> None:
    part = lockstep.add(Part)
    part.activate()
    lockstep.publish("word", word("finish"))

    part.ask("deactivate")

    assert part.component.calls == [
        "configure", "activate", "hear finish", "deactivate", "cleanup", "shutdown"
    ]  # fmt: skip
    assert (part.state, part.ends) == ("finalized", [ExitReport(True, "all is said")])


@pytest.mark.parametrize("step", ["deactivate", "shutdown"])
def test_failure_during_deactivation_fails_the_transition(lockstep: Lockstep, step: str) -> None:
    part = lockstep.add(failing("hear a"))
    part.activate()
    lockstep.publish("word", word("a"))

    with pytest.raises(CairnError, match=rf"part: {step} failed: hear \(port word\): {BOOM}"):
        part.ask(step)

    assert part.component.calls == ["configure", "activate", "hear a", "error boom"]
    assert (part.state, part.ends) == (
        "finalized",
        [ExitReport(False, f"hear (port word): {BOOM}")],
    )


def test_finish_with_failed_shutdown_is_one_failure(lockstep: Lockstep) -> None:
    part = lockstep.add(failing("cleanup"))
    part.activate()
    lockstep.publish("word", word("finish"))
    lockstep.run()

    assert part.ends == [ExitReport(False, f"on_shutdown: {BOOM}")]


def test_sys_exit_is_a_failure(lockstep: Lockstep) -> None:
    part = lockstep.add(Part)
    part.activate()
    lockstep.publish("word", word("exit"))
    lockstep.run()

    (end,) = part.ends
    assert end.reason == "hear (port word): it called sys.exit(3); use self.finish(reason)"
