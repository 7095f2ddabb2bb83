"""The children of a supervisor: scripted ones on a virtual clock, and requests for them."""

import math

import pytest

from cairn import CairnError
from cairn.errors import Escalate
from cairn.processes.child import ZygoteLost, stop_share
from cairn.processes.supervisor import ChildGroup, StartFailed, UnknownChild
from cairn.runtime.child_spec import ChildSpec, Supervision
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.lifecycle import LifecycleState
from cairn.runtime.process_exit import ExitReport
from tests.wording import assert_words, words_in_order

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

CRASH = ExitReport(False, "killed by SIGSEGV (signal 11)")
DONE = ExitReport(True, "exit code 0")
START_BASE = ["launch base", "configure base", "activate base"]
START_SCANNER = ["launch scanner", "configure scanner", "activate scanner"]
START_CAMERA = ["launch camera", "configure camera", "activate camera"]
STOP_BASE = ["deactivate base", "shutdown base"]
STOP_SCANNER = ["deactivate scanner", "shutdown scanner"]


@pytest.fixture
def world() -> World:
    return World()


def test_children_start_in_order_each_when_the_one_before_is_active(world: World) -> None:
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


def test_stopped_children_can_all_start_again(world: World) -> None:
    supervisor = world.supervisor("base")
    supervisor.start_all()
    supervisor.stop_all()
    supervisor.start_all()
    assert world.steps == START_BASE + STOP_BASE + START_BASE


def test_child_of_a_restarted_supervisor_learns_that_it_has_run_before(world: World) -> None:
    spec = ChildSpec(plugin="supervisor", children={"base": ChildSpec(plugin="test")})
    launch = LaunchRequest(name="mobile_supervisor", spec=spec, incarnation=2)

    ChildGroup(launch, world, world.log.logger, on_exit=lambda: None).start_all()

    assert world.children["base"].incarnation == 2


def test_ended_child_is_restarted_and_the_reason_is_kept(world: World) -> None:
    supervisor = world.supervisor("base", "scanner")
    supervisor.start_all()
    world.take_steps()
    world.children["base"].end = CRASH
    supervisor.reconcile()
    assert world.steps == START_BASE
    status = supervisor.status()[0]
    assert (status.state, status.incarnation) == ("active", 2)
    assert status.reason == "killed by SIGSEGV (signal 11)"
    assert world.log.lines[-4:] == [
        "WARNING child failed: base: killed by SIGSEGV (signal 11)",
        "INFO restarting child base: killed by SIGSEGV (signal 11) (1 of 3 restarts in 10 s)",
        "DEBUG child starting: base",
        "INFO child active: base",
    ]


def slow_restart_of_scanner(world: World, supervision: Supervision | None = None) -> ChildGroup:
    """Return a supervisor of base, scanner and camera, of which the scanner is being restarted."""
    supervisor = world.supervisor_with(supervision or Supervision(), "base", "scanner", "camera")
    supervisor.start_all()
    world.slow_starts = True
    world.children["scanner"].end = CRASH
    supervisor.reconcile()
    world.slow_starts = False
    world.take_steps()
    return supervisor


def states(supervisor: ChildGroup) -> list[str]:
    return [child.state for child in supervisor.status()]


def test_other_children_are_restarted_while_a_child_starts(world: World) -> None:
    supervisor = slow_restart_of_scanner(world)
    world.children["base"].end = CRASH
    world.children["camera"].beat("tick", 100.0)
    supervisor.check()
    supervisor.reconcile()
    assert world.steps == ["kill camera", *START_BASE, *START_CAMERA]
    assert "WARNING child failed: base: killed by SIGSEGV (signal 11)" in world.log.lines
    world.take_steps()
    world.finish_starts()
    supervisor.reconcile()
    assert world.steps == START_SCANNER
    assert states(supervisor) == ["active"] * 3


def test_slow_children_start_in_order_each_when_the_one_before_is_active(world: World) -> None:
    supervisor = world.supervisor("base", "scanner")
    world.slow_starts = True
    at_once = []

    def finish(step: str) -> None:
        if world.pending:
            at_once.append(len(world.pending))
            world.finish_starts()

    world.on_step = finish
    supervisor.start_all()
    assert world.steps == START_BASE + START_SCANNER
    assert at_once == [1, 1]


@pytest.mark.parametrize("request_", ["unload", "restart"])
def test_start_in_progress_is_canceled_on_request(world: World, request_: str) -> None:
    supervisor = slow_restart_of_scanner(world)
    getattr(supervisor, request_)("scanner")
    restarted = START_SCANNER if request_ == "restart" else []
    assert world.steps == ["cancel start scanner", "launch scanner", "shutdown scanner", *restarted]


def test_supervisor_that_gives_up_while_a_child_is_loaded_fails_after_the_call(
    world: World,
) -> None:
    on_request = ChildSpec(plugin="test", load="on_request")
    supervisor = world.supervisor_with(Supervision(max_restarts=0), "base", scanner=on_request)
    supervisor.start_all()
    world.slow_starts = True
    world.on_step = lambda _: setattr(world.children["base"], "end", CRASH)
    with pytest.raises(StartFailed, match="all children were stopped"):
        supervisor.load("scanner")
    assert world.running() == []
    with pytest.raises(Escalate, match="given up after more than 0 restarts"):
        world.posted[-1]()


def test_stop_cancels_a_start_in_progress(world: World) -> None:
    supervisor = slow_restart_of_scanner(world)
    supervisor.request_stop()
    supervisor.stop_all()
    assert world.running() == []
    assert states(supervisor) == ["unloaded"] * 3


def test_strategy_restarts_a_child_that_is_being_started_together_with_the_others(
    world: World,
) -> None:
    supervisor = slow_restart_of_scanner(world, Supervision(strategy="rest_for_one"))
    world.children["base"].end = CRASH
    supervisor.reconcile()
    assert world.steps[:2] == ["cancel start scanner", "launch scanner"]
    assert world.steps[-9:] == START_BASE + START_SCANNER + START_CAMERA
    assert states(supervisor) == ["active"] * 3


def test_hang_of_an_earlier_incarnation_has_no_effect(world: World) -> None:
    supervisor = world.supervisor("base")
    supervisor.start_all()
    world.children["base"].beat("drive", 4.0)
    supervisor.check()
    world.children["base"].end = CRASH
    world.now_s += 20.0
    supervisor.reconcile()
    world.take_steps()
    world.children["base"].sent = None  # it has not sent a heartbeat yet
    supervisor.check()
    supervisor.reconcile()
    assert world.steps == []
    assert supervisor.status()[0].incarnation == 2


def test_child_that_uses_too_much_memory_is_killed_and_restarted(world: World) -> None:
    supervisor = world.supervisor("scanner", base=ChildSpec(plugin="test", memory_max_mib=300))
    supervisor.start_all()
    world.take_steps()
    for child in world.children.values():
        child.memory_bytes = 300 << 20
    supervisor.check()
    assert world.steps == []
    for child in world.children.values():
        child.memory_bytes = 301 << 20
    supervisor.check()
    supervisor.reconcile()
    assert world.steps == ["kill base", *START_BASE]
    reason = "it uses 301 MiB of memory, more than memory_max_mib, 300; killed"
    assert f"ERROR child failed: base: {reason}" in world.log.lines
    assert supervisor.status()[1].reason == reason


def test_one_for_all_stops_running_children_and_starts_all(world: World) -> None:
    supervisor = world.supervisor_with(Supervision(strategy="one_for_all"), "base", "scanner")
    supervisor.start_all()
    world.take_steps()
    world.children["base"].end = CRASH
    supervisor.reconcile()
    assert world.steps == STOP_SCANNER + START_BASE + START_SCANNER


def test_children_that_ended_together_count_as_one_restart(world: World) -> None:
    supervisor = world.supervisor_with(
        Supervision(strategy="one_for_all", max_restarts=1), "base", "scanner"
    )
    supervisor.start_all()
    world.take_steps()
    world.children["base"].end = CRASH
    world.children["scanner"].end = CRASH
    supervisor.reconcile()
    assert world.steps == START_BASE + START_SCANNER


def test_hung_child_is_killed_and_its_handler_named(world: World) -> None:
    supervisor = world.supervisor("base", "scanner")
    supervisor.start_all()
    world.take_steps()
    world.children["scanner"].beat("read_scan", 4.75)
    supervisor.check()
    assert world.steps == []
    world.children["scanner"].beat("read_scan", 5.75)
    supervisor.check()
    supervisor.reconcile()
    assert world.steps == ["kill scanner", *START_SCANNER]
    reason = supervisor.status()[1].reason
    assert f"ERROR child hung: scanner: {reason}" in world.log.lines
    assert_words(reason, "hung", "5.8 s", "read_scan", "killed")


def test_child_whose_process_is_silent_is_killed(world: World) -> None:
    supervisor = world.supervisor("base", "scanner")
    supervisor.start_all()
    world.take_steps()
    world.children["base"].beat("drive")
    supervisor.check()
    world.now_s += 8.25
    world.children["scanner"].stopped = True
    supervisor.check()
    assert world.steps == ["kill base", "kill scanner"]
    assert_words(supervisor.status()[0].reason, "hung", "8.2 s", "drive", "killed")
    assert_words(supervisor.status()[1].reason, "hung", "SIGSTOP", "killed")


def test_heartbeats_that_wait_for_a_busy_supervisor_count_before_it_judges(world: World) -> None:
    supervisor = world.supervisor("base")
    supervisor.start_all()
    supervisor.check()
    world.take_steps()
    world.children["base"].beat("drive", 1.0)
    world.now_s += 60.0
    supervisor.check()
    assert world.steps == []


@pytest.mark.parametrize(
    ("handler", "state", "limit_s"),
    [
        ("on_configure", LifecycleState.UNCONFIGURED, 60.0),
        ("on_deactivate", LifecycleState.ACTIVE, 7.0),
        ("on_error", LifecycleState.ACTIVE, 5.0),
    ],
)
def test_child_that_hangs_in_a_transition_of_its_own_is_killed(
    world: World, handler: str, state: LifecycleState, limit_s: float
) -> None:
    supervisor = world.supervisor(base=ChildSpec(plugin="test", stop_timeout_s=7.0))
    supervisor.start_all()
    world.take_steps()
    world.children["base"].state = state
    world.children["base"].beat(handler, limit_s - 0.1)
    supervisor.check()
    assert world.steps == []
    world.children["base"].beat(handler, limit_s + 0.1)
    supervisor.check()
    assert world.steps == ["kill base"]
    assert_words(supervisor.status()[0].reason, "hung", handler)


def test_child_that_disturbs_its_channel_is_killed_with_the_reason(world: World) -> None:
    supervisor = world.supervisor("base")
    supervisor.start_all()
    world.take_steps()
    world.children["base"].garbage = "a message is invalid"
    supervisor.check()
    supervisor.reconcile()
    assert world.steps == ["kill base", *START_BASE]
    assert "ERROR child failed: base: a message is invalid; killed" in world.log.lines


def deviate(world: World, group: ChildGroup, state: LifecycleState) -> None:
    """Have the base report twice that it is in a state."""
    world.children["base"].state = state
    for _ in range(2):
        world.children["base"].beat()
        group.check()


def test_child_that_stays_inactive_is_activated_again(world: World) -> None:
    supervisor = world.supervisor("base")
    supervisor.start_all()
    world.take_steps()
    deviate(world, supervisor, LifecycleState.INACTIVE)
    assert world.steps == ["activate base"]
    assert any(
        line.startswith("WARNING child deviates: base: inactive instead of active")
        for line in world.log.lines
    )
    supervisor.check()
    assert world.steps == ["activate base"]


def test_child_that_is_unconfigured_for_a_moment_is_left_alone(world: World) -> None:
    supervisor = world.supervisor("base")
    supervisor.start_all()
    world.take_steps()
    base = world.children["base"]
    for state in (LifecycleState.UNCONFIGURED, LifecycleState.ACTIVE) * 2:
        base.state = state
        base.beat()
        supervisor.check()
    assert world.steps == []


def test_child_that_cannot_be_restored_is_restarted(world: World) -> None:
    supervisor = world.supervisor("base")
    world.script("base", {})
    supervisor.start_all()
    world.children["base"].script["configure"] = fails("no device")
    world.take_steps()
    deviate(world, supervisor, LifecycleState.UNCONFIGURED)
    supervisor.reconcile()
    assert world.steps == ["configure base", "kill base", *START_BASE]
    reason = supervisor.status()[0].reason
    assert_words(reason, "unconfigured instead of active", "no device")


def test_held_child_stays_in_its_state_until_it_is_released(world: World) -> None:
    supervisor = world.supervisor("base", "scanner")
    supervisor.start_all()
    world.take_steps()
    supervisor.hold("base", "unconfigured")
    assert world.take_steps() == ["deactivate base", "cleanup base"]
    deviate(world, supervisor, LifecycleState.UNCONFIGURED)
    assert world.take_steps() == []
    world.children["base"].end = CRASH
    supervisor.reconcile()
    assert world.take_steps() == ["launch base"]
    supervisor.hold("base", "active")
    assert world.take_steps() == ["configure base", "activate base"]
    supervisor.hold("base", "inactive")
    supervisor.restart("base")
    assert [child.state for child in supervisor.status()] == ["active", "active"]
    with pytest.raises(
        CairnError, match=words_in_order("finalized", "unconfigured, inactive, active")
    ):
        supervisor.hold("base", "finalized")
    supervisor.unload("scanner")
    with pytest.raises(CairnError, match="does not run"):
        supervisor.hold("scanner", "inactive")


def test_restarted_child_that_fails_to_configure_is_ended_and_tried_again(world: World) -> None:
    world.script("base", {}, {"configure": fails("no device /dev/ttyUSB0")})
    supervisor = world.supervisor("base", "scanner")
    supervisor.start_all()
    world.take_steps()
    world.children["base"].end = CRASH
    supervisor.reconcile()
    assert world.steps == [*("launch base", "configure base", "terminate base"), *START_BASE]
    assert "WARNING child start failed: base: no device /dev/ttyUSB0" in world.log.lines
    assert supervisor.status()[0].incarnation == 3


def test_child_that_refuses_its_first_start_escalates_at_once_with_its_own_error(
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


def test_child_that_keeps_dying_while_it_starts_escalates(world: World) -> None:
    world.script("scanner", *[{"activate": dies("killed by SIGSEGV (signal 11)")}] * 4)
    supervisor = world.supervisor("base", "scanner", "localizer")
    with pytest.raises(Escalate, match=words_in_order("3 restarts", "scanner", "SIGSEGV")):
        supervisor.start_all()
    assert world.steps.count("launch scanner") == 4
    assert "launch localizer" not in world.steps
    assert world.running() == []


def test_start_that_does_not_end_in_time_is_a_failed_start(world: World) -> None:
    world.script("base", {"launch": takes(8.0), "configure": does_not_answer})
    supervisor = world.supervisor(base=ChildSpec(plugin="test", start_timeout_s=20.0))
    supervisor.start_all()
    assert "ERROR child start failed: base: base did not answer within 12 s" in world.log.lines
    assert supervisor.status()[0].state == "active"


def test_child_that_dies_while_starting_is_restarted(world: World) -> None:
    world.script("base", {"activate": dies("killed by SIGABRT (signal 6)")})
    supervisor = world.supervisor("base")
    supervisor.start_all()
    assert "ERROR child start failed: base: base killed by SIGABRT (signal 6)" in world.log.lines
    assert supervisor.status()[0].incarnation == 2


def test_child_that_dies_while_its_sibling_starts_is_restarted_in_order(world: World) -> None:
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
    supervisor = world.supervisor_with(Supervision(max_restarts=2), "base", "scanner")
    supervisor.start_all()
    for _ in range(2):
        world.children["scanner"].end = CRASH
        supervisor.reconcile()
    world.children["scanner"].end = CRASH
    with pytest.raises(Escalate, match=words_in_order("2 restarts", "10 s", "scanner", "killed")):
        supervisor.reconcile()
    assert world.running() == []


def test_all_children_are_stopped_even_if_one_fails_to_stop(world: World) -> None:
    world.script("scanner", {"deactivate": fails("motor does not stop")})
    supervisor = world.supervisor("base", "scanner")
    supervisor.start_all()
    world.take_steps()
    supervisor.stop_all()
    assert world.steps == STOP_SCANNER + STOP_BASE
    assert "WARNING child stop failed: scanner: motor does not stop" in world.log.lines
    with pytest.raises(CairnError, match=r"not all .* stopped cleanly: scanner: motor does not"):
        supervisor.check_stops()
    supervisor.stop_all()
    supervisor.check_stops()


def test_child_that_does_not_stop_is_killed(world: World) -> None:
    world.script("base", {"deactivate": does_not_answer})
    supervisor = world.supervisor(base=ChildSpec(plugin="test", stop_timeout_s=3.0))
    supervisor.start_all()
    world.take_steps()
    before = world.now_s
    supervisor.stop_all()
    assert world.steps == ["deactivate base", "kill base"]
    assert world.running() == []
    assert world.now_s - before == pytest.approx(3.0)


def test_children_that_all_hang_are_stopped_within_the_limit_of_the_deployment(
    world: World,
) -> None:
    names = [f"child_{number}" for number in range(12)]
    for name in names:
        world.script(name, {"deactivate": does_not_answer})
    supervisor = world.supervisor(*names)
    supervisor.start_all()
    before = world.now_s

    supervisor.stop_all()

    assert world.running() == []
    assert world.now_s - before <= 10.0


def test_child_that_hangs_leaves_time_for_those_that_answer(world: World) -> None:
    world.script("scanner", {"deactivate": does_not_answer})
    world.script("camera", {"deactivate": does_not_answer})
    supervisor = world.supervisor("base", "gate", "scanner", "camera")
    supervisor.start_all()
    world.take_steps()
    before = world.now_s

    supervisor.request_stop(6.0)
    supervisor.stop_all()

    assert world.now_s - before < 5.0
    assert world.steps == [
        *("deactivate camera", "kill camera", "deactivate scanner", "kill scanner"),
        *("deactivate gate", "shutdown gate", "deactivate base", "shutdown base"),
    ]
    limits = dict(world.limits)
    assert limits["deactivate camera"] > 2.5
    assert limits["deactivate scanner"] > 0.4
    assert limits["deactivate base"] > 0.4


@pytest.mark.parametrize(("left_s", "kept_s"), [(8.0, 0.5), (3.0, 0.25)])
def test_components_that_hang_leave_the_others_their_part(left_s: float, kept_s: float) -> None:
    """Of twelve components, in two children of four and four of one."""
    remaining = 12
    for components in (4, 1, 1, 4, 1, 1):
        share_s = stop_share(left_s, components, remaining)
        assert share_s >= components * kept_s - 1e-9
        left_s, remaining = left_s - share_s, remaining - components
        assert left_s >= remaining * kept_s - 1e-9
    assert left_s == 0.0, "the last one may use everything"
    assert stop_share(-1.0, 1, 5) == 0.0
    assert stop_share(math.inf, 1, 1) == math.inf


def test_stop_request_reaches_running_children_at_once_with_the_time_that_they_have(
    world: World,
) -> None:
    supervisor = world.supervisor(
        "base", "scanner", late=ChildSpec(plugin="test", load="on_request")
    )
    supervisor.start_all()
    assert not supervisor.stop_overdue
    supervisor.request_stop(12.0)
    assert world.limits[-2:] == [("expect_stop base", 11.0), ("expect_stop scanner", 11.0)]
    supervisor.request_stop(60.0)
    world.now_s += 10.9
    assert not supervisor.stop_overdue
    world.now_s += 0.2
    assert supervisor.stop_overdue


def test_time_in_which_the_process_could_not_run_counts_for_the_stop_limit(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    supervisor = world.supervisor("base")
    supervisor.start_all()
    supervisor.request_stop(12.0)
    monkeypatch.setattr(world, "awake", lambda: 100.0)
    world.now_s += 11.1
    assert supervisor.stop_overdue


def test_escalation_without_a_signal_has_the_same_time_limit(world: World) -> None:
    world.script("base", {"deactivate": takes(9.5)})
    world.script("scanner", {"activate": fails("no device")})
    supervisor = world.supervisor("base", "scanner")
    overdue: list[tuple[str, bool]] = []
    world.on_step = lambda text: overdue.append((text, supervisor.stop_overdue))
    with pytest.raises(Escalate, match="no device"):
        supervisor.start_all()
    assert overdue[-2:] == [("stopping base: deactivate", False), ("ending base by force", True)]
    assert not supervisor.stop_overdue


def test_child_that_cannot_be_killed_does_not_keep_the_others_from_stopping(world: World) -> None:
    world.script("scanner", dict.fromkeys(("shutdown", "terminate", "kill"), is_ignored))
    supervisor = world.supervisor("base", "scanner")
    supervisor.start_all()
    supervisor.stop_all()
    assert world.running() == ["scanner"]
    assert "WARNING child stop failed: scanner: does not end even when killed" in world.log.lines


def test_child_that_cannot_be_killed_escalates_instead_of_running_twice(
    world: World,
) -> None:
    world.script("scanner", {"kill": fails("scanner: it is placed in its supervisor's process")})
    scanner = ChildSpec(plugin="test", placement="in_process")
    supervisor = world.supervisor("base", scanner=scanner)
    supervisor.start_all()
    world.children["scanner"].beat("read_scan", 6.0)
    supervisor.check()
    assert (
        "WARNING child stop failed: scanner: it is placed in its supervisor's process"
        in world.log.lines
    )
    cause = ("scanner: hung for 6.0 s in read_scan", "does not end even when killed")
    with pytest.raises(Escalate, match=words_in_order(*cause, "placement: process")):
        supervisor.reconcile()
    assert world.running() == ["scanner"]
    for _ in range(2):
        with pytest.raises(StartFailed, match=words_in_order(*cause)):
            supervisor.load("scanner")
    assert supervisor.status()[1].reason.count("does not end") == 1
    world.children["scanner"].end = CRASH
    supervisor.load("scanner")
    assert world.children["scanner"].incarnation == 2


def test_child_that_does_not_end_after_a_failed_stop_escalates_with_the_cause(
    world: World,
) -> None:
    world.script(
        "base", {"shutdown": does_not_answer, **dict.fromkeys(("terminate", "kill"), is_ignored)}
    )
    supervisor = world.supervisor("base")
    supervisor.start_all()
    with pytest.raises(
        Escalate,
        match=words_in_order("base: shutdown: ", "did not answer", "not end even", "device"),
    ):
        supervisor.restart("base")


def test_lost_launcher_is_reported_and_counts_as_no_restart(world: World) -> None:
    def is_lost(child: ScriptedChild, timeout_s: float) -> None:
        raise ZygoteLost("zygote lost")

    world.script("scanner", {"launch": is_lost})
    supervisor = world.supervisor_with(Supervision(max_restarts=0, within_s=1.0), "base", "scanner")
    with pytest.raises(ZygoteLost, match="zygote lost"):
        supervisor.start_all()
    supervisor.stop_all()
    assert world.running() == []
    supervisor.start_all()
    assert world.running() == ["base", "scanner"]


@pytest.mark.parametrize("end", [DONE, ExitReport(True, "not all offsets found", success=False)])
def test_normal_end_of_a_significant_child_stops_all(world: World, end: ExitReport) -> None:
    supervisor = world.supervisor("base", replay=ChildSpec(plugin="test", significant=True))
    supervisor.start_all()
    world.take_steps()
    world.children["replay"].end = end
    supervisor.reconcile()
    assert world.steps == STOP_BASE
    assert supervisor.finished == ExitReport(
        True, f"replay has finished: {end.reason}", success=end.success
    )
    supervisor.reconcile()
    assert world.running() == []


def test_each_request_gets_the_remaining_time_and_is_reported_before_it_starts(
    world: World,
) -> None:
    world.script("base", {"launch": takes(2.0)})
    spec = ChildSpec(plugin="test", start_timeout_s=10.0, stop_timeout_s=4.0)
    supervisor = world.supervisor(base=spec)
    supervisor.start_all()
    supervisor.stop_all()
    assert world.limits == [
        ("configure base", 8.0),
        ("activate base", 8.0),
        ("expect_stop base", 4.0),
        ("deactivate base", 4.0),
        ("shutdown base", 4.0),
    ]
    assert world.progress == [
        "launching base",
        "starting base: configure",
        "starting base: activate",
        "stopping base: deactivate",
        "stopping base: shutdown",
    ]


def test_child_that_has_ended_gets_no_request_to_stop(world: World) -> None:
    supervisor = world.supervisor("base")
    supervisor.start_all()
    ends(world.children["base"], 0.0)
    world.take_steps()
    supervisor.stop_all()
    assert world.steps == []


def test_child_loaded_on_request_starts_when_requested(world: World) -> None:
    supervisor = world.supervisor("base", automove=ChildSpec(plugin="test", load="on_request"))
    supervisor.start_all()
    assert world.take_steps() == START_BASE
    supervisor.load("automove")
    supervisor.load("automove")
    assert world.take_steps() == ["launch automove", "configure automove", "activate automove"]
    world.children["automove"].end = CRASH
    supervisor.reconcile()
    assert world.running() == ["base", "automove"]


def test_failed_load_raises_and_does_not_count_as_restart(world: World) -> None:
    world.script("automove", *[{"configure": fails("unknown planner 'a-star'")}] * 10)
    supervisor = world.supervisor("base", automove=ChildSpec(plugin="test", load="on_request"))
    supervisor.start_all()
    for _ in range(10):
        with pytest.raises(StartFailed, match=r"^automove: unknown planner"):
            supervisor.load("automove")
    supervisor.reconcile()
    assert world.running() == ["base"]


def test_child_that_dies_while_it_is_loaded_is_started_again(world: World) -> None:
    world.script("automove", *[{"configure": dies("killed by SIGKILL (signal 9)")}] * 3)
    supervisor = world.supervisor("base", automove=ChildSpec(plugin="test", load="on_request"))
    supervisor.start_all()
    supervisor.load("automove")
    assert world.running() == ["base", "automove"]


def test_child_that_always_dies_while_it_is_loaded_is_not_loaded(world: World) -> None:
    world.script("automove", *[{"configure": dies("killed by SIGKILL (signal 9)")}] * 10)
    supervisor = world.supervisor("base", automove=ChildSpec(plugin="test", load="on_request"))
    supervisor.start_all()
    world.take_steps()
    with pytest.raises(StartFailed, match="killed by SIGKILL"):
        supervisor.load("automove")
    assert world.steps.count("launch automove") == 4
    assert world.running() == ["base"]


def test_unloaded_child_stays_unloaded(world: World) -> None:
    supervisor = world.supervisor_with(Supervision(strategy="one_for_all"), "base", "scanner")
    supervisor.start_all()
    world.take_steps()
    supervisor.unload("scanner")
    assert world.take_steps() == STOP_SCANNER
    world.children["base"].end = CRASH
    supervisor.reconcile()
    assert world.take_steps() == START_BASE
    assert supervisor.status()[1].state == "unloaded"


def test_requested_restart_stops_and_starts_one_child_and_is_not_counted(world: World) -> None:
    supervision = Supervision(strategy="one_for_all", max_restarts=0, within_s=1.0)
    supervisor = world.supervisor_with(supervision, "base", "scanner")
    supervisor.start_all()
    for incarnation in range(2, 7):
        world.take_steps()
        supervisor.restart("base")
        assert world.steps == STOP_BASE + START_BASE
        assert supervisor.status()[0].incarnation == incarnation


def test_request_for_an_unknown_child_names_the_known_ones(world: World) -> None:
    with pytest.raises(UnknownChild, match=r"mobile_supervisor: no child .* lidar; .*: base"):
        world.supervisor("base").load("lidar")


def test_stop_requested_during_a_start_ends_it_at_the_next_step(world: World) -> None:
    supervisor = world.supervisor("base", "scanner")

    def stop(text: str) -> None:
        if text == "starting base: configure":
            supervisor.request_stop()

    world.on_step = stop
    supervisor.start_all()
    assert world.take_steps() == ["launch base", "configure base"]
    assert world.stop_requests == 1
    supervisor.stop_all()
    assert world.steps == ["shutdown base"]
    assert world.running() == []


def test_stop_requested_while_a_start_keeps_failing_ends_the_retries(world: World) -> None:
    world.script("base", *[{"configure": dies("killed by SIGSEGV (signal 11)")}] * 1000)
    supervisor = world.supervisor_with(Supervision(max_restarts=1000), "base")

    def stop(text: str) -> None:
        if len(world.steps) > 10:
            supervisor.request_stop()

    world.on_step = stop
    supervisor.start_all()
    supervisor.stop_all()
    assert len(world.steps) < 20
    assert world.running() == []


def test_stop_requested_during_a_load_stops_that_child(world: World) -> None:
    supervisor = world.supervisor(automove=ChildSpec(plugin="test", load="on_request"))
    world.on_step = lambda text: supervisor.request_stop()
    with pytest.raises(StartFailed, match="a stop was requested"):
        supervisor.load("automove")
    assert world.running() == []
