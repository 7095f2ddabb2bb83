"""Launches a supervisor's children, each in a process of its own or in the supervisor's process."""

import contextlib
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from pathlib import Path

from cairn.bus.bus import full_name
from cairn.bus.control import NoReplyError, request
from cairn.bus.discovery import QueryableWatcher
from cairn.bus.keys import control_key
from cairn.bus.zenoh_bus import ZenohBus
from cairn.deployment.model import ChildSpec
from cairn.deployment.plugins import load_plugin
from cairn.errors import CairnError
from cairn.placement.component_host import ComponentHost
from cairn.process_exit import ExitLog, ExitReport
from cairn.runtime.launch_request import LaunchRequest
from cairn.supervision.child import ChildHandle, ChildUnavailable, Verb
from cairn.supervision.supervisor import Supervisor
from cairn.supervision.zygote_client import ChildProcess, SpawnFailed, ZygoteClient, ZygoteLost

ENTRY = "cairn.placement.component_process:main"
"""What every component's process runs."""
TRACEBACK_SIGNAL = signal.SIGUSR1
"""A component's process that receives it logs the stacks of all of its threads."""
_TRACEBACK_LIMIT_S = 0.2
_KILL_LIMIT_S = 5.0
_EXIT_AFTER_ERROR_S = 0.2  # a component that refuses a request ends soon after
_LEAVING_LIMIT_S = 5.0  # between leaving the bus and the end of the process, in either order


def start_component(launch: LaunchRequest, bus: ZenohBus) -> ComponentHost:
    """Construct a component in this process, and have it answer requests.

    Raises `CairnError` if that fails.
    """
    host = ComponentHost(launch, bus)
    component = host.runtime.component
    if isinstance(component, Supervisor):
        component.adopt(launch.spec, ChildLauncher(host), host)
    host.start()
    return host


class ChildLauncher:
    """Launches the children of one supervisor that is hosted in this process."""

    def __init__(self, supervisor: ComponentHost) -> None:
        self._supervisor = supervisor
        self._zygote: ZygoteClient | None = None
        self._starting: ProcessHandle | None = None

    def launch(
        self,
        name: str,
        spec: ChildSpec,
        incarnation: int,
        previous_exit: str,
        on_exit: Callable[[], None],
    ) -> ChildHandle:
        """Start a child and wait until it accepts requests; see `Launcher`."""
        launch = LaunchRequest(
            name=name,
            spec=spec,
            parent=self._supervisor.launch.name,
            incarnation=incarnation,
            previous_exit=previous_exit,
            context=self._supervisor.launch.context,
        )
        if spec.placement == "in_process":
            return self._launch_in_process(launch, on_exit)
        return self._launch_process(launch, on_exit)

    def request_stop(self) -> None:
        """Have nothing started any more below, and cut short the start in progress; any thread."""
        for child in self._supervisor.children:
            child.request_stop()
        if self._starting is not None:
            self._starting.cancel_start()

    def _launch_in_process(self, launch: LaunchRequest, on_exit: Callable[[], None]) -> ChildHandle:
        host = start_component(launch, self._supervisor.bus)
        host.on_exit = on_exit
        running = (other for other in self._supervisor.children if not other.ended.is_set())
        self._supervisor.children = (*running, host)
        return ThreadHandle(host)

    def _launch_process(self, launch: LaunchRequest, on_exit: Callable[[], None]) -> ChildHandle:
        timeout_s = launch.spec.start_limit_s
        context, session = launch.context, self._supervisor.bus.session
        name = full_name(context.robot, launch.name)
        log = ExitLog(Path(context.log_folder) / f"{launch.name}.log")
        with QueryableWatcher(session, control_key(context.domain, name)) as watcher:
            if not watcher.wait_gone(min(timeout_s, _LEAVING_LIMIT_S)):
                raise ChildUnavailable(
                    f"another component on this bus answers as {name}; stop that one, or give this "
                    "robot another name (`--set robot=NAME`)"
                )
            process = self._spawn(launch, log.file, timeout_s)
            handle = ProcessHandle(process, log, name, self._supervisor, watcher.give_up)
            self._starting = handle
            process.on_exit(lambda _: watcher.give_up())
            process.on_exit(lambda _: on_exit())
            if watcher.wait(timeout_s):
                return handle
        report = handle.wait(0)
        if report is None:
            process.kill()
            handle.wait(_KILL_LIMIT_S)
            raise ChildUnavailable(
                f"it did not join the bus within {timeout_s:g} s; log: {log.file}"
            )
        if process.exited is not None and process.exited.signal is not None:
            raise ChildUnavailable(report.reason)
        raise CairnError(report.reason)

    def _spawn(self, launch: LaunchRequest, log: Path, timeout_s: float) -> ChildProcess:
        fresh = launch.spec.interpreter == "fresh"
        if self._zygote is None:
            socket_path = Path(launch.context.zygote)
            self._zygote = ZygoteClient(socket_path, self._log_lost_zygote)
            self._supervisor.resources.callback(self._zygote.close)
        try:
            return self._zygote.spawn(
                launch.name,
                ENTRY,
                launch.model_dump(mode="json"),
                log,
                fresh=fresh,
                needs=[] if fresh else [load_plugin(launch.spec.plugin).__module__],
                timeout_s=timeout_s,
            )
        except SpawnFailed as error:
            raise CairnError(_first_line(error, launch.name, log)) from error

    def _log_lost_zygote(self, lost: ZygoteLost) -> None:
        self._supervisor.runtime.log.critical("%s", lost)


class ProcessHandle:
    """A component in a process of its own; requests reach it over the bus."""

    def __init__(
        self,
        process: ChildProcess,
        log: ExitLog,
        full_name: str,
        supervisor: ComponentHost,
        cancel_launch: Callable[[], None],
    ) -> None:
        self._process = process
        self._log = log
        self._full_name = full_name
        self._supervisor = supervisor
        self._cancel_launch = cancel_launch
        self._starting = True
        self._start_answer: Future[None] = Future()  # to the last request of the start

    def request(self, verb: Verb, timeout_s: float) -> None:
        """Have it make a transition; see `ChildHandle`. `cancel_start` cuts a start short."""
        requested_at = time.monotonic()
        try:
            if self._starting and verb in ("configure", "activate"):
                self._request_start(verb, timeout_s)
                self._starting = verb == "configure"
            else:
                self._request(verb, timeout_s)
        except CairnError as error:
            if not isinstance(error, NoReplyError):  # the component's own error
                self.wait(_EXIT_AFTER_ERROR_S)
                raise
            # That it has left the bus is known before its exit.
            left_s = timeout_s - (time.monotonic() - requested_at)
            report = self.wait(max(0.0, min(left_s, _LEAVING_LIMIT_S)))
            if report is None and time.monotonic() - requested_at >= timeout_s:
                raise ChildUnavailable(f"no answer within {timeout_s:.1f} s") from None
            if report is None:
                raise ChildUnavailable(str(error)) from None
            if not report.normal or verb != "shutdown":
                raise ChildUnavailable(report.reason) from None

    def cancel_start(self) -> None:
        """Cut short the start in progress, and ask the process to end; from any thread."""
        if self._starting:
            self._cancel_launch()
            _resolve(self._start_answer, CairnError("a stop was requested"))
            self.terminate()

    def terminate(self) -> None:
        """Ask its process to end."""
        self._process.terminate()

    def kill(self) -> None:
        """Kill its process group, after its process has logged the stacks of its threads."""
        self._process.signal(TRACEBACK_SIGNAL)
        if self._process.wait(_TRACEBACK_LIMIT_S) is None:
            self._process.kill()

    def wait(self, timeout_s: float) -> ExitReport | None:
        """Wait for its end; see `ChildHandle`."""
        exited = self._process.wait(timeout_s)
        if exited is None:
            return None
        return self._log.report(exited.pid, exited.code, exited.manner)

    def _request(self, verb: Verb, timeout_s: float) -> None:
        domain = self._supervisor.launch.context.domain
        session = self._supervisor.bus.session
        request(session, domain, self._full_name, verb, timeout_s=max(0.01, timeout_s))

    def _request_start(self, verb: Verb, timeout_s: float) -> None:
        """Make the request on another thread, so that `cancel_start` can cut the wait short."""
        self._start_answer = answer = Future[None]()

        def call() -> None:
            try:
                self._request(verb, timeout_s)
                _resolve(answer, None)
            except Exception as error:
                _resolve(answer, error)

        threading.Thread(target=call, name=f"{verb} {self._full_name}", daemon=True).start()
        answer.result()  # `_request` keeps the time limit


class ThreadHandle:
    """A component on a thread of its supervisor's process; it cannot be killed."""

    def __init__(self, host: ComponentHost) -> None:
        self._host = host

    def request(self, verb: Verb, timeout_s: float) -> None:
        """Have it make a transition."""
        self._host.request(verb, timeout_s)

    def terminate(self) -> None:
        """Ask it to shut down."""
        self._host.send_request("shutdown")

    def kill(self) -> None:
        """Raise `CairnError`: a thread cannot be killed; its whole process has to end."""
        raise CairnError(
            f"{self._host.launch.name}: it runs in its supervisor's process and cannot be killed; "
            "give it `placement: process`, or restart the supervisor"
        )

    def wait(self, timeout_s: float) -> ExitReport | None:
        """Wait for its end, and leave the bus then."""
        if not self._host.ended.wait(timeout_s) or self._host.exit_report is None:
            return None
        self._host.close()
        return self._host.exit_report


def _first_line(error: SpawnFailed, name: str, log: Path) -> str:
    """Return the first line of an error; write all of it, perhaps a traceback, to the log."""
    text = str(error).removeprefix(f"{name} could not be started: ")
    with contextlib.suppress(OSError), log.open("a", encoding="utf-8") as file:
        file.write(f"{text}\n")
        return f"{text.partition(chr(10))[0]} (log {log})"
    return text


def _resolve(answer: "Future[None]", error: Exception | None) -> None:
    with contextlib.suppress(InvalidStateError):  # it has an answer already
        if error is None:
            answer.set_result(None)
        else:
            answer.set_exception(error)
