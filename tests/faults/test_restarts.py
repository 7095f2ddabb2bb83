"""Restarts, escalation and orders as the deployment's supervision says, in real processes."""

import os
import signal

import pytest

from cairn.testing.launching import Launching, Run
from tests.commands import cairn
from tests.faults.orders import order_to_move, set_fault

pytestmark = pytest.mark.processes


GROUP = """
    components:
      mobile:
        plugin: supervisor
        supervision: {{strategy: {strategy}}}
        children:
          first: {{plugin: test_beacon}}
          base: {{plugin: test_faulty}}
          last: {{plugin: test_reader, topics: {{beacon: beacon}}}}
    """
NAMES = ("first", "base", "last")


def pids(run: Run) -> list[int]:
    return [run.pid_of(name) for name in NAMES]


@pytest.mark.parametrize(
    ("strategy", "anew"),
    [
        ("one_for_one", [False, True, False]),
        ("rest_for_one", [False, True, True]),
        ("one_for_all", [True, True, True]),
    ],
)
def test_the_strategy_says_who_is_restarted(
    launch: Launching, strategy: str, anew: list[bool]
) -> None:
    run = launch(GROUP.format(strategy=strategy))
    active = run.await_line("mobile active")
    before = pids(run)

    os.kill(run.pid_of("base"), signal.SIGKILL)

    last = [name for name, new in zip(NAMES, anew, strict=True) if new][-1]
    run.await_line(f"{last} active", after=run.await_line("base was killed", after=active))
    assert [new != old for new, old in zip(pids(run), before, strict=True)] == anew
    assert run.stop() == 0


def test_too_many_restarts_escalate_to_the_end_of_the_deployment(launch: Launching) -> None:
    run = launch(
        """
    supervision: {max_restarts: 1, within_s: 60}
    components:
      talker: {plugin: test_talker}
      mobile:
        plugin: supervisor
        supervision: {max_restarts: 1, within_s: 60}
        children:
          base: {plugin: test_faulty}
    """
    )
    seen = 0
    for told in ("base was", "mobile failed", "base was", "mobile failed"):
        seen = run.await_line("base active", after=seen)
        set_fault(run, "abort")
        seen = run.await_line(told, after=seen)

    assert run.await_end() == 1
    run.await_line("talker stopped: shut down")
    run.await_line(
        "cairn: deployment0.yaml failed: .*given up after more than 1 restarts within 60 s; "
        r"last, mobile: failed \(process \d+, log .*/mobile.log\): .*given up after more "
        r"than 1 restarts within 60 s; last, base: was killed by SIGABRT \(process \d+, log .*"
    )


def test_a_transient_component_that_is_done_is_not_restarted_and_no_warning(
    launch: Launching,
) -> None:
    run = launch(
        """
    components:
      talker: {plugin: test_talker, parameters: {words: 3}, restart: transient}
      beacon: {plugin: test_beacon}
    """
    )
    run.await_line("INFO    robot.root: talker ended: all said")
    run.await_line("beacon active")
    assert run.stop() == 0
    assert sum("talker active" in line for line in run.lines) == 1


def test_the_end_of_a_significant_component_ends_the_deployment_normally(
    launch: Launching,
) -> None:
    run = launch(
        """
    components:
      beacon: {plugin: test_beacon}
      mobile:
        plugin: supervisor
        children:
          talker:
            plugin: test_talker
            parameters: {words: 3}
            restart: transient
            significant: true
    """
    )

    assert run.await_end() == 0

    run.await_line("beacon stopped: shut down")
    run.await_line("^ended.*: mobile has finished: talker has finished: all said; logs and report")
    assert not any("WARNING" in line for line in run.lines)


def test_an_order_to_move_loads_the_plugins_which_load_and_unload_alone(
    launch: Launching,
) -> None:
    run = launch(
        """
    external_topics: [goal_pose]
    components:
      mobile_supervisor:
        plugin: mobile_supervisor
        children:
          automove:
            plugin: automove
            load: on_request
            children:
              beacon: {plugin: test_beacon, load: on_request}
              reader: {plugin: test_reader, load: on_request}
    """
    )
    active = run.await_line("mobile_supervisor active")

    order_to_move(run, 1.0, 2.0)

    ordered = run.await_line(r"mobile_supervisor: order \d+: go to \(1.00, 2.00\)", after=active)
    run.await_line("automove: reader active", after=ordered)
    automove, beacon = run.pid_of("automove"), run.pid_of("beacon")
    reader = run.pid_of("reader")

    unloaded = cairn("unload", "reader", connect=run.endpoint)
    assert (unloaded.code, unloaded.out) == (0, "reader: unloaded\n")
    assert reader not in run.pids()
    loaded = cairn("load", "reader", connect=run.endpoint)
    assert (loaded.code, loaded.out) == (0, "reader: active\n")
    assert (run.pid_of("automove"), run.pid_of("beacon")) == (automove, beacon)
    run.await_line("reader: the beacon stands", after=run.await_line("reader stopped"))
    assert run.stop() == 0


def test_an_order_to_move_that_cannot_be_carried_out_is_told_and_can_be_repeated(
    launch: Launching,
) -> None:
    run = launch(
        """
    external_topics: [goal_pose]
    components:
      mobile_supervisor:
        plugin: mobile_supervisor
        children:
          automove:
            plugin: automove
            load: on_request
            children:
              base:
                plugin: test_faulty
                load: on_request
                parameters: {fault: raise, where: on_activate}
    """
    )
    seen = run.await_line("mobile_supervisor active")
    for _ in range(2):
        order_to_move(run, 1.0, 2.0)
        seen = run.await_line(
            r"robot.mobile_supervisor: order \d+ failed: not all plugins can be loaded: base: "
            "activate failed: ValueError: broken on purpose",
            after=seen,
        )
    assert run.stop() == 0
    assert not any("automove failed" in line for line in run.lines)


def test_a_restart_on_request_that_fails_for_good_fails_the_supervisor(launch: Launching) -> None:
    run = launch(
        """
    supervision: {max_restarts: 0}
    components:
      mobile:
        plugin: supervisor
        supervision: {max_restarts: 0}
        children:
          base: {plugin: test_faulty, parameters: {once: "${here}/once"}}
    """
    )
    run.await_line("mobile active")

    answer = cairn("restart", "base", connect=run.endpoint)

    assert answer.code == 1
    assert answer.err.startswith("cairn: mobile: given up after more than 0 restarts within 10 s;")
    assert run.await_end() == 1
