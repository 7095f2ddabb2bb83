"""The batch runner: results in order, retries, double runs, the cache; with workers of the test."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from cairn import CairnError
from cairn_lab.batch import code_versions
from cairn_lab.batch.cache import ResultCache
from cairn_lab.batch.runner import Batch, Outcome
from cairn_lab.batch.task import Task, TaskResult
from cairn_lab.batch.worker import worker_name
from cairn_lab.batch.workers import Answer
from lab_tests.batch.clerks import OUTPUT, clerk_tasks
from lab_tests.batch.fake_workers import FakeWorkers, Payload, answer, run_here


def numbers(task: Payload, _contents: object = None, _name: str = "") -> Answer:
    """The prepared answer to a task: its seed."""
    return answer(TaskResult(True, True, "", {OUTPUT: str(task["seed"]).encode()}))


def run(tasks: list[Task], workers: FakeWorkers, cache: ResultCache | None = None) -> list[str]:
    """Run a batch; return the outputs, or the failures."""

    def receive(_number: int, outcome: Outcome) -> str:
        if outcome.failure or outcome.result is None:
            return outcome.failure
        return outcome.result.files[OUTPUT].decode()

    return Batch(tasks, workers, cache, receive).run()


@pytest.fixture
def tasks(tmp_path: Path) -> list[Task]:
    return clerk_tasks(tmp_path / "project", range(4))


def test_files_are_sent_to_a_worker_that_lacks_them(tmp_path: Path) -> None:
    tasks = clerk_tasks(tmp_path / "project", range(3))
    sent: list[int] = []

    def reply(task: Payload, contents: Mapping[str, bytes], name: str) -> Answer:
        sent.append(len(contents))
        return run_here(task, contents, name)

    outputs = run(tasks, FakeWorkers(reply, ("one",)))

    assert [output.split()[0] for output in outputs] == ["begin"] * 3
    assert len(set(outputs)) == 3
    assert sent in ([0, 1, 0, 0], [0, 0, 0])  # the second: another test has sent the same file


def test_results_have_the_order_of_the_tasks_also_after_retries(tasks: list[Task]) -> None:
    lost = [2, 0, 2]

    def reply(task: Payload, _contents: object, _name: str) -> Answer:
        if task["seed"] in lost:
            lost.remove(task["seed"])
            raise ConnectionError("the worker has ended")
        return numbers(task)

    assert run(tasks, FakeWorkers(reply)) == ["0", "1", "2", "3"]
    assert lost == []


def test_task_that_kills_its_workers_fails_alone(tasks: list[Task]) -> None:
    def reply(task: Payload, _contents: object, _name: str) -> Answer:
        if task["seed"] == 1:
            raise ConnectionError("the worker has ended")
        return numbers(task)

    outputs = run(tasks, FakeWorkers(reply))

    assert outputs[0::2] == ["0", "2"]
    assert outputs[1].startswith("it has lost its worker 3 times, the last time by Connection")


def test_damaged_result_is_not_accepted(tasks: list[Task]) -> None:
    damaged: list[Answer] = [
        {"result": b"nothing"},
        {"result": numbers({"seed": 9})["result"], "digest": numbers({"seed": 0})["digest"]},
    ]

    def reply(task: Payload, _contents: object, _name: str) -> Answer:
        return damaged.pop() if damaged else numbers(task)

    assert run(tasks, FakeWorkers(reply)) == ["0", "1", "2", "3"]


def test_checked_task_runs_on_two_workers(tasks: list[Task]) -> None:
    workers = FakeWorkers(numbers, least_checked=1)

    run(tasks, workers)

    seeds = [task["seed"] for _, task in workers.submitted]
    (twice,) = {seed for seed in seeds if seeds.count(seed) == 2}
    assert {name for name, task in workers.submitted if task["seed"] == twice} == {"one", "two"}


def test_different_results_of_a_task_are_a_failure_and_not_kept(
    tasks: list[Task], tmp_path: Path
) -> None:
    def reply(task: Payload, _contents: object, name: str) -> Answer:
        seed = task["seed"] if name == "one" else 77
        return numbers({"seed": seed})

    cache = ResultCache(tmp_path / "cache")
    workers = FakeWorkers(reply, least_checked=2)
    outputs = run(tasks, workers, cache)

    failures = [output for output in outputs if not output.isdigit()]
    assert len(failures) == 2
    number = outputs.index(failures[0])
    digests = [numbers({"seed": seed})["digest"] for seed in (number, 77)]
    assert f"differ in {OUTPUT}: digest {digests[0]} by worker one, digest " in failures[0]
    assert f"{digests[1]} by worker two" in failures[0]
    assert cache.get(tasks[number].key) is None


def test_one_of_a_hundred_tasks_is_checked(tmp_path: Path) -> None:
    tasks = clerk_tasks(tmp_path / "project", range(250))
    workers = FakeWorkers(numbers)

    run(tasks, workers)

    assert len(workers.submitted) == 252


def test_interrupted_batch_continues_with_what_is_missing(
    tasks: list[Task], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cache = ResultCache(tmp_path / "cache")

    class Interrupted(FakeWorkers):
        def width(self) -> int:
            if len(self.submitted) == 2:
                raise KeyboardInterrupt
            return 1

    first = Interrupted(numbers)
    with pytest.raises(KeyboardInterrupt):
        run(tasks, first, cache)
    interrupted = capsys.readouterr().err
    second = FakeWorkers(numbers)
    outputs = run(tasks, second, cache)

    assert isinstance(first.ended_with, KeyboardInterrupt)
    assert "of 4 runs have ended; run the same command again" in interrupted
    assert outputs == ["0", "1", "2", "3"]
    assert len(first.submitted) + len(second.submitted) <= 5
    assert f"of 4 runs are from the cache {cache.folder}" in capsys.readouterr().err


def test_failed_run_is_made_again(tasks: list[Task], tmp_path: Path) -> None:
    reason = "its component failed: no space left on device"

    def reply(task: Payload, _contents: object, _name: str) -> Answer:
        error = reason if task["seed"] < 2 else ""
        return answer(TaskResult(False, False, reason, {OUTPUT: reason.encode()}, error))

    cache = ResultCache(tmp_path / "cache")

    assert run(tasks, FakeWorkers(reply), cache) == [reason] * 4
    assert run(tasks, FakeWorkers(numbers), cache) == ["0", "1", "2", "3"]


def test_worker_with_other_code_is_refused_in_words(
    tasks: list[Task], monkeypatch: pytest.MonkeyPatch
) -> None:
    here = code_versions.code_versions(("cairn_test_plugins",))
    monkeypatch.setattr("cairn_lab.batch.worker.code_versions", lambda _: here | {"numpy": "1.0"})
    workers = FakeWorkers(run_here)

    with pytest.raises(CairnError) as raised:
        run(tasks, workers)

    message = str(raised.value)
    assert f"worker {worker_name()} runs other code than this computer" in message
    assert f"it has numpy 1.0 instead of {here['numpy']}" in message
    assert "install the same version of cairn-robotics" in message
    assert raised.value is workers.ended_with
