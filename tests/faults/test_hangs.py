"""A component that hangs is found, named with its handler and its time, killed and restarted."""

import os
import signal
import time

import pytest

from cairn.bus.session import LEASE_MS
from cairn.testing.launching import Launching
from tests.commands import cairn
from tests.faults.orders import set_fault

pytestmark = pytest.mark.processes


ONE = """
    components:
      talker: {plugin: test_talker}
      base: {plugin: test_faulty, hang_timeout_s: 0.5}
      listener: {plugin: test_listener, hang_timeout_s: 0.5}
    """


def test_in_a_handler_that_sleeps(launch: Launching) -> None:
    run = launch(ONE)
    active = run.await_line("listener active")
    others = [run.pid_of("talker"), run.pid_of("listener")]

    set_fault(run, "sleep")

    hung = run.await_line(
        r"ERROR   robot.root: base hung in tick for \d\.\d s and was kil", after=active
    )
    run.await_line("base active", after=hung)
    assert [run.pid_of("talker"), run.pid_of("listener")] == others
    assert "in tick" in run.log_of("base"), "the log shows where it hung"


def test_in_a_handler_that_lets_no_other_thread_run(launch: Launching) -> None:
    run = launch(ONE)
    active = run.await_line("listener active")

    set_fault(run, "hold_gil")

    hung = run.await_line(
        r"base hung in .* that lets no other thread of its process run, for \d\.\d s", after=active
    )
    run.await_line("base active", after=hung)
    assert "in tick" in run.log_of("base"), "the log shows where it hung"


def test_stopped_by_a_signal(launch: Launching) -> None:
    run = launch(ONE)
    active = run.await_line("listener active")

    os.kill(run.pid_of("base"), signal.SIGSTOP)

    hung = run.await_line(
        r"base hung in a process that was stopped by a signal, as by SIGSTOP, for \d\.\d s",
        after=active,
    )
    run.await_line("base active", after=hung)


def test_a_machine_that_pauses_has_nobody_taken_for_hung(launch: Launching) -> None:
    run = launch(
        """
    components:
      mobile:
        plugin: supervisor
        children:
          talker: {plugin: test_talker, hang_timeout_s: 0.5}
          base: {plugin: test_faulty, placement: in_process, hang_timeout_s: 0.5}
      listener: {plugin: test_listener, hang_timeout_s: 0.5}
    """
    )
    heard = run.await_line("heard 10,")
    processes = sorted(run.pids())

    for pid in processes:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(LEASE_MS / 1000 + 1.0)  # longer than any limit, and than links last
    for pid in reversed(processes):
        os.kill(pid, signal.SIGCONT)

    woken = len(run.lines)
    run.await_line("heard", after=woken)
    run.await_line("heard", after=woken + 1)
    assert sorted(run.pids()) == processes
    assert not [line for line in run.lines[heard:] if "heard" not in line], run
    assert run.stop() == 0


def test_in_its_parents_process_takes_the_parent_along(launch: Launching) -> None:
    run = launch(
        """
    components:
      mobile:
        plugin: supervisor
        children:
          base: {plugin: test_faulty, placement: in_process, hang_timeout_s: 0.5}
      listener: {plugin: test_listener}
    """
    )
    active = run.await_line("listener active")
    mobile, listener = run.pid_of("mobile"), run.pid_of("listener")

    set_fault(run, "sleep")

    run.await_line("base hung in tick for", after=active)
    failed = run.await_line(
        "root: mobile failed .*base does not end even when killed", after=active
    )
    run.await_line("mobile active", after=failed)
    assert run.pid_of("mobile") != mobile
    assert run.pid_of("listener") == listener


def test_while_it_is_stopped_ends_within_its_limits(launch: Launching) -> None:
    run = launch(
        """
    components:
      mobile:
        plugin: supervisor
        children:
          beacon: {plugin: test_beacon}
          base:
            plugin: test_faulty
            parameters: {fault: sleep, where: on_shutdown}
            stop_timeout_s: 0.5
      talker: {plugin: test_talker}
    """
    )
    run.await_line("talker active")

    assert run.stop() == 1

    run.await_line(
        "WARNING robot.mobile: base did not stop cleanly: shutdown: no answer within 0.[45] s"
    )
    run.await_line(r"WARNING robot.mobile: base stopped: was killed by SIGKILL \(")
    run.await_line("robot.mobile: beacon stopped: shut down")
    run.await_line("failed: .*base: shutdown: no answer within 0.[45] s")


@pytest.mark.parametrize("placed", ["  ", "mobile"])
def test_ctrl_c_does_not_wait_for_one_that_hangs_while_it_starts(
    launch: Launching, placed: str
) -> None:
    base = """base:
            plugin: test_faulty
            parameters: {fault: sleep, where: on_configure}
            stop_timeout_s: 0.5"""
    tree = (
        f"mobile:\n        plugin: supervisor\n        children:\n          {base}"
        if placed == "mobile"
        else base
    )
    run = launch(
        f"""
    components:
      beacon: {{plugin: test_beacon}}
      {tree}
    """
    )
    run.await_line("beacon active")

    run.stop()

    run.await_line("beacon stopped: shut down")


def test_a_supervisor_busy_with_one_child_takes_no_other_for_hung(launch: Launching) -> None:
    run = launch(
        """
    components:
      listener: {plugin: test_listener, hang_timeout_s: 0.3}
      base:
        plugin: test_faulty
        parameters: {fault: nap, where: on_configure}
        load: on_request
    """
    )
    run.await_line("listener active")
    listener = run.pid_of("listener")

    assert cairn("load", "base", connect=run.endpoint).code == 0

    assert run.pid_of("listener") == listener
    assert run.stop() == 0
    assert not any("hung" in line for line in run.lines), run
