"""When a process of the tree is killed, the others keep running or end, and nothing is left."""

import os
import re
import signal
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from cairn.testing.launching import Launching, Run
from tests.commands import await_status
from tests.patience import LIMIT_S
from tests.sweeps import sampled

pytestmark = pytest.mark.processes


TREE = """
    stop_limit_s: 60
    components:
      beacon: {plugin: test_beacon}
      mobile:
        plugin: supervisor
        children:
          reader: {plugin: test_reader}
          base: {plugin: test_faulty, parameters: {helpers: 2}}
      talker: {plugin: test_talker}
    """


def kill(run: Run, component: str) -> None:
    os.kill(run.pid_of(component), signal.SIGKILL)


def assert_all_stop_in_reverse_order(run: Run, number: signal.Signals) -> None:
    """Send the signal; assert that all components shut down in reverse order, with success."""
    sent = len(run.lines)

    run.process.send_signal(number)

    assert run.await_end() == 0
    run.await_nothing_left()
    # Each line begins with its time; lines of two processes may be printed the other way round.
    stopped = [
        stop[1]
        for line in sorted(run.lines[sent:])
        if (stop := re.search("child stopped: (.*): shut down$", line))
    ]
    assert stopped == ["talker", "base", "reader", "mobile", "beacon"]
    run.await_line("^ended.*: shut down", after=sent)


def test_killed_components_and_supervisors_are_restarted_and_the_others_keep_running(
    launch: Launching,
) -> None:
    run = launch(TREE)
    run.await_line("reader: the beacon stands at 4, 2")
    active = run.await_line("child active: talker")
    others = ["zygote", "beacon", "mobile", "base", "talker"]
    before, reader = [run.pid_of(name) for name in others], run.pid_of("reader")

    kill(run, "reader")

    killed = run.await_line(
        r"mobile: child failed: reader: killed by SIGKILL \(signal 9\) "
        rf"\(process {reader}, log .*/reader.log\)",
        after=active,
    )
    restarting = run.await_line(
        r"mobile: restarting child reader: killed by SIGKILL .*\(1 of 3 restarts in 10 s\)",
        after=killed,
    )
    run.await_line("reader: the beacon stands at 4, 2", after=restarting)
    assert [run.pid_of(name) for name in others] == before
    assert run.pid_of("reader") != reader
    row = await_status("/robot/reader", lambda row: row["restarts"] == 1, run.endpoint)
    assert re.match(rf"restarted: killed by SIGKILL .*process {reader}, log ", row["reason"])

    components = {*before, run.process.pid, run.pid_of("reader")}
    helpers = set(run.pids()) - components
    assert len(helpers) == 2
    kill(run, "base")

    killed = run.await_line("mobile: child failed: base: killed by SIGKILL", after=killed)
    run.await_line("child active: base", after=killed)
    assert helpers.isdisjoint(run.pids())

    below = {run.pid_of(name) for name in ("mobile", "reader", "base")}
    kill(run, "mobile")

    killed = run.await_line("root: child failed: mobile: killed by SIGKILL", after=killed)
    run.await_line("root: child active: mobile", after=killed)
    run.await_line("reader: the beacon stands at 4, 2", after=killed)
    assert below.isdisjoint(run.pids())
    assert [run.pid_of(name) for name in ("beacon", "talker")] == [before[1], before[4]]
    assert_all_stop_in_reverse_order(run, signal.SIGINT)


@pytest.mark.accuracy
@pytest.mark.parametrize("number", sampled([signal.SIGKILL, signal.SIGSTOP]))
def test_killed_or_stopped_zygote_fails_the_deployment_and_leaves_no_process(
    launch: Launching, number: signal.Signals
) -> None:
    run = launch(TREE)
    run.await_line("child active: talker")

    os.kill(run.pid_of("zygote"), number)

    assert run.await_end() == 1
    run.await_nothing_left()
    run.await_line(
        "cairn: deployment0.yaml failed: the zygote ended, and with it every component: killed by "
        rf"SIGKILL \(signal 9\) \(process \d+, log {run.logs}/zygote.log\)"
    )


@pytest.mark.parametrize("stopped", [(), ("beacon", "mobile", "reader", "base", "talker")])
def test_killing_cairn_up_leaves_no_process(launch: Launching, stopped: tuple[str, ...]) -> None:
    with TemporaryDirectory() as sockets:  # pytest's own paths are too long for a socket
        run = launch(TREE, environment={"CAIRN_RUNTIME_DIR": sockets})
        run.await_line("child active: talker")
        assert len(run.pids()) == 9  # cairn up, zygote, five components, two helpers of one
        assert len(list(Path(sockets).iterdir())) == 1

        for component in stopped:
            os.kill(run.pid_of(component), signal.SIGSTOP)
        run.process.kill()

        run.await_nothing_left()
        assert list(Path(sockets).iterdir()) == []


@pytest.mark.parametrize("number", sampled([signal.SIGTERM, signal.SIGHUP]))
def test_stop_signal_stops_all_components_in_reverse_order(
    launch: Launching, number: signal.Signals
) -> None:
    run = launch(TREE)
    run.await_line("child active: talker")

    assert_all_stop_in_reverse_order(run, number)


@pytest.mark.accuracy
def test_second_ctrl_c_kills_everything(launch: Launching) -> None:
    run = launch(
        """
    stop_limit_s: 700
    components:
      base: {plugin: test_faulty, parameters: {fault: sleep, where: on_shutdown, helpers: 2},
             stop_timeout_s: 600}
      beacon: {plugin: test_beacon}
    """
    )
    run.await_line("child active: beacon")
    run.process.send_signal(signal.SIGINT)
    run.await_line("child stopped: beacon")

    run.process.send_signal(signal.SIGINT)

    assert run.await_end() == 1
    run.await_nothing_left()
    run.await_line("cairn: stopped by force, on a second signal")


@pytest.mark.accuracy
def test_subprocess_of_a_component_is_killed_with_it(launch: Launching) -> None:
    run = launch(
        """
    components:
      base: {plugin: test_faulty, parameters: {fault: orphan, where: on_configure}}
    """
    )
    run.await_line("child active: base")
    assert len(run.pids()) == 4

    assert run.stop() == 0


@pytest.mark.accuracy
def test_robot_continues_when_the_reader_of_its_output_ends(launch: Launching) -> None:
    run = launch(TREE, head=3)
    log = run.logs / "root.log"
    deadline = time.monotonic() + LIMIT_S
    while not (log.exists() and "output of cairn up lost" in log.read_text()):
        assert time.monotonic() < deadline, run
        time.sleep(0.05)

    assert run.stop() == 0

    assert "child stopped" in log.read_text()
    run.await_nothing_left()
