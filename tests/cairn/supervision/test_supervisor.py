"""The supervising engine with scripted children on a clock of their own."""

import pytest

from cairn.supervision.child import ChildEnd, ChildRules, LauncherLost
from cairn.supervision.policy import Intensity
from cairn.supervision.supervisor import Escalate, StartFailed

from .scripted_children import (
    ScriptedChild,
    World,
    dies,
    does_not_answer,
    ends,
    fails,
    is_ignored,
    takes,
)

CRASH = ChildEnd(False, "was killed by SIGSEGV")
DONE = ChildEnd(True, "ended with exit code 0")
START_BASE = ["launch base", "configure base", "activate base"]
START_SCANNER = ["launch scanner", "configure scanner", "activate scanner"]
STOP_BASE = ["deactivate base", "shutdown base"]
STOP_SCANNER = ["deactivate scanner", "shutdown scanner"]


@pytest.fixture
def world() -> World:
    return World()


def test_children_start_in_order_each_when_the_former_is_active(world: World) -> None:
    supervisor = world.supervisor("base", "scanner")
    supervisor.start_all()
    assert world.steps == START_BASE + START_SCANNER
    assert [child.state for child in supervisor.status()] == ["active", "active"]


def test_children_stop_in_reverse_order(world: World) -> None:
    supervisor = world.supervisor("base", "scanner")
    supervisor.start_all()
    world.take_steps()
    supervisor.stop_all()
    assert world.steps == STOP_SCANNER + STOP_BASE
    assert world.running() == []
    assert [child.state for child in supervisor.status()] == ["unloaded", "unloaded"]


def test_all_can_start_again_after_all_were_stopped(world: World) -> None:
    supervisor = world.supervisor("base")
    supervisor.start_all()
    supervisor.stop_all()
    supervisor.start_all()
    assert world.steps == START_BASE + STOP_BASE + START_BASE


def test_a_child_that_ended_is_restarted_and_the_reason_kept(world: World) -> None:
    supervisor = world.supervisor("base", "scanner")
    supervisor.start_all()
    world.take_steps()
    world.children["base"].end = CRASH
    supervisor.reconcile()
    assert world.steps == START_BASE
    status = supervisor.status()[0]
    assert (status.state, status.incarnation, status.restarts) == ("active", 2, 1)
    assert status.reason == "was killed by SIGSEGV"


def test_late_news_of_a_former_incarnation_change_nothing(world: World) -> None:
    supervisor = world.supervisor("base")
    supervisor.start_all()
    world.children["base"].end = CRASH
    supervisor.reconcile()
    world.take_steps()
    supervisor.child_hung("base", 1, "drive", 5.0)
    supervisor.reconcile()
    assert world.steps == []
    assert supervisor.status()[0].incarnation == 2


def test_one_for_all_stops_the_living_and_starts_everybody(world: World) -> None:
    supervisor = world.supervisor("base", "scanner", strategy="one_for_all")
    supervisor.start_all()
    world.take_steps()
    world.children["base"].end = CRASH
    supervisor.reconcile()
    assert world.steps == STOP_SCANNER + START_BASE + START_SCANNER


def test_children_that_ended_together_count_as_one_restart(world: World) -> None:
    supervisor = world.supervisor(
        "base", "scanner", strategy="one_for_all", intensity=Intensity(1, 10.0)
    )
    supervisor.start_all()
    world.take_steps()
    world.children["base"].end = CRASH
    world.children["scanner"].end = CRASH
    supervisor.reconcile()
    assert world.steps == START_BASE + START_SCANNER


def test_a_hung_child_is_killed_and_its_handler_named(world: World) -> None:
    supervisor = world.supervisor("base", "scanner")
    supervisor.start_all()
    world.take_steps()
    supervisor.child_hung("scanner", 1, "read_scan", 5.25)
    supervisor.reconcile()
    assert world.steps == ["kill scanner", *START_SCANNER]
    assert ("hung", "hung in read_scan for 5.2 s and was killed") in world.told("scanner")
    assert supervisor.status()[1].reason == "hung in read_scan for 5.2 s and was killed"


def test_a_restarted_child_that_fails_to_configure_is_ended_and_tried_again(world: World) -> None:
    world.script("base", {}, {"configure": fails("no device /dev/ttyUSB0")})
    supervisor = world.supervisor("base", "scanner")
    supervisor.start_all()
    world.take_steps()
    world.children["base"].end = CRASH
    supervisor.reconcile()
    assert world.steps == [*("launch base", "configure base", "terminate base"), *START_BASE]
    assert ("start_failed", "no device /dev/ttyUSB0") in world.told("base")
    assert supervisor.status()[0].restarts == 2


def test_a_child_that_cannot_start_at_first_escalates_at_once_with_its_own_error(
    world: World,
) -> None:
    world.script("scanner", {"launch": fails("scanner: no module rplidar")})
    supervisor = world.supervisor("base", "scanner", "localizer")
    with pytest.raises(Escalate, match=r"^scanner: no module rplidar$"):
        supervisor.start_all()
    assert world.steps == [*START_BASE, "launch scanner", *STOP_BASE]
    assert world.running() == []
    supervisor.reconcile()
    assert world.running() == []


def test_a_child_that_keeps_dying_while_it_starts_escalates(world: World) -> None:
    world.script("scanner", *[{"activate": dies("was killed by SIGSEGV")}] * 4)
    supervisor = world.supervisor("base", "scanner", "localizer")
    with pytest.raises(Escalate, match=r"more than 3 restarts .* scanner was killed by SIGSEGV"):
        supervisor.start_all()
    assert world.steps.count("launch scanner") == 4
    assert "launch localizer" not in world.steps
    assert world.running() == []


def test_a_start_that_does_not_end_in_time_is_a_failed_start(world: World) -> None:
    world.script("base", {"launch": takes(8.0), "configure": does_not_answer})
    supervisor = world.supervisor(ChildRules("base", start_timeout_s=20.0))
    supervisor.start_all()
    assert ("start_failed", "base did not answer within 12 s") in world.told("base")
    assert supervisor.status()[0].state == "active"


def test_a_child_that_dies_while_starting_is_restarted(world: World) -> None:
    world.script("base", {"activate": dies("was killed by SIGABRT")})
    supervisor = world.supervisor("base")
    supervisor.start_all()
    assert ("start_failed", "base was killed by SIGABRT") in world.told("base")
    assert supervisor.status()[0].incarnation == 2


def test_a_child_that_dies_while_its_sibling_starts_is_restarted_in_order(world: World) -> None:
    supervisor = world.supervisor("base", "scanner", "localizer")

    def kill_base(text: str) -> None:
        if text == "starting scanner: activate":
            world.children["base"].end = CRASH

    world.on_step = kill_base
    supervisor.start_all()
    assert world.steps == [
        *START_BASE,
        *START_SCANNER,
        *START_BASE,
        *("launch localizer", "configure localizer", "activate localizer"),
    ]


def test_too_many_restarts_stop_all_and_escalate(world: World) -> None:
    supervisor = world.supervisor("base", "scanner", intensity=Intensity(2, 10.0))
    supervisor.start_all()
    for _ in range(2):
        world.children["scanner"].end = CRASH
        supervisor.reconcile()
    world.children["scanner"].end = CRASH
    with pytest.raises(Escalate, match="more than 2 restarts within 10 s; last, scanner: was"):
        supervisor.reconcile()
    assert world.running() == []
    assert world.events[-1].what == "given_up"
    assert world.events[-1].child == "mobile_supervisor"


def test_stopping_goes_on_past_a_child_that_fails_to(world: World) -> None:
    world.script("scanner", {"deactivate": fails("motor does not stop")})
    supervisor = world.supervisor("base", "scanner")
    supervisor.start_all()
    world.take_steps()
    supervisor.stop_all()
    assert world.steps == STOP_SCANNER + STOP_BASE
    assert ("stop_failed", "motor does not stop") in world.told("scanner")


def test_a_child_that_does_not_stop_is_terminated_and_then_killed(world: World) -> None:
    world.script("base", {"deactivate": does_not_answer, "terminate": is_ignored})
    supervisor = world.supervisor(ChildRules("base", stop_timeout_s=3.0))
    supervisor.start_all()
    world.take_steps()
    before = world.now_s
    supervisor.stop_all()
    assert world.steps == ["deactivate base", "terminate base", "kill base"]
    assert world.running() == []
    assert world.now_s - before == pytest.approx(3.0 + 2.0)


def test_even_a_child_that_cannot_be_killed_does_not_hold_up_the_others(world: World) -> None:
    world.script("scanner", dict.fromkeys(("shutdown", "terminate", "kill"), is_ignored))
    supervisor = world.supervisor("base", "scanner")
    supervisor.start_all()
    supervisor.stop_all()
    assert world.running() == ["scanner"]
    assert ("stop_failed", "did not end even when killed") in world.told("scanner")


def test_a_child_that_cannot_be_killed_is_never_doubled_but_escalates(world: World) -> None:
    world.script("scanner", {"kill": fails("it is placed in its supervisor's process")})
    supervisor = world.supervisor("base", "scanner")
    supervisor.start_all()
    supervisor.child_hung("scanner", 1, "read_scan", 6.0)
    with pytest.raises(Escalate, match="scanner does not end even when killed"):
        supervisor.reconcile()
    assert world.running() == ["scanner"]
    with pytest.raises(StartFailed, match="does not end even when killed"):
        supervisor.load("scanner")
    world.children["scanner"].end = CRASH
    supervisor.load("scanner")
    assert world.children["scanner"].incarnation == 2


def test_the_loss_of_the_launcher_is_passed_on_and_counts_for_no_child(world: World) -> None:
    def is_lost(child: ScriptedChild, timeout_s: float) -> None:
        raise LauncherLost("the zygote is lost")

    world.script("scanner", {"launch": is_lost})
    supervisor = world.supervisor("base", "scanner", intensity=Intensity(0, 1.0))
    with pytest.raises(LauncherLost, match="the zygote is lost"):
        supervisor.start_all()
    supervisor.stop_all()
    assert world.running() == []
    supervisor.start_all()
    assert world.running() == ["base", "scanner"]


@pytest.mark.parametrize("end", [DONE, ChildEnd(True, "not all offsets found", success=False)])
def test_the_normal_end_of_a_significant_child_stops_all(world: World, end: ChildEnd) -> None:
    supervisor = world.supervisor("base", ChildRules("replay", significant=True))
    supervisor.start_all()
    world.take_steps()
    world.children["replay"].end = end
    supervisor.reconcile()
    assert world.steps == STOP_BASE
    assert supervisor.finished == ChildEnd(
        True, f"replay has finished: {end.reason}", success=end.success
    )
    supervisor.reconcile()
    assert world.running() == []


def test_before_each_step_it_says_what_it_does_and_for_how_long_at_most(world: World) -> None:
    world.script("base", {"launch": takes(2.0)})
    supervisor = world.supervisor(ChildRules("base", start_timeout_s=10.0, stop_timeout_s=4.0))
    supervisor.start_all()
    supervisor.stop_all()
    assert world.progress == [
        ("launching base", 10.0),
        ("starting base: configure", 8.0),
        ("starting base: activate", 8.0),
        ("stopping base: deactivate", 4.0),
        ("stopping base: shutdown", 4.0),
    ]


def test_a_dead_child_is_not_asked_to_stop(world: World) -> None:
    supervisor = world.supervisor("base")
    supervisor.start_all()
    ends(world.children["base"], 0.0)
    world.take_steps()
    supervisor.stop_all()
    assert world.steps == []
