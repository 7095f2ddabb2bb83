"""Where tasks run: behind one interface, the processes of this computer, or a cluster."""

from __future__ import annotations

import signal
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import active_children
from multiprocessing.process import BaseProcess
from types import TracebackType
from typing import Any, Protocol, Self

from cairn_lab.batch.worker import worker_name
from cairn_lab.batch.worker_pool import worker_pool

Answer = dict[str, Any]
TaskFunction = Callable[[bytes, Mapping[str, bytes]], Answer]
"""The signature of `run_task`."""


class Workers(Protocol):
    """Runs tasks by executors of `concurrent.futures`.

    A future that is canceled, or that raises, says nothing about its task: the worker was lost. But
    a `CairnError` says that no worker can run the task.
    """

    least_checked: int
    """How many tasks of a batch at least run on two workers."""

    def width(self) -> int:
        """Return how many tasks may be submitted at once, now; 0 while no worker can be reached.

        Raises `CairnError` if there has been no worker for too long.
        """

    def submit(
        self, function: TaskFunction, payload: bytes, contents: Mapping[str, bytes], other_than: str
    ) -> Future[Answer]:
        """Run a task on a worker of another name than `other_than`, if there is one."""

    def check(self) -> None:
        """Cancel the futures whose workers are gone; called about once a second."""

    def __enter__(self) -> Self:
        """Open what the workers need."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Cancel what has not finished, and end what was opened."""


@dataclass
class _Process:
    """An executor with one process, which is started with its first task."""

    executor: Executor
    process: BaseProcess | None = None
    task: Future[Answer] | None = None

    @property
    def name(self) -> str:
        return worker_name(self.process.pid) if self.process is not None else ""


class LocalWorkers:
    """Processes of this computer, each with an executor of its own.

    So the end of a process loses its own task alone. Use it on the main thread: see `worker_pool`.
    """

    least_checked = 0

    def __init__(self, count: int) -> None:
        self._processes = [_Process(worker_pool(1)) for _ in range(count)]

    def width(self) -> int:
        """Return the number of processes."""
        return len(self._processes)

    def submit(
        self, function: TaskFunction, payload: bytes, contents: Mapping[str, bytes], other_than: str
    ) -> Future[Answer]:
        """Run a task in an idle process; if only `other_than` is idle, in a new one in its place.

        No more tasks than `width` may be submitted at once.
        """
        idle = [one for one in self._processes if one.task is None or one.task.done()]
        others = [one for one in idle if not other_than or one.name != other_than]
        chosen = others[0] if others else self._replaced(idle[0])
        try:
            chosen.task = self._start(chosen, function, payload, contents)
        except BrokenProcessPool:  # its process has ended, in its last task or after it
            chosen = self._replaced(chosen)
            chosen.task = self._start(chosen, function, payload, contents)
        return chosen.task

    def check(self) -> None:
        """Do nothing: the executors notice the end of their processes."""

    def __enter__(self) -> Self:
        """Return the workers, whose processes start with their tasks."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the processes; after an error or an interruption at once, in the middle of a run."""
        for one in self._processes:
            if error is not None and one.process is not None:
                with suppress(ValueError):  # its executor has closed it
                    one.process.kill()
            one.executor.shutdown(cancel_futures=True)

    def _replaced(self, one: _Process) -> _Process:
        """End an idle process; return its successor."""
        one.executor.shutdown()
        new = _Process(worker_pool(1))
        self._processes[self._processes.index(one)] = new
        return new

    def _start(
        self, one: _Process, function: TaskFunction, payload: bytes, contents: Mapping[str, bytes]
    ) -> Future[Answer]:
        if one.process is not None:
            return one.executor.submit(function, payload, contents)
        before = set(active_children())
        # Ctrl-C reaches all processes of the terminal: a worker inherits that it is not for it.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            future = one.executor.submit(function, payload, contents)
            one.process = next(iter(set(active_children()) - before), None)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        return future
