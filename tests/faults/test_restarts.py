"""Restarts, escalation, and loading on request, in real processes."""

import os
import re
import signal

import pytest

from cairn.testing.launching import Launching
from tests.cairn.bus.network import eventually
from tests.commands import cairn
from tests.faults.requests import send_goal, set_fault

pytestmark = pytest.mark.processes


# The strategies themselves are tested with scripted children; here each child is a process.
GROUP = """
    components:
      mobile:
        plugin: supervisor
        supervision: {strategy: rest_for_one}
        children:
          first: {plugin: test_beacon}
          base: {plugin: test_faulty}
          last: {plugin: test_reader}
    """


@pytest.mark.accuracy
def test_strategy_decides_which_children_are_restarted(launch: Launching) -> None:
    run = launch(GROUP)
    active = run.await_line("root: child active: mobile")
    names = ("first", "base", "last")
    before = {name: run.pid_of(name) for name in names}

    os.kill(before["base"], signal.SIGKILL)

    killed = run.await_line("child failed: base: killed", after=active)
    run.await_line("child active: last", after=killed)
    after = {name: run.pid_of(name) for name in names}
    assert [name for name in names if after[name] != before[name]] == ["base", "last"]
    assert run.stop() == 0


def test_supervisor_goes_on_while_a_child_starts(launch: Launching) -> None:
    run = launch(
        """
    components:
      mobile:
        plugin: supervisor
        children:
          first: {plugin: test_beacon}
          slow: {plugin: test_faulty, parameters: {fault: nap, where: on_activate}}
    """
    )
    # Also during its first start, in which the supervisor itself is not active yet.
    slow = run.pid_of("slow")
    os.kill(slow, signal.SIGSTOP)
    os.kill(run.pid_of("first"), signal.SIGKILL)
    seen = run.await_line("child failed: first: killed by SIGKILL")
    seen = run.await_line("child active: first", after=seen)
    assert not any("child active: slow" in line for line in run.lines[:seen])
    os.kill(slow, signal.SIGCONT)
    seen = run.await_line("root: child active: mobile", after=seen)

    os.kill(run.pid_of("slow"), signal.SIGKILL)
    seen = run.await_line("child failed: slow: killed by SIGKILL", after=seen)
    slow = run.pid_of("slow")
    os.kill(slow, signal.SIGSTOP)
    os.kill(run.pid_of("first"), signal.SIGKILL)
    failed = run.await_line("child failed: first: killed by SIGKILL", after=seen)
    run.await_line("child active: first", after=failed)
    assert eventually(lambda: cairn("restart", "first", connect=run.endpoint).code == 0)
    assert not any("child active: slow" in line for line in run.lines[seen:])

    os.kill(slow, signal.SIGCONT)
    run.await_line("child active: slow", after=seen)
    assert run.stop() == 0


@pytest.mark.accuracy
def test_too_many_restarts_escalate_to_the_end_of_the_deployment(launch: Launching) -> None:
    run = launch(
        """
    supervision: {max_restarts: 1, within_s: 900}
    components:
      talker: {plugin: test_talker}
      mobile:
        plugin: supervisor
        supervision: {max_restarts: 1, within_s: 900}
        children:
          base: {plugin: test_faulty}
    """
    )
    seen = 0
    for event in ("failed: base", "failed: mobile") * 2:
        seen = run.await_line("child active: base", after=seen)
        set_fault(run, "abort")
        seen = run.await_line(event, after=seen)

    assert run.await_end() == 1
    run.await_nothing_left()
    run.await_line("child stopped: talker: shut down")
    run.await_line(
        "cairn: deployment0.yaml failed: given up after more than 1 restarts within 900 s; "
        r"last, mobile: given up after more than 1 restarts within 900 s; "
        r"last, base: killed by SIGABRT .*process \d+, log .*/base.log.*/mobile.log"
    )


@pytest.mark.accuracy
def test_finished_component_is_not_restarted_and_a_significant_one_ends_the_deployment(
    launch: Launching,
) -> None:
    run = launch(
        """
    components:
      brief:
        plugin: test_talker
        parameters: {words: 3}
        topics: {words: brief_words}
        restart: transient
      beacon: {plugin: test_beacon}
      mobile:
        plugin: supervisor
        children:
          talker:
            plugin: test_talker
            parameters: {words: 20}
            restart: transient
            significant: true
    """
    )
    run.await_line("INFO    robot.root: child ended: brief: all words sent")

    assert run.await_end() == 0

    assert sum("child active: brief" in line for line in run.lines) == 1
    run.await_line("child stopped: beacon: shut down")
    run.await_line(
        "^ended.*: mobile has finished: talker has finished: all words sent; logs and report"
    )
    assert not any(re.search("WARNING.* child ", line) for line in run.lines)


def test_goal_loads_the_plugins_and_each_can_be_loaded_and_unloaded_alone(
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
    active = run.await_line("child active: mobile_supervisor")

    send_goal(run, 1.0, 2.0)

    accepted = run.await_line(r"mobile_supervisor: mission \d+: go to \(1.00, 2.00\)", after=active)
    run.await_line("automove: child active: reader", after=accepted)
    automove, beacon = run.pid_of("automove"), run.pid_of("beacon")
    reader = run.pid_of("reader")

    unloaded = cairn("unload", "reader", connect=run.endpoint)
    assert (unloaded.code, unloaded.out) == (0, "reader: unloaded\n")
    assert reader not in run.pids()
    loaded = cairn("load", "reader", connect=run.endpoint)
    assert (loaded.code, loaded.out) == (0, "reader: active\n")
    assert (run.pid_of("automove"), run.pid_of("beacon")) == (automove, beacon)
    run.await_line("reader: the beacon stands", after=run.await_line("child stopped: reader"))
    assert run.stop() == 0


@pytest.mark.accuracy
def test_goal_that_fails_is_reported_and_can_be_sent_again(
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
    seen = run.await_line("child active: mobile_supervisor")
    for _ in range(2):
        send_goal(run, 1.0, 2.0)
        seen = run.await_line(
            r"robot.mobile_supervisor: mission \d+ failed: not all plugins can be loaded: base: "
            "activate failed: ValueError: broken on purpose",
            after=seen,
        )
    assert run.stop() == 0
    assert not any("failed: automove" in line for line in run.lines)


@pytest.mark.accuracy
def test_requested_restart_that_keeps_failing_fails_the_supervisor(launch: Launching) -> None:
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
    run.await_line("child active: mobile")

    answer = cairn("restart", "base", connect=run.endpoint)

    assert answer.code == 1
    assert answer.err.startswith("cairn: mobile: given up after more than 0 restarts within 10 s;")
    assert run.await_end() == 1
