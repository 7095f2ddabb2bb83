"""Runs many tasks: each once, some twice as a check, from the cache if they have been run before.

A worker may end at any time, and with it the scheduler of a cluster: its tasks are submitted again.
That is harmless, because a task depends on nothing but itself.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from dataclasses import dataclass
from typing import Any, Final, Generic, TypeVar

from cairn.errors import CairnError
from cairn.terminal.output import note
from cairn_lab.batch.cache import ResultCache
from cairn_lab.batch.code_versions import DISTRIBUTION
from cairn_lab.batch.task import Task, TaskResult, digest, unpack_result
from cairn_lab.batch.worker import run_task
from cairn_lab.batch.workers import Answer, Workers

T = TypeVar("T")

CHECKED_OF: Final = 100
"""Of so many tasks, one runs twice."""
MOST_LOSSES: Final = 3
"""A task that has lost so many workers may be the reason for it, and fails."""
_POLL_S: Final = 1.0


@dataclass(frozen=True)
class Outcome:
    """How a task ended: with a result; without a valid one if there is a `failure`."""

    result: TaskResult | None
    failure: str = ""


@dataclass(frozen=True)
class _Attempt:
    """A task that is submitted: its number, and how often it has lost its worker.

    `first` is the answer of the first run if this is the second one, which checks it.
    """

    number: int
    with_contents: bool = False
    losses: int = 0
    first: Answer | None = None


class Batch(Generic[T]):
    """Tasks and where they run.

    `receive` is called with the number and the outcome of each task, in the order of their ends.
    """

    def __init__(
        self,
        tasks: Sequence[Task],
        workers: Workers,
        cache: ResultCache | None,
        receive: Callable[[int, Outcome], T],
    ) -> None:
        self._tasks = tasks
        self._workers = workers
        self._cache = cache
        self._receive = receive
        self._received: dict[int, T] = {}
        self._waiting: deque[_Attempt] = deque()
        self._running: dict[Future[Answer], _Attempt] = {}
        self._checked: frozenset[int] = frozenset()
        self._checked_at_home = 0

    def run(self) -> list[T]:
        """Run all; return what `receive` returned, in the order of the tasks.

        Raises `CairnError` if no worker can run them.
        """
        new = [number for number in range(len(self._tasks)) if not self._is_cached(number)]
        self._note_cached(len(self._tasks) - len(new))
        self._waiting.extend(map(_Attempt, new))
        self._checked = self._chosen(new)
        try:
            with self._workers as workers:
                while self._waiting or self._running:
                    self._submit(workers)
                    self._settle(workers)
        except BaseException:
            self._note_interruption()
            raise
        if self._checked_at_home:
            note(
                f"{self._checked_at_home} of {len(self._checked)} double runs were made by the "
                "same worker, because there was no other one"
            )
        return [self._received[number] for number in range(len(self._tasks))]

    def _is_cached(self, number: int) -> bool:
        """Receive a task's result from the cache; return whether it is there."""
        data = self._cache.get(self._tasks[number].key) if self._cache is not None else None
        if data is None:
            return False
        try:
            result = TaskResult.decode(data)
        except ValueError:  # of another format
            return False
        self._end(number, Outcome(result))
        return True

    def _chosen(self, numbers: Sequence[int]) -> frozenset[int]:
        """Return the tasks that run twice: 1 %, by their digests, which are like random numbers."""
        count = min(len(numbers), max(len(numbers) // CHECKED_OF, self._workers.least_checked))
        return frozenset(sorted(numbers, key=lambda number: self._tasks[number].key)[:count])

    def _submit(self, workers: Workers) -> None:
        while self._waiting and len(self._running) < workers.width():
            attempt = self._waiting.popleft()
            task = self._tasks[attempt.number]
            contents = task.packed.contents if attempt.with_contents else {}
            other_than = attempt.first["worker"] if attempt.first is not None else ""
            future = workers.submit(run_task, task.payload(), contents, other_than)
            self._running[future] = attempt

    def _settle(self, workers: Workers) -> None:
        """Wait for the end of tasks, but not for long, and judge it."""
        if not self._running:
            time.sleep(_POLL_S)  # no worker can be reached
            return
        done, _ = wait(self._running, _POLL_S, FIRST_COMPLETED)
        if not done:
            workers.check()
            workers.width()
        for future in done:
            attempt = self._running.pop(future)
            try:
                answer = future.result()
            except CancelledError:
                self._retry(attempt)
            except CairnError:  # no worker could run it
                raise
            except Exception as error:  # `run_task` raises none: its worker did
                self._lose(attempt, repr(error))
            else:
                self._judge(attempt, answer)

    def _judge(self, attempt: _Attempt, answer: Answer) -> None:
        if "refused" in answer:
            raise CairnError(
                f"worker {answer['worker']} runs other code than this computer: "
                f"{answer['refused']}; install the same version of {DISTRIBUTION} and of these "
                "libraries there, and restart it"
            )
        if "missing" in answer:
            self._retry(attempt, with_contents=True)
            return
        try:
            data = unpack_result(answer["result"])
            result = TaskResult.decode(data)
        except ValueError as error:
            self._lose(attempt, f"its result was damaged: {error}")
            return
        if digest(data) != answer["digest"]:
            self._lose(attempt, "its result was damaged on the way")
        elif result.error:
            self._end(attempt.number, Outcome(result, result.error))
        elif attempt.first is not None and attempt.first["digest"] != answer["digest"]:
            self._end(attempt.number, Outcome(None, _difference(attempt.first, answer)))
        elif attempt.first is None and attempt.number in self._checked:
            self._waiting.appendleft(_Attempt(attempt.number, first=answer))
        else:
            if attempt.first is not None and attempt.first["worker"] == answer["worker"]:
                self._checked_at_home += 1
            if self._cache is not None and result.normal:  # what failed may succeed next time
                self._cache.put(self._tasks[attempt.number].key, data)
            self._end(attempt.number, Outcome(result))

    def _lose(self, attempt: _Attempt, reason: str) -> None:
        losses = attempt.losses + 1
        if losses < MOST_LOSSES:
            note(f"{self._tasks[attempt.number].name}: {reason}; it is run again")
            self._retry(attempt, losses=losses)
            return
        failure = f"it has lost its worker {losses} times, the last time by {reason}"
        self._end(attempt.number, Outcome(None, failure))

    def _retry(self, attempt: _Attempt, *, with_contents: bool = False, losses: int = 0) -> None:
        again = _Attempt(attempt.number, with_contents, max(losses, attempt.losses), attempt.first)
        self._waiting.appendleft(again)

    def _end(self, number: int, outcome: Outcome) -> None:
        self._received[number] = self._receive(number, outcome)

    def _note_cached(self, count: int) -> None:
        if count and self._cache is not None:
            note(
                f"{count} of {len(self._tasks)} runs are from the cache {self._cache.folder}; the "
                "same code and files give the same results"
            )

    def _note_interruption(self) -> None:
        if self._cache is not None and len(self._received) < len(self._tasks):
            note(
                f"{len(self._received)} of {len(self._tasks)} runs have ended; run the same "
                "command again to continue with the others"
            )


def run_task_here(task: Task) -> Outcome:
    """Run a task in this process."""
    answer = run_task(task.payload(), task.packed.contents)
    result = TaskResult.decode(unpack_result(answer["result"]))
    return Outcome(result, result.error)


def _difference(first: Answer, second: Answer) -> str:
    """Return in words in which files two results of one task differ."""
    one, other = (TaskResult.decode(unpack_result(each["result"])) for each in (first, second))
    names = sorted(
        name
        for name in one.files.keys() | other.files.keys()
        if one.files.get(name) != other.files.get(name)
    )
    what = ", ".join(names) or f"{one.reason or 'success'} against {other.reason or 'success'}"
    return (
        f"two runs of it differ in {what}: {_by(first)}, {_by(second)}; something besides the "
        "deployment and the seed decides, such as the time, or the kind of processor"
    )


def _by(answer: dict[str, Any]) -> str:
    return f"digest {answer['digest']} by worker {answer['worker']}"
