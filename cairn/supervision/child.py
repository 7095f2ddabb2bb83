"""One child of a supervisor: how it starts and stops, when it hangs, when it is killed."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

from cairn.errors import CairnError
from cairn.process_exit import ExitReport
from cairn.runtime.launch_request import LaunchRequest
from cairn.schemas.cairn_msgs import ComponentStatus

Verb = Literal["configure", "activate", "deactivate", "shutdown"]
State = Literal["unloaded", "starting", "active", "stopping", "ended"]
StartResult = Literal[
    "active",
    "canceled",  # a stop was requested; the child may still run
    "refused",  # the component reported that it cannot start; nothing of it runs
    "unavailable",  # it was killed or did not answer in time; nothing of it runs
    "unkillable",  # an earlier incarnation still runs, although it was killed
]

_TERMINATE_LIMIT_S = 2.0  # from terminating a child that has not stopped in time to killing it
_KILL_LIMIT_S = 5.0  # for the kernel to end a killed process and its group
_SILENCE_S = 3.0
"""A process may be silent for so long beyond its limit for one handler: it may get no processor."""
_UNKILLABLE = "does not end even when killed"


class ZygoteLost(CairnError):  # noqa: N818 - an event as much as an error
    """The zygote has ended: all processes that it started are killed, none can be started."""


class ChildUnavailable(CairnError):  # noqa: N818 - the state of the child
    """A child was killed or did not answer in time, and did not report itself why it fails."""


class ChildHandle(Protocol):
    """One running incarnation of a child, in a process of its own or not."""

    def request(self, verb: Verb, timeout_s: float) -> object:
        """Have the child make a transition of its life cycle.

        Raises `CairnError` with the component's own error if it refuses, `ChildUnavailable` with
        the cause if it has ended or does not answer within `timeout_s` seconds.
        """
        ...

    def terminate(self) -> None:
        """Ask the child to end, a process by SIGTERM; no effect if it has ended."""
        ...

    def kill(self) -> None:
        """End the child by force; no effect if it has ended."""
        ...

    def wait(self, timeout_s: float) -> ExitReport | None:
        """Wait at most `timeout_s` seconds (0: do not wait) for its end; None if it still runs."""
        ...


class SupervisorHost(Protocol):
    """What runs a supervisor: launches its children, and has its loop and its time."""

    def launch_child(self, launch: LaunchRequest, on_exit: Callable[[], None]) -> ChildHandle:
        """Start a child; return when it accepts requests.

        `on_exit` is called from any thread when the child has ended. Raises `CairnError` with the
        cause if the start fails, `ChildUnavailable` if the child is killed or the start exceeds
        its limit; then nothing of it runs. A child that exceeds the limit and does not end even
        when killed is returned. Raises `ZygoteLost`, which is not the child's failure.
        """
        ...

    def cancel_starts(self) -> None:
        """Reject further starts and cancel the start in progress; thread-safe."""
        ...

    def now(self) -> float:
        """Return the monotonic time [s]: the machine's, or virtual in lockstep."""
        ...

    def awake(self) -> float:
        """Return the monotonic time [s] without pauses of the machine."""
        ...

    def post(self, call: Callable[[], None]) -> None:
        """Have `call` made as a handler of the supervisor; from any thread."""
        ...

    def report_progress(self, step: str) -> None:
        """Report that a long call of the supervisor has reached its next step: it is not hung."""
        ...


@dataclass(frozen=True)
class ChildStatus:
    """The state of a child; `reason` is that of its last end or failure, "" if it had none."""

    name: str
    state: State
    incarnation: int
    reason: str


class Child:
    """One child of a supervisor, through all of its incarnations."""

    def __init__(
        self,
        name: str,
        parent: LaunchRequest,
        host: SupervisorHost,
        log: logging.Logger,
        on_exit: Callable[[], None],
    ) -> None:
        """`parent` is the supervisor's launch; for `on_exit` see `SupervisorHost.launch_child`."""
        self.name = name
        self.spec = parent.spec.children[name]
        self.handle: ChildHandle | None = None
        self.incarnation = 0
        self.reason = ""
        self.state: State = "unloaded"
        self.stop_failure = ""
        """Why the last stop was not clean, "" if it was."""
        self._parent = parent
        self._host = host
        self._log = log
        self._on_exit = on_exit
        self._heartbeat: tuple[ComponentStatus, float] | None = None  # the last, and when it came
        self._unkillable: ChildHandle | None = None

    def status(self) -> ChildStatus:
        """Return the state of the child."""
        return ChildStatus(self.name, self.state, self.incarnation, self.reason)

    def start(self, canceled: Callable[[], bool]) -> StartResult:
        """Launch, configure and activate the child; if that fails, `reason` has the cause.

        Raises `ZygoteLost`.
        """
        if self._unkillable is not None and self._unkillable.wait(0) is None:
            return "unkillable"
        deadline = self._host.now() + self.spec.start_limit_s
        self.incarnation += 1
        self.state = "starting"
        self._log_event(logging.DEBUG, "starting")
        try:
            self._host.report_progress(f"launching {self.name}")
            self.handle = self._host.launch_child(self._launch_request(), self._on_exit)
            verbs: tuple[Verb, ...] = ("configure", "activate")
            for verb in verbs:
                if canceled():
                    return "canceled"
                left_s = deadline - self._host.now()
                if left_s <= 0:
                    raise ChildUnavailable(f"it was not active after {self.spec.start_limit_s:g} s")
                self._host.report_progress(f"starting {self.name}: {verb}")
                self.handle.request(verb, left_s)
        except ZygoteLost:
            self.state = "ended"
            raise
        except CairnError as error:
            if canceled():  # which has cut the step short
                return "canceled"
            self.reason = self._without_name(error)
            self._log_event(logging.ERROR, "start failed", self.reason)
            if self.handle is not None:
                self._force_end(self.handle, self.handle.terminate, self.handle.kill)
            self.handle, self.state = None, "ended"
            return "unavailable" if isinstance(error, ChildUnavailable) else "refused"
        self.state = "active"
        self._log_event(logging.INFO, "active")
        return "active"

    def poll(self) -> ExitReport | None:
        """Return how the child ended; None if it runs, or there is none."""
        report = None if self.handle is None else self.handle.wait(0)
        if report is not None:
            if report.normal:
                self._note_exit(logging.INFO, "ended", report)
            else:
                self._note_exit(logging.WARNING, "failed", report)
        return report

    def receive(self, status: ComponentStatus) -> None:
        """Keep a heartbeat of the child."""
        self._heartbeat = (status, self._host.awake())

    def kill_if_hung(self) -> ExitReport | None:
        """Kill the child if it hangs: too long in one handler, or silent too long.

        Both times exclude pauses of the machine. Returns None if it does not hang, or has sent no
        heartbeat yet.
        """
        if self.state != "active" or self.handle is None or self._heartbeat is None:
            return None
        status, received_at = self._heartbeat
        silent_s = self._host.awake() - received_at
        if status.state != "active" or status.restarts + 1 != self.incarnation:
            return None  # from before the last restart
        if status.handler and status.handler_s > self.spec.handler_limit_s:
            where, hung_s = status.handler, status.handler_s + silent_s
        elif silent_s > self.spec.hang_timeout_s + _SILENCE_S and self.spec.placement == "process":
            where, hung_s = _where_silent(status), silent_s
        else:
            return None
        self.reason = f"hung for {hung_s:.1f} s in {where}; killed"
        self._force_end(self.handle, self.handle.kill)
        report = ExitReport(False, self.reason)
        self._note_exit(logging.ERROR, "hung", report)
        return report

    def stop(self) -> None:
        """Deactivate and shut down the child; terminate and kill it if that fails."""
        self.stop_failure = ""
        handle = self.handle
        if handle is None:
            return
        report = handle.wait(0)
        if report is None:
            deadline = self._host.now() + self.spec.stop_limit_s
            verbs: tuple[Verb, ...] = ("deactivate", "shutdown")
            for verb in verbs if self.state == "active" else verbs[1:]:
                # Otherwise the step before has ended the child, or has used up the time.
                if handle.wait(0) is None and self._host.now() < deadline:
                    self._stop_step(handle, verb, deadline)
            report = handle.wait(max(0.0, deadline - self._host.now()))
        if report is None:
            self.reason = self.stop_failure
            report = self._force_end(handle, handle.terminate, handle.kill)
        if report.normal:
            self._note_exit(logging.INFO, "stopped", report)
        else:
            self.stop_failure = self.stop_failure or report.reason  # the first is the cause
            self._note_exit(logging.WARNING, "stopped", report)

    def _launch_request(self) -> LaunchRequest:
        return LaunchRequest(
            name=self.name,
            spec=self.spec,
            parent=self._parent.name,
            incarnation=self.incarnation,
            previous_exit=self.reason,
            context=self._parent.context,
        )

    def _stop_step(self, handle: ChildHandle, verb: Verb, deadline: float) -> None:
        self.state = "stopping"
        self._log_event(logging.DEBUG, "stopping", verb)
        self._host.report_progress(f"stopping {self.name}: {verb}")
        try:
            handle.request(verb, deadline - self._host.now())
        except ChildUnavailable as error:
            if handle.wait(0) is None:  # otherwise its exit report has the reason
                self._note_stop_failure(f"{verb}: {error}")
        except Exception as error:  # the other children must be stopped all the same
            self._note_stop_failure(self._without_name(error))

    def _force_end(self, handle: ChildHandle, *steps: Callable[[], None]) -> ExitReport:
        """Take steps of growing force, the last one killing, until the child has ended.

        If it does not end, that is added to `reason`, the cause.
        """
        for step in steps:
            limit_s = _KILL_LIMIT_S if step is steps[-1] else _TERMINATE_LIMIT_S
            self._host.report_progress(f"ending {self.name} by force")
            try:
                step()
            except Exception as error:  # the next step must be taken all the same
                self._note_stop_failure(self._without_name(error))
                limit_s = 0.0
            report = handle.wait(limit_s)
            if report is not None:
                return report
        self._unkillable = handle
        self._note_stop_failure(_UNKILLABLE)
        self.reason = f"{self.reason}; {_UNKILLABLE}" if self.reason else _UNKILLABLE
        return ExitReport(False, self.reason)

    def _note_exit(self, level: int, event: str, report: ExitReport) -> None:
        self.handle, self.state, self.reason = None, "ended", report.reason
        self._log_event(level, event, report.reason)

    def _note_stop_failure(self, reason: str) -> None:
        self.stop_failure = self.stop_failure or reason
        self._log_event(logging.WARNING, "stop failed", reason)

    def _log_event(self, level: int, event: str, reason: str = "") -> None:
        words = f"child {event}: {self.name}"
        self._log.log(level, "%s", f"{words}: {reason}" if reason else words)

    def _without_name(self, error: Exception) -> str:
        return str(error).removeprefix(f"{self.name}: ")


def _where_silent(status: ComponentStatus) -> str:
    """Return where a component hangs whose process does not even send heartbeats."""
    import psutil  # imported here to keep `from cairn import Supervisor` light

    try:
        if psutil.Process(status.pid).status() == psutil.STATUS_STOPPED:
            return "a process that was stopped by a signal such as SIGSTOP"
    except psutil.Error:  # another user's, or just gone
        pass
    return f"{status.handler or 'a call'} that lets no other thread of its process run"
