"""Launches a component in a process of its own, and makes requests to it over its channel."""

import os
import re
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from cairn.deployment.plugins import find_plugin
from cairn.errors import CairnError
from cairn.processes.child import ChildUnavailable
from cairn.processes.child_channel import (
    Heartbeat,
    InvalidPacket,
    SupervisorChannel,
    Verb,
    channel_pair,
)
from cairn.processes.zygote_client import ChildProcess, ZygoteClient
from cairn.runtime.launch_request import LaunchRequest
from cairn.system.process_exit import ExitLog, ExitReport

ENTRY = "cairn.processes.component_process:main"
"""What every component's process runs."""
TRACEBACK_SIGNAL = signal.SIGUSR1
"""A component's process that receives it logs the stacks of all of its threads."""
_TRACEBACK_POLL_S = 0.01
_TRACEBACK = b"(most recent call first)"
_PAGE_BYTES = os.sysconf("SC_PAGESIZE")
_KILL_LIMIT_S = 5.0
_EXIT_AFTER_ERROR_S = 0.2  # a component that refuses a request ends soon after
_LEAVING_LIMIT_S = 5.0  # between the end of its channel and that of the process
_POLL_S = 0.05
_LONGEST_STEP_S = 0.25
"""A wait is made in steps of `_POLL_S`; one that took longer, because this process could not run,
counts as at most so long."""


class ProcessHandle:
    """A component in a process of its own, which `launch` starts; see `ChildHandle`."""

    def __init__(self, launch: LaunchRequest) -> None:
        self._launch = launch
        self._log = ExitLog(Path(launch.context.log_folder) / f"{launch.name}.log")
        self._channel: SupervisorChannel  # set by `launch`
        self._reported = 0  # heartbeats that `heartbeat` has returned
        self._process: ChildProcess | None = None
        self._starting = True
        self._canceled = False

    def launch(self, zygote: ZygoteClient, on_exit: Callable[[], None]) -> None:
        """Start the process and wait until it accepts requests: for its first heartbeat.

        See `SupervisorHost.launch_child`.
        """
        launch, timeout_s = self._launch, self._launch.spec.start_limit_s
        fresh = launch.spec.interpreter == "fresh"
        own, passed = channel_pair()
        self._channel = SupervisorChannel(own)
        with passed:
            self._process = process = zygote.spawn(
                launch.name,
                ENTRY,
                launch.model_dump(mode="json"),
                self._log.file,
                fresh=fresh,
                needs=[] if fresh else [find_plugin(launch.spec.plugin).partition(":")[0]],
                channel=passed,
                timeout_s=timeout_s,
            )
        process.on_exit(lambda _: on_exit())
        try:
            if self._receive_until(lambda: self._channel.heartbeat is not None, timeout_s):
                return
        except ChildUnavailable:
            process.kill()
            process.wait(_KILL_LIMIT_S)
            raise
        exited = process.wait(_LEAVING_LIMIT_S if self._channel.closed else 0)
        if exited is None:
            process.kill()
            if process.wait(_KILL_LIMIT_S) is None:
                return  # with its time used up; `Child` must not start another one meanwhile
            raise ChildUnavailable(
                f"it did not accept requests within {timeout_s:g} s; log: {self._log.file}"
            )
        reason = self._log.report(exited.pid, exited.code).reason
        raise ChildUnavailable(reason) if exited.code < 0 else CairnError(reason)

    def request(self, verb: Verb, timeout_s: float) -> None:
        """Have it make a transition; see `ChildHandle`. `cancel_start` cuts a start short."""
        self._starting = verb in ("configure", "activate")
        sent = self._channel.request(verb)
        if sent:
            self._receive_until(lambda: self._channel.answer is not None, timeout_s)
        answer = self._channel.answer
        if answer is None:
            if self._starting and self._canceled:
                raise CairnError("a stop was requested")
            # A component that has ended by itself takes no requests any more. Then its end of the
            # channel closes, and then its process exits.
            leaving_s = 0.0 if sent else min(timeout_s, _LEAVING_LIMIT_S)
            report = self.wait(_LEAVING_LIMIT_S if self._channel.closed else leaving_s)
            if report is None:
                raise ChildUnavailable(f"no answer within {timeout_s:.1f} s{self._where()}")
            if not report.normal or verb != "shutdown":
                raise ChildUnavailable(report.reason)
        elif answer.error:  # the component's own
            self.wait(_EXIT_AFTER_ERROR_S)
            raise CairnError(answer.error)
        self._starting = verb == "configure"  # the next step follows

    def cancel_start(self) -> None:
        """Cut short the start in progress, and ask the process to end; from any thread."""
        if self._starting:
            self._canceled = True
            self.terminate()

    def memory(self) -> int:
        """Return the memory [bytes] that its process has in RAM; what it shares counts as well."""
        with suppress(OSError):  # it has just ended
            if self._process is not None:
                statm = Path(f"/proc/{self._process.pid}/statm").read_text(encoding="ascii")
                return int(statm.split()[1]) * _PAGE_BYTES
        return 0

    def expect_stop(self, limit_s: float) -> None:
        """Announce a stop, and cut short a start in progress; see `ChildHandle`."""
        if self._starting:
            self._canceled = True
        self._channel.announce_stop(limit_s)

    def heartbeat(self) -> Heartbeat | None:
        """Return the newest heartbeat since the last call; see `ChildHandle`."""
        self._receive(0.0)
        if self._channel.heartbeats == self._reported:
            return None
        self._reported = self._channel.heartbeats
        return self._channel.heartbeat

    def is_stopped(self) -> bool:
        """Return whether a signal such as SIGSTOP has stopped its process."""
        return self._process is not None and _threads_of(self._process.pid).stopped

    def terminate(self) -> None:
        """Ask its process to end."""
        if self._process is not None:
            self._process.terminate()

    def kill(self, log_limit_s: float) -> None:
        """Kill its process group, after its process has logged the stacks of its threads."""
        if self._process is not None:
            before, end = _threads_of(self._process.pid), self._log.end()
            deadline = time.monotonic()
            if before.handling:  # otherwise it has just started, or is about to end
                self._process.signal(TRACEBACK_SIGNAL)
                deadline += log_limit_s
            while self._process.wait(_TRACEBACK_POLL_S) is None and time.monotonic() < deadline:
                now = _threads_of(self._process.pid)
                if now.stopped:
                    break
                # The kernel blocks the signal in the thread that handles it.
                if now.blocking <= before.blocking and self._log.has_since(end, _TRACEBACK):
                    break
            self._process.kill()

    def wait(self, timeout_s: float) -> ExitReport | None:
        """Wait for its end; see `ChildHandle`."""
        exited = None if self._process is None else self._process.wait(timeout_s)
        if exited is None:
            return None
        self._channel.close()
        return self._log.report(exited.pid, exited.code)

    def _receive_until(self, arrived: Callable[[], bool], timeout_s: float) -> bool:
        """Receive messages until `arrived()`; return whether it has.

        It has not when the time is up, when a start is canceled, or when the process has ended.
        """
        while True:
            ended = self._process is None or self._process.exit.done()
            began = time.monotonic()
            self._receive(0.0 if ended else min(timeout_s, _POLL_S))
            if arrived():
                return True
            if ended or self._channel.closed or (self._starting and self._canceled):
                return False
            timeout_s -= min(time.monotonic() - began, _LONGEST_STEP_S)
            if timeout_s <= 0:
                return False

    def _receive(self, timeout_s: float) -> None:
        try:
            self._channel.receive(timeout_s)
        except InvalidPacket as error:
            raise ChildUnavailable(
                f"its channel to its supervisor is disturbed: {error}"
            ) from error

    def _where(self) -> str:
        heartbeat = self._channel.heartbeat
        return f"; it is in {heartbeat.handler}" if heartbeat and heartbeat.handler else ""


@dataclass(frozen=True)
class _Threads:
    """The threads of a process: whether a signal stops it, and which block `TRACEBACK_SIGNAL`.

    `handling` is whether the process logs its stacks on that signal.
    """

    stopped: bool
    blocking: frozenset[str]
    handling: bool


def _threads_of(pid: int) -> _Threads:
    stopped, blocking, handling = False, set(), False
    for thread in Path(f"/proc/{pid}/task").glob("*/status"):
        with suppress(OSError):  # it has just ended
            status = thread.read_text(encoding="utf-8", errors="replace")
            fields = dict(re.findall(r"^(\w+):\s+(\S+)", status, re.MULTILINE))
            stopped |= fields["State"] in "Tt"
            bit = TRACEBACK_SIGNAL - 1
            handling |= bool(int(fields["SigCgt"], 16) >> bit & 1)
            if int(fields["SigBlk"], 16) >> bit & 1:
                blocking.add(thread.parent.name)
    return _Threads(stopped, frozenset(blocking), handling)
