"""Tasks in processes of this computer, which may be killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from multiprocessing import active_children
from pathlib import Path

import psutil
import pytest

from cairn_lab.batch.runner import Batch, Outcome
from cairn_lab.batch.workers import LocalWorkers
from lab_tests.batch.clerks import clerk_tasks
from tests.patience import LIMIT_S

pytestmark = pytest.mark.processes

ROOT = Path(__file__).parents[3]


@pytest.mark.accuracy
def test_batch_continues_when_a_worker_is_killed(tmp_path: Path) -> None:
    ended: list[int] = []

    def receive(number: int, outcome: Outcome) -> str:
        if not ended:
            active_children()[0].kill()
        ended.append(number)
        return outcome.failure

    before = set(active_children())
    failures = Batch(clerk_tasks(tmp_path, range(8)), LocalWorkers(1), None, receive).run()

    assert failures == [""] * 8
    assert set(active_children()) == before


@pytest.mark.accuracy
def test_double_run_is_made_by_another_process_and_a_difference_is_reported(
    tmp_path: Path,
) -> None:
    workers = LocalWorkers(1)
    workers.least_checked = 1
    tasks = clerk_tasks(tmp_path, range(1), "writes_process=true")

    (failure,) = Batch(tasks, workers, None, lambda _, outcome: outcome.failure).run()

    assert failure.startswith("two runs of it differ in numbers.txt: digest ")
    assert failure.count(" process ") == 2


COMMAND = """
from dataclasses import replace
from pathlib import Path
from cairn_lab.batch.cache import ResultCache
from cairn_lab.batch.runner import Batch
from cairn_lab.batch.workers import LocalWorkers
from lab_tests.batch.clerks import clerk_tasks

if __name__ == "__main__":
    folder = Path.cwd()
    quick, endless = clerk_tasks(folder, range(2))
    endless = replace(endless, parameters={"clerk": {"steps": 1_000_000_000}})
    receive = lambda number, _: print("ended", number, flush=True)
    Batch([endless, quick], LocalWorkers(2), ResultCache(folder / "cache"), receive).run()
"""


@pytest.mark.accuracy
def test_interrupted_command_ends_its_workers_at_once(tmp_path: Path) -> None:
    script = tmp_path / "command.py"
    script.write_text(COMMAND)
    with subprocess.Popen(
        [sys.executable, str(script)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as command:
        assert command.stdout is not None
        assert command.stderr is not None
        assert command.stdout.readline() == "ended 1\n"
        workers = psutil.Process(command.pid).children()
        os.killpg(command.pid, signal.SIGINT)  # as Ctrl-C in a terminal
        printed = command.stderr.read()

    assert command.returncode == -signal.SIGINT
    assert "of 2 runs have ended; run the same command again to continue" in printed
    assert printed.count("Traceback") == 1  # that of the command: its workers print none
    _, alive = psutil.wait_procs(workers, LIMIT_S)
    assert len(workers) >= 2
    assert not alive
