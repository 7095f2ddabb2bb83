"""A component that hangs is detected, logged with handler and duration, killed and restarted."""

import os
import re
import signal
import threading
import time

import pytest
import zenoh

from cairn import LATCHED
from cairn.bus.keys import control_key
from cairn.bus.session import LEASE_MS, open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.std_msgs import Header
from cairn.testing.launching import Launching
from tests.commands import await_status, cairn
from tests.faults.requests import set_fault
from tests.patience import LIMIT_S
from tests.sweeps import sampled

pytestmark = pytest.mark.processes


def test_hung_components_are_killed_with_their_stacks_logged_and_restarted(
    launch: Launching,
) -> None:
    run = launch(
        """
    supervision: {max_restarts: 4}
    components:
      talker: {plugin: test_talker}
      sleeping: {plugin: test_faulty, hang_timeout_s: 0.5, topics: {velocity: v1}}
      holding: {plugin: test_faulty, hang_timeout_s: 0.5, topics: {velocity: v2}}
      stopped: {plugin: test_faulty, hang_timeout_s: 0.5, topics: {velocity: v3}}
      supervisor_with_captive:
        plugin: supervisor
        hang_timeout_s: 0.5
        children:
          captive: {plugin: test_faulty, placement: in_process, topics: {velocity: v4}}
      listener: {plugin: test_listener, hang_timeout_s: 2}
    """
    )
    active = run.await_line("child active: listener")
    others = [run.pid_of("talker"), run.pid_of("listener")]

    os.kill(run.pid_of("stopped"), signal.SIGSTOP)
    set_fault(run, "hold_gil", "holding")
    set_fault(run, "sleep", "sleeping")
    set_fault(run, "hold_gil", "captive")

    for component, where in (
        ("sleeping", "in tick"),
        ("holding", "in .* that lets no other thread of its process run"),
        ("stopped", "in a process that was stopped by a signal such as SIGSTOP"),
        ("supervisor_with_captive", "in .* that lets no other thread of its process run"),
    ):
        hung = run.await_line(
            rf"ERROR   robot.root: child hung: {component}: hung for \d+\.\d s {where}; killed",
            after=active,
        )
        run.await_line(f"child active: {component}", after=hung)
    assert [run.pid_of("talker"), run.pid_of("listener")] == others
    assert "in tick" in run.log_of("sleeping"), "the log has no stack"
    assert "in tick" in run.log_of("holding"), "the log has no stack"


def test_components_that_use_too_much_memory_are_restarted_with_the_reason(
    launch: Launching,
) -> None:
    run = launch(
        """
    components:
      talker: {plugin: test_talker}
      growing: {plugin: test_faulty, memory_max_mib: 256, topics: {velocity: v1}}
      bulky: {plugin: test_faulty, memory_max_mib: 256, topics: {velocity: v2}}
    """
    )
    active = run.await_line("child active: bulky")
    talker = run.pid_of("talker")

    set_fault(run, "grow", "growing")
    excess = r"it uses \d+ MiB of memory, more than memory_max_mib, 256; killed"
    run.await_line(
        "child active: growing",
        after=run.await_line(f"ERROR   robot.root: child failed: growing: {excess}", after=active),
    )
    set_fault(run, "allocate", "bulky")
    failed = run.await_line("child failed: bulky: tick: MemoryError.*memory_max_mib", after=active)
    run.await_line("child active: bulky", after=failed)

    def await_reason(component: str, reason: str) -> None:
        await_status(
            component, lambda row: bool(re.search(reason, row["reason"] or "")), run.endpoint
        )

    await_reason("/robot/growing", excess)
    await_reason("/robot/bulky", "memory_max_mib")
    assert run.pid_of("talker") == talker


def test_machine_pause_does_not_trigger_hang_detection(launch: Launching) -> None:
    run = launch(
        """
    components:
      mobile:
        plugin: supervisor
        children:
          talker: {plugin: test_talker, hang_timeout_s: 2}
          base: {plugin: test_faulty, placement: in_process, hang_timeout_s: 2}
      listener: {plugin: test_listener, hang_timeout_s: 2}
    """
    )
    # A pause counts as one second of the handler in progress: each limit is longer.
    run.await_line("received 10,")
    run.await_line("child active: listener")  # of another process: it may come later
    received = len(run.lines)
    processes = sorted(run.pids())

    for pid in processes:
        os.kill(pid, signal.SIGSTOP)
    time.sleep(LEASE_MS / 1000 + 1.0)  # longer than all limits, and than the lease of links
    for pid in reversed(processes):
        os.kill(pid, signal.SIGCONT)

    resumed = len(run.lines)
    run.await_line("received", after=resumed)
    run.await_line("received", after=resumed + 1)
    assert sorted(run.pids()) == processes
    assert not [line for line in run.lines[received:] if "received" not in line], run
    assert run.stop() == 0


@pytest.mark.accuracy
def test_hang_in_the_supervisors_process_restarts_that_process(launch: Launching) -> None:
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
    active = run.await_line("child active: listener")
    mobile, listener = run.pid_of("mobile"), run.pid_of("listener")

    set_fault(run, "sleep")

    run.await_line("child hung: base: .* in tick", after=active)
    failed = run.await_line(
        "root: child failed: mobile: given up: base: hung for .* does not end even when killed",
        after=active,
    )
    run.await_line("child active: mobile", after=failed)
    assert run.pid_of("mobile") != mobile
    assert run.pid_of("listener") == listener


@pytest.mark.accuracy
def test_forged_status_and_false_queryables_have_no_effect(launch: Launching) -> None:
    run = launch(
        """
    components:
      talker: {plugin: test_talker}
      stopped: {plugin: test_beacon, hang_timeout_s: 0.5}
    """
    )
    active = run.await_line("child active: stopped")
    talker, stopped = run.pid_of("talker"), run.pid_of("stopped")
    bus = ZenohBus(open_peer([run.endpoint]))
    try:
        node = bus.node("/robot/stranger", run.lines.append)
        forged = node.advertise("/robot/component_status", ComponentStatus, LATCHED)
        false = bus.session.declare_queryable(
            control_key(0, "/robot/stopped"), zenoh.handlers.RingChannel(1)
        )
        assert bus.wait_for_peers(LIMIT_S) == []
        os.kill(stopped, signal.SIGSTOP)
        end = threading.Event()

        def forge() -> None:
            fresh = ComponentStatus(header=Header(), component="stopped", state="active")
            hung = ComponentStatus(
                header=Header(), component="talker", state="active", handler="a", handler_s=1e6
            )
            while not end.wait(0.1):
                forged.publish(fresh)
                forged.publish(hung)

        forger = threading.Thread(target=forge)
        forger.start()
        began = time.monotonic()
        killed = run.await_line("child hung: stopped: .*SIGSTOP", after=active)
        assert time.monotonic() - began < 20.0
        began = time.monotonic()
        run.await_line("child active: stopped", after=killed)
        assert time.monotonic() - began < 4.0, "the false queryable has delayed the restart"
        end.set()
        forger.join()
        false.undeclare()
    finally:
        bus.close()
    assert run.pid_of("talker") == talker


@pytest.mark.accuracy
def test_components_that_hang_leave_time_to_stop_for_those_that_answer(launch: Launching) -> None:
    run = launch(
        """
    stop_limit_s: 6
    components:
      beacon: {plugin: test_beacon}
      mobile:
        plugin: supervisor
        children:
          talker: {plugin: test_talker}
          stopped: {plugin: test_faulty, topics: {velocity: v1}}
          holding:
            plugin: test_faulty
            parameters: {fault: hold_gil, where: on_shutdown}
            topics: {velocity: v2}
          late:
            plugin: test_faulty
            parameters: {fault: sleep, where: on_configure}
            topics: {velocity: v3}
            load: on_request
    """
    )
    run.await_line("child active: mobile")
    os.kill(run.pid_of("stopped"), signal.SIGSTOP)
    load = threading.Thread(target=cairn, args=("load", "late"), kwargs={"connect": run.endpoint})
    load.start()
    run.pid_of("late")  # `mobile` is busy with its start
    began = time.monotonic()

    assert run.stop() == 1

    assert time.monotonic() - began < 9.0
    run.await_line(
        r"WARNING robot.mobile: child stop failed: holding: shutdown: no answer within \d\.\d s"
    )
    for component in ("holding", "stopped"):
        run.await_line(f"WARNING robot.mobile: child stopped: {component}: killed by SIGKILL")
    run.await_line("robot.mobile: child stopped: talker: shut down")
    run.await_line("robot.root: child stopped: beacon: shut down")
    run.await_line(r"failed: .*holding: shutdown: no answer within \d\.\d s")
    load.join()


@pytest.mark.parametrize("supervisor", sampled(["  ", "mobile"]))
def test_ctrl_c_does_not_wait_for_a_component_that_hangs_while_starting(
    launch: Launching, supervisor: str
) -> None:
    base = """base:
            plugin: test_faulty
            parameters: {fault: sleep, where: on_configure}
            stop_timeout_s: 0.5"""
    tree = (
        f"mobile:\n        plugin: supervisor\n        children:\n          {base}"
        if supervisor == "mobile"
        else base
    )
    run = launch(
        f"""
    components:
      beacon: {{plugin: test_beacon}}
      {tree}
    """
    )
    run.await_line("child active: beacon")

    run.stop()

    run.await_line("child stopped: beacon: shut down")


@pytest.mark.accuracy
def test_supervisor_busy_with_one_child_does_not_kill_another_as_hung(launch: Launching) -> None:
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
    run.await_line("child active: listener")
    listener = run.pid_of("listener")

    assert cairn("load", "base", connect=run.endpoint).code == 0

    assert run.pid_of("listener") == listener
    assert run.stop() == 0
    assert not any("hung" in line for line in run.lines), run
