"""Workers without processes: each task is answered at once by a function of the test."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any, Self

from cairn_lab.batch.task import TaskResult, digest, pack
from cairn_lab.batch.worker import run_task
from cairn_lab.batch.workers import Answer, TaskFunction

Payload = Mapping[str, Any]
Reply = Callable[[Payload, Mapping[str, bytes], str], Answer]
"""Answers a payload with these contents on the worker of this name; or raises."""


class FakeWorkers:
    """Workers with these names, of which the first one takes a task that another one need not."""

    def __init__(
        self, reply: Reply, names: tuple[str, ...] = ("one", "two"), *, least_checked: int = 0
    ) -> None:
        self.least_checked = least_checked
        self.submitted: list[tuple[str, Payload]] = []
        self.most_at_once = 0
        self.ended_with: BaseException | None = None
        self._reply = reply
        self._names = names

    def width(self) -> int:
        return len(self._names)

    def submit(
        self, function: TaskFunction, payload: bytes, contents: Mapping[str, bytes], other_than: str
    ) -> Future[Answer]:
        assert function is run_task
        name = next((one for one in self._names if one != other_than), other_than)
        task = json.loads(payload)
        self.submitted.append((name, task))
        future: Future[Answer] = Future()
        try:
            future.set_result({"worker": name} | self._reply(task, contents, name))
        except Exception as error:
            future.set_exception(error)
        return future

    def check(self) -> None:
        """Do nothing: no future is left open."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self.ended_with = error


def answer(result: TaskResult) -> Answer:
    """The answer of a worker that has made a run with this result."""
    data = result.encode()
    return {"result": pack(data), "digest": digest(data)}


def run_here(task: Payload, contents: Mapping[str, bytes], _name: str) -> Answer:
    """Make the run in this process."""
    return run_task(json.dumps(task).encode(), contents)
