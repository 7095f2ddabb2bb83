"""Launches a component in a process of its own, and makes requests to it over the bus."""

import queue
import re
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import zenoh

from cairn.bus.bus import full_name
from cairn.bus.control import NoReplyError, request
from cairn.bus.discovery import QueryableWatcher
from cairn.bus.keys import control_key
from cairn.deployment.plugins import load_plugin
from cairn.errors import CairnError
from cairn.process_exit import ExitLog, ExitReport
from cairn.runtime.launch_request import LaunchRequest
from cairn.supervision.child import ChildUnavailable, Verb
from cairn.supervision.zygote_client import ChildProcess, ZygoteClient

ENTRY = "cairn.placement.component_process:main"
"""What every component's process runs."""
TRACEBACK_SIGNAL = signal.SIGUSR1
"""A component's process that receives it logs the stacks of all of its threads."""
_TRACEBACK_LIMIT_S = 5.0  # only a process that cannot log at all needs so long
_TRACEBACK_POLL_S = 0.01
_TRACEBACK = b"(most recent call first)"
_KILL_LIMIT_S = 5.0
_EXIT_AFTER_ERROR_S = 0.2  # a component that refuses a request ends soon after
_LEAVING_LIMIT_S = 5.0  # between leaving the bus and the end of the process, in either order


class ProcessHandle:
    """A component in a process of its own, which `launch` starts; see `ChildHandle`."""

    def __init__(self, launch: LaunchRequest, session: zenoh.Session) -> None:
        context = launch.context
        self._launch = launch
        self._session = session
        self._name = full_name(context.robot, launch.name)
        self._log = ExitLog(Path(context.log_folder) / f"{launch.name}.log")
        self._watcher = QueryableWatcher(session, control_key(context.domain, self._name))
        self._process: ChildProcess | None = None
        self._starting = True
        self._answer: queue.SimpleQueue[Exception | None] = queue.SimpleQueue()

    def launch(self, zygote: ZygoteClient, on_exit: Callable[[], None]) -> None:
        """Start the process and wait until it accepts requests.

        See `SupervisorHost.launch_child`.
        """
        launch, timeout_s = self._launch, self._launch.spec.start_limit_s
        fresh = launch.spec.interpreter == "fresh"
        with self._watcher as watcher:
            if not watcher.wait_gone(min(timeout_s, _LEAVING_LIMIT_S)):
                raise ChildUnavailable(
                    f"another component on this bus answers as {self._name}; stop that one, or "
                    "give this robot another name (`--set robot=NAME`)"
                )
            self._process = process = zygote.spawn(
                launch.name,
                ENTRY,
                launch.model_dump(mode="json"),
                self._log.file,
                fresh=fresh,
                needs=[] if fresh else [load_plugin(launch.spec.plugin).__module__],
                timeout_s=timeout_s,
            )
            process.on_exit(lambda _: watcher.give_up())
            process.on_exit(lambda _: on_exit())
            if watcher.wait(timeout_s):
                return
        exited = process.wait(0)
        if exited is None:
            process.kill()
            if process.wait(_KILL_LIMIT_S) is None:
                return  # with its time used up; `Child` must not start another one meanwhile
            raise ChildUnavailable(
                f"it did not join the bus within {timeout_s:g} s; log: {self._log.file}"
            )
        reason = self._log.report(exited.pid, exited.code).reason
        raise ChildUnavailable(reason) if exited.code < 0 else CairnError(reason)

    def request(self, verb: Verb, timeout_s: float) -> None:
        """Have it make a transition; see `ChildHandle`. `cancel_start` cuts a start short."""
        deadline = time.monotonic() + timeout_s
        self._starting = verb in ("configure", "activate")
        # The request is made on another thread, so that `cancel_start` can cut the wait short.
        answer: queue.SimpleQueue[Exception | None] = queue.SimpleQueue()
        self._answer = answer
        threading.Thread(
            target=self._request, args=(verb, timeout_s, answer), name=verb, daemon=True
        ).start()
        error = answer.get()  # `_request` keeps the time limit
        if isinstance(error, NoReplyError):
            # That it has left the bus is known before its exit.
            left_s = max(0.0, deadline - time.monotonic())
            report = self.wait(min(left_s, _LEAVING_LIMIT_S))
            if report is None and time.monotonic() >= deadline:
                raise ChildUnavailable(f"no answer within {timeout_s:.1f} s")
            if report is None:
                raise ChildUnavailable(str(error))
            if not report.normal or verb != "shutdown":
                raise ChildUnavailable(report.reason)
        elif error is not None:  # the component's own
            self.wait(_EXIT_AFTER_ERROR_S)
            raise error
        self._starting = verb == "configure"  # the next step follows

    def cancel_start(self) -> None:
        """Cut short the start in progress, and ask the process to end; from any thread."""
        if self._starting:
            self._watcher.give_up()
            self._answer.put(CairnError("a stop was requested"))
            self.terminate()

    def terminate(self) -> None:
        """Ask its process to end."""
        if self._process is not None:
            self._process.terminate()

    def kill(self) -> None:
        """Kill its process group, after its process has logged the stacks of its threads."""
        if self._process is not None:
            before, size = _threads_of(self._process.pid), self._log.size()
            self._process.signal(TRACEBACK_SIGNAL)
            deadline = time.monotonic() + _TRACEBACK_LIMIT_S
            while self._process.wait(_TRACEBACK_POLL_S) is None and time.monotonic() < deadline:
                now = _threads_of(self._process.pid)
                if now.stopped:
                    break
                # The kernel blocks the signal in the thread that handles it.
                if now.blocking <= before.blocking and self._log.has_since(size, _TRACEBACK):
                    break
            self._process.kill()

    def wait(self, timeout_s: float) -> ExitReport | None:
        """Wait for its end; see `ChildHandle`."""
        exited = None if self._process is None else self._process.wait(timeout_s)
        return None if exited is None else self._log.report(exited.pid, exited.code)

    def _request(
        self, verb: Verb, timeout_s: float, answer: "queue.SimpleQueue[Exception | None]"
    ) -> None:
        domain, timeout_s = self._launch.context.domain, max(0.01, timeout_s)
        try:
            request(self._session, domain, self._name, verb, timeout_s=timeout_s)
            answer.put(None)
        except Exception as error:
            answer.put(error)


@dataclass(frozen=True)
class _Threads:
    """The threads of a process: whether a signal stops it, and which block `TRACEBACK_SIGNAL`."""

    stopped: bool
    blocking: frozenset[str]


def _threads_of(pid: int) -> _Threads:
    stopped, blocking = False, set()
    for thread in Path(f"/proc/{pid}/task").glob("*/status"):
        with suppress(OSError):  # it has just ended
            status = thread.read_text(encoding="utf-8", errors="replace")
            fields = dict(re.findall(r"^(\w+):\s+(\S+)", status, re.MULTILINE))
            stopped |= fields["State"] in "Tt"
            if int(fields["SigBlk"], 16) >> (TRACEBACK_SIGNAL - 1) & 1:
                blocking.add(thread.parent.name)
    return _Threads(stopped, frozenset(blocking))
