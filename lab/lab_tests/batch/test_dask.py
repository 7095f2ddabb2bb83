"""Tasks on a real Dask cluster on this computer, whose workers and scheduler are killed."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from cairn import CairnError
from cairn.testing.launching import free_port
from cairn_lab.batch.dask_workers import DaskWorkers
from cairn_lab.batch.options import BatchOptions
from cairn_lab.batch.runner import Batch, Outcome
from lab_tests.batch.clerks import OUTPUT, clerk_tasks
from lab_tests.batch.fake_workers import FakeWorkers, run_here
from tests.commands import cairn

pytestmark = pytest.mark.processes


class Cluster:
    """A scheduler with workers, all of them processes."""

    def __init__(self, folder: Path) -> None:
        self.port = free_port()
        self.scheduler: subprocess.Popen[bytes] | None = None
        self.workers: list[subprocess.Popen[bytes]] = []
        self._folder = folder

    def start(self, workers: int) -> None:
        """Start the scheduler if it does not run, and more workers."""
        address = f"tcp://127.0.0.1:{self.port}"
        local = ("--host", "127.0.0.1", "--no-dashboard")
        if self.scheduler is None:
            self.scheduler = self._started("scheduler", *local, "--port", str(self.port))
            assert self.scheduler.stderr is not None
            while b"Scheduler at:" not in self.scheduler.stderr.readline():
                assert self.scheduler.poll() is None
        for _ in range(workers):
            worker = self._started("worker", address, *local, "--nthreads", "1", "--no-nanny")
            self.workers.append(worker)

    def kill_scheduler(self) -> None:
        """Kill the scheduler, on which the workers end."""
        assert self.scheduler is not None
        self.scheduler.kill()
        self.scheduler.communicate()
        self.scheduler = None

    def kill(self) -> None:
        """Kill all."""
        started = [*self.workers, *([self.scheduler] if self.scheduler else [])]
        for process in started:
            process.kill()
        for process in started:
            process.communicate()

    def _started(self, kind: str, *arguments: str) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", f"distributed.cli.dask_{kind}", *arguments],
            stderr=subprocess.PIPE,  # a few lines
            cwd=self._folder,
        )


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    found = Cluster(tmp_path_factory.mktemp("cluster"))
    found.start(2)
    yield found
    found.kill()


@pytest.mark.accuracy
def test_report_from_a_cluster_is_that_of_this_computer(
    tmp_path: Path, cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    world = tmp_path / "cell.yaml"
    world.write_text(
        "walls: [{points: [[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]}]\nrobot: {x: 1, y: 1}\n"
    )

    def evaluated(out: Path, *where: str) -> dict[str, bytes]:
        answer = cairn(
            "evaluate", "navigation", "--world", str(world), "--goals", "1", "--seeds", "1..2",
            "--no-cache", "--out", str(out), *where,
        )  # fmt: skip
        assert answer.code == 0, answer
        files = [file for file in out.rglob("*") if file.is_file()]
        return {str(file.relative_to(out)): file.read_bytes() for file in files}

    there = evaluated(tmp_path / "there", "--on", f"dask://127.0.0.1:{cluster.port}")
    monkeypatch.setattr(BatchOptions, "open_workers", lambda *_: FakeWorkers(run_here))
    here = evaluated(tmp_path / "here")

    assert {"runs.json", "logs/seed-1.log", "logs/seed-2.log", "tracks.png"} <= here.keys()
    assert there == here


@pytest.mark.accuracy
def test_batch_survives_a_killed_worker_and_a_restarted_scheduler(
    tmp_path: Path, cluster: Cluster
) -> None:
    tasks = clerk_tasks(tmp_path / "project", range(40))
    ended = 0

    def receive(_number: int, outcome: Outcome) -> bytes:
        nonlocal ended
        ended += 1
        if ended == 5:
            cluster.workers[0].kill()
        if ended == 15:
            cluster.kill_scheduler()
            cluster.start(2)
        return outcome.result.files[OUTPUT] if outcome.result else outcome.failure.encode()

    workers = DaskWorkers(f"tcp://127.0.0.1:{cluster.port}")
    workers.least_checked = 10
    found = Batch(tasks, workers, None, receive).run()

    def output(_number: int, outcome: Outcome) -> bytes:
        assert outcome.result is not None
        return outcome.result.files[OUTPUT]

    assert found == Batch(tasks, FakeWorkers(run_here), None, output).run()


def test_absent_scheduler_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cairn_lab.batch.dask_workers._CONNECT_S", 0.2)
    port = free_port()

    with (
        pytest.raises(CairnError, match=f"tcp://127.0.0.1:{port}: no Dask scheduler answers"),
        DaskWorkers(f"tcp://127.0.0.1:{port}"),
    ):
        pass


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"on": "tcp://127.0.0.1:8786"}, "write it as dask://HOST:PORT"),
        ({"on": "dask://127.0.0.1"}, "write it as dask://HOST:PORT"),
        ({"on": "dask://127.0.0.1:8786/x"}, "write it as dask://HOST:PORT"),
        ({"on": "dask://127.0.0.1:99999"}, "write it as dask://HOST:PORT"),
        ({"on": "dask://127.0.0.1:8786", "workers": 2}, "--workers is the number of processes"),
        ({"cache": Path("x"), "no_cache": True}, "exclude each other"),
    ],
)
def test_invalid_options_are_rejected(options: dict[str, object], message: str) -> None:
    with pytest.raises(CairnError, match=message):
        BatchOptions(**options)  # type: ignore[arg-type]


def test_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cairn_lab.batch.options.find_spec", lambda _: None)

    with pytest.raises(CairnError, match=r"pip install 'cairn-lab\[dask\]'"):
        BatchOptions(on="dask://127.0.0.1:8786")
