"""`cairn up`: lines, lockstep, report, and how it ends."""

import fcntl
import os
import pty
import re
import select
import subprocess
import time
from pathlib import Path
from textwrap import dedent

import psutil
import pytest

from cairn.testing.launching import CAIRN, LIMIT_S, Launching, Run
from tests.cairn.bus.network import eventually
from tests.commands import cairn
from tests.wording import assert_words

pytestmark = pytest.mark.processes


TALK = """
    components:
      listener: {plugin: test_listener}
      talker: {plugin: test_talker, parameters: {words: 20}, restart: transient, significant: true}
    """
ENDLESS = "components: {beacon: {plugin: test_beacon}}"


def lines_of(run: Run) -> list[str]:
    """Return what `cairn up` has printed, without the remark that a slow machine imports long."""
    return [line for line in run.lines if "importing the plugins: " not in line]


def test_up_prints_lines_and_keeps_its_logs_without_old_ones_in_the_report_folder(
    launch: Launching, tmp_path: Path
) -> None:
    logs = tmp_path / "again" / "logs"
    logs.mkdir(parents=True)
    (logs / "listener.log").write_text("old\n")

    run = launch(TALK, report=tmp_path / "again")

    assert run.await_end() == 0

    assert lines_of(run)[0].startswith("deployment0.yaml: robot robot; logs and report: /")
    seen = 0
    for event in (
        "child active: listener",
        "child active: talker",
        "child ended: talker: all words sent",
        "child stopped: listener: shut down",
        "^ended.*: talker has finished: all words sent",
    ):
        seen = run.await_line(event, after=seen)
    assert seen == len(run.lines) - 1
    # Lines of different processes come in no certain order, and a busy listener drops words.
    assert "received 1, the last was " in run.log_of("listener")
    assert "old" not in run.log_of("listener")
    assert "child active: talker" in run.log_of("root")


@pytest.mark.accuracy
def test_long_import_of_plugins_is_announced_once(launch: Launching, tmp_path: Path) -> None:
    module = """
        import fcntl
        from cairn import Component
        with open({gate!r}) as gate:
            fcntl.flock(gate, fcntl.LOCK_SH)
        class Slow(Component):
            def on_activate(self):
                self.finish("done")
        """
    gate = tmp_path / "gate"
    (tmp_path / "slow_plugin.py").write_text(dedent(module).format(gate=str(gate)))
    with gate.open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        run = launch(
            "components: {slow: {plugin: slow_plugin:Slow, restart: transient, significant: true}}",
            environment={"PYTHONPATH": str(tmp_path)},
        )
        run.await_line("importing the plugins: ")

    assert run.await_end() == 0
    assert sum("importing the plugins" in line for line in run.lines) == 1


@pytest.mark.accuracy
def test_robot_continues_while_its_output_is_on_a_full_disk_and_its_logs_are_rotated(
    launch: Launching, tmp_path: Path
) -> None:
    module = """
        from cairn import Component
        class Printer(Component):
            def on_activate(self):
                for number in range(1000):
                    print("a library prints", number)
        """
    (tmp_path / "printing.py").write_text(dedent(module))
    printer = "components:\n      printer: {plugin: printing:Printer}"
    file = launch.write(TALK.replace("components:", printer))
    arguments = ["--report", str(tmp_path / "out"), "--set", "storage.max_log_size=10000"]
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            [CAIRN, "up", str(file), *arguments],
            stdout=full,
            stderr=full,
            timeout=LIMIT_S,
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
        )

    assert ended.returncode == 0
    logs = tmp_path / "out" / "logs"
    assert (logs / "printer.log.1").read_text().count("a library prints") == 1000
    assert "ended: shut down" in (logs / "printer.log").read_text()
    log = (logs / "root.log").read_text()
    assert log.count("output of cairn up lost") == 1
    assert "No space left on device" in log
    assert "child ended: talker: all words sent" in log


@pytest.mark.accuracy
def test_old_run_folder_loses_its_logs_and_keeps_its_map(launch: Launching, tmp_path: Path) -> None:
    file = launch.write(TALK)
    old = tmp_path / "cairn" / "runs" / "20260101-sim"
    (old / "logs").mkdir(parents=True)
    (old / "map.yaml").touch()
    command = [CAIRN, "up", str(file), "--lockstep", "--set", "storage.kept_runs=1"]
    environment = {**os.environ, "XDG_STATE_HOME": str(tmp_path)}
    ended = subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=LIMIT_S
    )

    assert ended.returncode == 0, ended.stderr
    assert_words(ended.stderr, "removed the logs of 1 old run", "20260101-sim", "maps")
    assert [path.name for path in old.iterdir()] == ["map.yaml"]
    assert len(list(old.parent.glob("*/logs/lockstep.log"))) == 1


@pytest.mark.accuracy
def test_lockstep_with_the_same_seed_prints_the_same(launch: Launching) -> None:
    runs = [launch(TALK, "--lockstep", "--seed", "7") for _ in range(2)]

    assert [run.await_end() for run in runs] == [0, 0]

    first, second = (lines_of(run)[1:-2] for run in runs)
    assert first == second
    assert any("listener: received 20, the last was 20" in line for line in first)
    assert "child ended: talker: all words sent" in runs[0].log_of("lockstep")


@pytest.mark.accuracy
def test_lockstep_stops_on_ctrl_c(launch: Launching) -> None:
    run = launch("components: {talker: {plugin: test_talker}}", "--lockstep")
    run.await_line("child active: talker")

    assert run.stop() == 0

    run.await_line("child stopped: talker: shut down")


def test_ctrl_c_during_the_start_leaves_no_process(launch: Launching) -> None:
    run = launch(TALK)
    run.await_line("logs and report")

    run.stop()

    run.await_nothing_left()


def test_deployment_with_problems_is_not_started(launch: Launching) -> None:
    run = launch("components: {talker: {plugin: test_takler}}")

    assert run.await_end() == 1

    run.await_line("cairn: the deployment has 1 problem:")
    assert not (run.report / "logs").exists()


@pytest.mark.accuracy
def test_two_robots_share_a_bus_unless_they_have_the_same_name(launch: Launching) -> None:
    first = launch(TALK.replace("words: 20", "words: 0"), robot="alpha")
    first.await_line("child active: talker")
    second = launch(ENDLESS, robot="beta", connect=first.endpoint)
    second.await_line("child active: beacon")

    def names(*arguments: str) -> set[str]:
        rows = cairn("ps", "--json", *arguments, connect=first.endpoint).json
        return {row["component"] for row in rows}

    alpha = {"/alpha/root", "/alpha/listener", "/alpha/talker"}
    beta = {"/beta/root", "/beta/beacon"}
    assert eventually(lambda: names() == alpha | beta)
    assert eventually(lambda: names("--robot", "beta") == beta)
    assert cairn("ps", connect=first.endpoint).out.startswith("robot  component ")
    several = cairn("param", "list", "root", connect=first.endpoint)
    assert several.code == 1
    assert_words(several.err, "/alpha/root, /beta/root", "--robot")
    assert cairn("restart", "beacon", "--robot", "beta", connect=first.endpoint).code == 0

    talker = first.pid_of("talker")
    third = launch(ENDLESS, robot="alpha", connect=first.endpoint)
    assert third.await_end() == 1
    third.await_line(
        rf"a robot alpha runs already on the bus of {first.endpoint}; give this one another name"
    )
    assert first.pid_of("talker") == talker

    assert second.stop() == 0
    assert first.stop() == 0


def test_up_shows_a_live_table_on_a_terminal(launch: Launching, tmp_path: Path) -> None:
    file = launch.write(TALK)
    screen, terminal = pty.openpty()
    with subprocess.Popen(
        [CAIRN, "up", str(file), "--report", str(tmp_path / "report")],
        stdout=terminal,
        stderr=terminal,
        stdin=terminal,
        env={**os.environ, "TERM": "xterm", "COLUMNS": "100", "LINES": "30"},
    ) as process:
        os.close(terminal)
        shown = everything_from(screen)
        assert process.wait(LIMIT_S) == 0
    assert re.search(r"component +state +CPU", shown)
    assert "finalized" in shown
    assert "talker has finished: all words sent" in shown


def everything_from(screen: int) -> str:
    deadline = time.monotonic() + LIMIT_S
    shown = b""
    while select.select([screen], [], [], max(0.0, deadline - time.monotonic()))[0]:
        try:
            shown += os.read(screen, 1 << 16)
        except OSError:  # the other side has been closed
            break
    os.close(screen)
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.decode(errors="replace"))


@pytest.mark.accuracy
def test_console_of_a_killed_run_ends_with_it(launch: Launching) -> None:
    run = launch(ENDLESS, "--console")
    run.await_line("console: http")
    commands = [psutil.Process(pid).cmdline() for pid in run.pids()]
    assert any("console" in command for command in commands)

    run.process.kill()

    run.await_nothing_left()
