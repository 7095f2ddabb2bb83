"""The zygote with real processes: which processes end together, so that nothing remains."""

import os
import queue
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any
from uuid import uuid4

import psutil
import pytest

from cairn import CairnError
from cairn.processes import launcher
from cairn.processes.child import ChildUnavailable, ZygoteLost
from cairn.processes.launcher import ZygoteProcess, start_zygote
from cairn.processes.orphan_cleanup import kill_marked
from tests.cairn.bus.network import eventually
from tests.patience import LIMIT_S
from tests.sweeps import sampled
from tests.wording import words_in_order

from . import zygote_children
from .reports import Tree
from .zygote_owner import Owner

pytestmark = pytest.mark.processes


CHILDREN = zygote_children.__name__
FRESH = pytest.mark.parametrize("fresh", sampled([False, True]), ids=["shared", "fresh"])
HIDDEN = pytest.mark.parametrize("how", sampled(["daemon", "own session", "same group"]))


@HIDDEN
def test_helpers_left_by_a_process_that_returns_are_killed(owner: Owner, how: str) -> None:
    owner.spawn("leave_helper", how=how)
    assert owner.exits.get(timeout=LIMIT_S).code == 0
    # It may have been killed before it could report: the fixture `tree` sees that it is gone.


@HIDDEN
@FRESH
def test_helpers_of_a_killed_process_are_killed(owner: Owner, how: str, fresh: bool) -> None:
    driver = owner.spawn_reporting("keep_helper", how=how, fresh=fresh)
    helper = owner.reports.of("driver's helper")
    os.kill(driver.pid, signal.SIGKILL)
    helper.await_end()


def test_closing_a_connection_ends_its_processes_and_no_others(
    make_owner: Callable[[], Owner],
) -> None:
    first, second = make_owner(), make_owner()
    driver = first.spawn_reporting("keep_helper", how="own session")
    helper = first.reports.of("driver's helper")
    other = second.spawn_reporting("run_until_killed", "other")
    first.client.close()
    driver.await_end()
    helper.await_end()
    assert first.exits.get(timeout=LIMIT_S).code == -signal.SIGKILL
    assert first.losses.empty()
    with pytest.raises(CairnError, match="is closed"):
        first.spawn("run_until_killed")
    os.kill(other.pid, 0)
    assert second.exits.empty()


def test_processes_of_a_killed_owner_end_with_it(owner: Owner) -> None:
    middle = owner.spawn_reporting("own", "middle")
    leaf, helper = owner.reports.of("leaf"), owner.reports.of("leaf's helper")
    bystander = owner.spawn_reporting("run_until_killed", "bystander")
    os.kill(middle.pid, signal.SIGKILL)
    leaf.await_end()
    helper.await_end()
    os.kill(bystander.pid, 0)


def test_fork_of_a_dead_owner_does_not_keep_its_processes_alive(owner: Owner) -> None:
    middle = owner.spawn_reporting("own_and_fork", "middle")
    leaf, fork = owner.reports.of("leaf"), owner.reports.of("fork")
    os.kill(middle.pid, signal.SIGKILL)
    leaf.await_end()
    fork.await_end()


@pytest.mark.parametrize(
    "slow",
    [
        "open(GATE).read()",
        "from cairn.system.kernel_compilation import add_deferred, prepare_compilation\n"
        "prepare_compilation()\n"
        "add_deferred('kernels', lambda: open(GATE).read())",
    ],
    ids=["import", "compilation"],
)
def test_root_killed_during_the_imports_leaves_no_process(
    tree: Tree, tmp_path: Path, slow: str
) -> None:
    gate = tmp_path / "gate"
    os.mkfifo(gate)
    (tmp_path / "imports_slowly.py").write_text(f"GATE = {str(gate)!r}\n{slow}\n")
    program = (
        f"import sys; sys.path[:] = {[str(tmp_path), *sys.path]!r}\n"
        "from pathlib import Path\n"
        "from cairn.processes.launcher import start_zygote\n"
        f"zygote = start_zygote(['imports_slowly'], Path({str(tmp_path / 'run')!r}))\n"
        "sys.stdin.read()\n"
    )
    with (
        subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE) as root,
        gate.open("w"),  # opens when the zygote reads
    ):
        root.kill()
        root.wait(LIMIT_S)
        tree.await_end()


@FRESH
def test_all_processes_end_with_a_killed_zygote(
    owner: Owner, zygote: ZygoteProcess, tree: Tree, tmp_path: Path, fresh: bool
) -> None:
    driver = owner.spawn_reporting("keep_helper", how="same group")
    owner.reports.of("driver's helper")
    middle = owner.spawn_reporting("own", "middle", leaf_fresh=fresh)
    leaf = owner.reports.of("leaf")
    owner.reports.of("leaf's helper")
    os.kill(zygote.process.pid, signal.SIGKILL)
    leaf.await_end()
    assert "zygote lost: " in str(owner.losses.get(timeout=LIMIT_S))
    exits = [owner.exits.get(timeout=LIMIT_S) for _ in range(2)]
    assert {exited.pid for exited in exits} == {driver.pid, middle.pid}
    with pytest.raises(ZygoteLost):
        owner.spawn("run_until_killed")
    zygote.close()
    assert zygote.process.poll() is not None
    tree.await_end()
    another = start_zygote([CHILDREN], tmp_path / "run")
    renewed = Owner(another, owner.reports, owner.log)
    renewed.spawn_reporting("run_until_killed", "renewed")
    renewed.client.close()
    another.close()


@pytest.mark.accuracy
def test_sigterm_to_the_zygote_leaves_no_process(
    owner: Owner, zygote: ZygoteProcess, tree: Tree
) -> None:
    owner.spawn_reporting("keep_helper", how="daemon")
    owner.reports.of("driver's helper")
    os.kill(zygote.process.pid, signal.SIGTERM)
    tree.await_end()


def test_ending_the_zygote_leaves_no_process(
    owner: Owner, zygote: ZygoteProcess, tree: Tree
) -> None:
    owner.spawn_reporting("keep_helper", how="daemon")
    owner.reports.of("driver's helper")
    zygote.close()
    tree.await_end()
    assert not zygote.socket_path.exists()


def test_killed_processes_that_are_not_reaped_count_as_ended() -> None:
    mark = uuid4().hex
    program = (
        "import os, subprocess, sys\n"
        "environment = {**os.environ, 'CAIRN_TREE': sys.argv[1]}\n"
        "pipes = dict(stdin=subprocess.PIPE, stdout=subprocess.PIPE)\n"
        "child = subprocess.Popen(['cat'], env=environment, **pipes)\n"
        "child.stdin.write(b'executed')  # only from then on its environment can be read\n"
        "child.stdin.flush()\n"
        "child.stdout.read(1)\n"
        "print(child.pid, flush=True)\n"
        "sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, mark], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as parent:
        assert parent.stdout is not None
        child = psutil.Process(int(parent.stdout.readline()))
        left: queue.Queue[list[int]] = queue.Queue()
        threading.Thread(
            target=lambda: left.put(kill_marked(mark, 2 * LIMIT_S)), daemon=True
        ).start()

        assert left.get(timeout=LIMIT_S) == []

        assert eventually(lambda: child.status() == psutil.STATUS_ZOMBIE)


def test_zygote_that_does_not_answer_is_reported_and_a_late_process_killed(
    owner: Owner, zygote: ZygoteProcess
) -> None:
    os.kill(zygote.process.pid, signal.SIGSTOP)
    with pytest.raises(
        ChildUnavailable, match=words_in_order("did not start driver within 0.05 s", "load")
    ):
        owner.client.spawn(
            "driver",
            f"{CHILDREN}:run_until_killed",
            {"name": "driver", **owner.facts},
            owner.log,
            timeout_s=0.05,
        )
    os.kill(zygote.process.pid, signal.SIGCONT)
    owner.spawn("write_output", text="").wait(LIMIT_S)
    # The late one may be killed before it could report: the fixture `tree` sees that it is gone.


def test_process_whose_start_is_answered_just_at_the_time_limit_is_returned(
    owner: Owner, monkeypatch: pytest.MonkeyPatch
) -> None:
    class LateAnswer(Future[Any]):
        """The wait times out when the reader has taken the answer."""

        def result(self, timeout: float | None = None) -> Any:
            answer = super().result(LIMIT_S)
            if timeout is not None:
                raise TimeoutError
            return answer

    monkeypatch.setattr(launcher, "Future", LateAnswer)
    monkeypatch.setattr(launcher, "_PIECE_S", 2 * LIMIT_S)  # its one wait is the last one
    driver = owner.spawn("run_until_killed")
    assert owner.reports.of("driver").pid == driver.pid
    driver.kill()
    assert owner.exits.get(timeout=LIMIT_S).pid == driver.pid
