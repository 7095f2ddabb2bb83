"""The workers of a Dask cluster, which may be killed, and its scheduler, which may be restarted."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Future, InvalidStateError
from contextlib import suppress
from types import TracebackType
from typing import Any, Final, Self

from distributed import Client

from cairn.errors import CairnError
from cairn.terminal.output import note
from cairn_lab.batch.code_versions import DISTRIBUTION
from cairn_lab.batch.worker import worker_name
from cairn_lab.batch.workers import Answer, TaskFunction

WAITING_TASKS: Final = 2
"""Tasks that are submitted at once for each worker: one runs, one waits."""
_LONGEST_WAIT_S: Final = 300.0
_CONNECT_S: Final = 30.0
_REFRESH_S: Final = 1.0
_CLOSE_S: Final = 5.0
_UNREADABLE: Final = "Error during deserialization"
"""How Dask reports that its scheduler lacks a package of the client."""


class DaskWorkers:
    """Runs tasks by a client of Dask, as futures of `concurrent.futures`.

    If the scheduler is restarted, the client connects to it again, and all futures are canceled.
    """

    least_checked = 1

    def __init__(self, address: str, *, longest_wait_s: float = _LONGEST_WAIT_S) -> None:
        """Remember the address of the scheduler, `tcp://HOST:PORT`.

        `longest_wait_s` is how long [s] it may be away, or have no worker.
        """
        self._address = address
        self._longest_wait_s = longest_wait_s
        self._client: Client | None = None
        self._workers: tuple[str, ...] = ()
        self._names: dict[str, str] = {}
        self._tasks: dict[Future[Answer], tuple[Any, tuple[str, ...]]] = {}
        self._seen_s = self._refreshed_s = 0.0
        self._waiting = False

    def __enter__(self) -> Self:
        """Connect; raises `CairnError` if there is no scheduler."""
        try:
            self._client = self._connect()
        except OSError as error:
            raise CairnError(
                f"{self._address}: no Dask scheduler answers: {error}; start one with `dask "
                "scheduler`, or correct --on"
            ) from error
        self._seen_s = time.monotonic()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Cancel all that has not finished, and disconnect; runs in progress cannot be ended."""
        for future in tuple(self._tasks):
            _cancel(future)
        if self._client is not None:
            with suppress(TimeoutError):  # the scheduler does not answer
                self._client.close(timeout=_CLOSE_S)

    def width(self) -> int:
        """Return how many tasks the workers may have at once, waiting ones included."""
        now = time.monotonic()
        if now >= self._refreshed_s + _REFRESH_S:
            self._refresh()
            self._refreshed_s = now
        elif self._client is None or self._client.status != "running":
            self._workers = ()
        if self._workers:
            self._seen_s = now
            if self._waiting:
                self._waiting = False
                note(f"{self._address}: {len(self._workers)} workers, the runs continue")
        elif now > self._seen_s + self._longest_wait_s:
            raise CairnError(
                f"{self._address}: for {self._longest_wait_s:g} s {self._missing()}; start what is "
                "missing, and this command again: it continues with the results in the cache"
            )
        elif not self._waiting and now > self._seen_s + _REFRESH_S:
            self._waiting = True
            note(f"{self._address}: {self._missing()}; waiting up to {self._longest_wait_s:g} s")
        return WAITING_TASKS * len(self._workers)

    def submit(
        self, function: TaskFunction, payload: bytes, contents: Mapping[str, bytes], other_than: str
    ) -> Future[Answer]:
        """Run a task on a worker with another name, if there is one; see `Workers`."""
        client = self._client
        assert client is not None  # `width` was not 0
        assert client.loop is not None  # it is connected
        others = self._other_than(other_than) if other_than else ()
        task = client.submit(
            function, payload, contents, pure=False, workers=list(others) if others else None
        )
        future: Future[Answer] = Future()
        self._tasks[future] = (task, others)
        future.add_done_callback(self._forget)
        client.loop.add_callback(_pass_on, client, task, future)
        return future

    def check(self) -> None:
        """Cancel the tasks that may run only on workers that have gone."""
        for future, (_, allowed) in tuple(self._tasks.items()):
            if allowed and self._workers and not set(allowed) & set(self._workers):
                _cancel(future)

    def _forget(self, future: Future[Answer]) -> None:
        task, _ = self._tasks.pop(future)
        if future.cancelled() and self._client is not None and self._client.status == "running":
            task.cancel()

    def _connect(self) -> Client:
        return Client(self._address, timeout=_CONNECT_S, set_as_default=False, name="cairn")

    def _refresh(self) -> None:
        """Update the addresses of the workers: none while the scheduler does not answer."""
        self._workers = ()
        if self._client is None or self._client.status == "closed":
            for future in tuple(self._tasks):
                _cancel(future)
            self._client = None
            with suppress(OSError):  # tried again in a second
                self._client = self._connect()
        if self._client is not None and self._client.status == "running":
            with suppress(OSError, TimeoutError):  # the connection breaks in this moment
                self._workers = tuple(sorted(self._client.nthreads()))

    def _other_than(self, name: str) -> tuple[str, ...]:
        """Return the addresses of the workers with other names; none if there is no other one."""
        assert self._client is not None
        if not set(self._workers) <= self._names.keys():
            with suppress(OSError, TimeoutError):  # a worker has gone: without it
                self._names = _named(self._client.run)
        return tuple(one for one in self._workers if self._names.get(one, name) != name)

    def _missing(self) -> str:
        if self._client is not None and self._client.status == "running":
            return "it has no worker (if some were started, read their logs)"
        return "it does not answer"


async def _pass_on(client: Client, task: Any, future: Future[Answer]) -> None:
    """Set a future to the result of a task of Dask, or to what prevents it.

    The executor of Dask does not: if the scheduler ends while a result is fetched, its future waits
    for ever (`distributed.cfexecutor`, version 2026.8).
    """
    with suppress(InvalidStateError):  # canceled meanwhile
        try:
            future.set_result(await client.gather(task, asynchronous=True))
        except asyncio.CancelledError:
            future.set_exception(CancelledError())
        except Exception as error:  # any: the future must not wait for ever
            failure = CancelledError() if task.cancelled() else error
            if isinstance(error, RuntimeError) and _UNREADABLE in str(error):
                failure = CairnError(
                    f"the scheduler cannot read the tasks of {DISTRIBUTION}: {error.__cause__}; "
                    "install the same version there, too, and restart it"
                )
            future.set_exception(failure)


def _cancel(future: Future[Answer]) -> None:
    """Cancel a future, and wake who waits for it."""
    if not future.done() and future.cancel():
        future.set_running_or_notify_cancel()


def _named(run: Callable[..., Mapping[str, str]]) -> dict[str, str]:
    """Return the name of each worker by its address."""
    found = run(worker_name, on_error="ignore")
    return {address: name for address, name in found.items() if isinstance(name, str)}
