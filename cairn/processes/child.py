"""One child of a supervisor: how it starts and stops, when it hangs, when it is killed.

A child is judged only by the heartbeats that it sends its supervisor itself, and all that have
arrived are read before it is judged. Time in which the supervisor could not run does not count.
"""

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Literal, Protocol, TypeVar

from cairn.errors import CairnError
from cairn.processes.child_channel import Heartbeat, Verb
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.lifecycle import LifecycleState
from cairn.runtime.process_exit import ExitReport

if TYPE_CHECKING:
    from cairn.processes.remote_child import Machines

T = TypeVar("T")

State = Literal["unloaded", "starting", "active", "held", "stopping", "ended", "lost"]
StartResult = Literal[
    "active",  # or in the state in which it is held
    "canceled",  # a stop was requested; the child may still run
    "refused",  # the component reported that it cannot start; nothing of it runs
    "unavailable",  # it was killed or did not answer in time; nothing of it runs
    "unkillable",  # an earlier incarnation still runs, although it was killed
]

_TERMINATE_LIMIT_S = 2.0  # from terminating a child that has not stopped in time to killing it
_KILL_LIMIT_S = 5.0  # for the kernel to end a killed process and its group
_LOG_LIMIT_S = 5.0  # for a process to log its stacks before; only one that cannot log needs it all
_LEAST_KILL_LIMIT_S = 1.0  # it takes some milliseconds, on a busy computer more
_KEPT_S = 0.5
"""What a component that stops later keeps, whatever hangs before it: most take 0.05 s to stop."""
_MAX_RESERVE_S = 1.0
_RESERVE = 1 / 6
_SILENCE_S = 3.0
"""A process may be silent for so long beyond its limit for one handler: it may get no processor."""
_UNKILLABLE = "does not end even when killed"
_STARTING: tuple[tuple[LifecycleState, Verb], ...] = (
    (LifecycleState.UNCONFIGURED, "configure"),
    (LifecycleState.INACTIVE, "activate"),
)
_STOPPING: tuple[tuple[LifecycleState, Verb], ...] = (
    (LifecycleState.ACTIVE, "deactivate"),
    (LifecycleState.INACTIVE, "cleanup"),
)
_STARTING_CALLS = ("on_configure", "on_activate")
_STOPPING_CALLS = ("on_deactivate", "on_cleanup", "on_shutdown")


def without_reserve(limit_s: float) -> float:
    """Return the part [s] of a time limit for stopping something that it may use itself.

    The rest is for ending it by force, and for the end of the process that stops it.
    """
    return limit_s - min(_MAX_RESERVE_S, limit_s * _RESERVE)


def stop_share(left_s: float, components: int, remaining: int) -> float:
    """Return the time [s] that a child may take to stop if all that remain have `left_s` [s].

    It has `components` components, itself and those below it, of `remaining`. Each of the others
    keeps `_KEPT_S`, or its equal share of the time if that is less; the child has all the rest.
    """
    if left_s == math.inf:
        return left_s
    others = remaining - components
    kept_s = min(others * _KEPT_S, left_s * others / max(1, remaining))
    return max(0.0, left_s - kept_s)


def completed(call: Callable[[], T]) -> "Future[T]":
    """Make a call; return a future with what it has returned or raised."""
    result: Future[T] = Future()
    complete(result, call)
    return result


def complete(result: "Future[T]", call: Callable[[], T]) -> None:
    """Make a call, and put what it returns or raises into a future."""
    try:
        result.set_result(call())
    except BaseException as error:
        result.set_exception(error)


class ZygoteLost(CairnError):
    """The zygote has ended: all processes that it started are killed, none can be started."""


class ChildUnavailable(CairnError):
    """A child was killed or did not answer in time, and did not report itself why it fails."""


class ChildHandle(Protocol):
    """One running incarnation of a child, in a process of its own or not."""

    def request(self, verb: Verb, timeout_s: float) -> object:
        """Have the child make a transition of its life cycle.

        Raises `CairnError` with the component's own error if it refuses, `ChildUnavailable` with
        the cause if it has ended or does not answer within `timeout_s` seconds.
        """

    def heartbeat(self) -> Heartbeat | None:
        """Return the newest heartbeat since the last call, None if there is none; do not wait.

        Raises `ChildUnavailable` if the child has sent something else than messages.
        """

    def is_stopped(self) -> bool:
        """Return whether a signal such as SIGSTOP has stopped its process."""

    def memory(self) -> int:
        """Return how much memory its process uses now [bytes]; 0 if it has none of its own."""

    def expect_stop(self, limit_s: float) -> None:
        """Have the child start nothing any more, and stop all below it within `limit_s` [s].

        Cuts short a start in progress; it is not stopped yet. From any thread.
        """

    def terminate(self) -> None:
        """Ask the child to end, a process by SIGTERM; no effect if it has ended."""

    def kill(self, log_limit_s: float) -> None:
        """End the child by force; no effect if it has ended.

        A process has at most `log_limit_s` [s] before to log the stacks of its threads.
        """

    def wait(self, timeout_s: float) -> ExitReport | None:
        """Wait at most `timeout_s` seconds (0: do not wait) for its end; None if it still runs."""


class SupervisorHost(Protocol):
    """What runs a supervisor: launches its children, and has its loop and its time."""

    def in_background(self, call: Callable[[], T]) -> "Future[T]":
        """Make a call while the supervisor goes on, or at once where a call takes no time."""

    def launch_child(self, launch: LaunchRequest, on_exit: Callable[[], None]) -> ChildHandle:
        """Start a child; return when it accepts requests. For any thread.

        `on_exit` is called from any thread when the child has ended. Raises `CairnError` with the
        cause if the start fails, `ChildUnavailable` if the child is killed or the start exceeds
        its limit; then nothing of it runs. A child that exceeds the limit and does not end even
        when killed is returned. Raises `ZygoteLost`, which is not the child's failure.
        """

    def machines(self) -> "Machines":
        """Return what is known of the robot's other machines."""

    def cancel_starts(self) -> None:
        """Reject further starts and cancel those in progress; thread-safe."""

    def cancel_start(self, name: str) -> None:
        """Cancel the start of a child that is in progress."""

    def now(self) -> float:
        """Return the monotonic time [s]: the machine's, or virtual in lockstep."""

    def awake(self) -> float:
        """Return the monotonic time [s] in which this process could run."""

    def post(self, call: Callable[[], None]) -> None:
        """Have `call` made as a handler of the supervisor; from any thread."""

    def report_progress(self, step: str) -> None:
        """Report that a long call of the supervisor has reached its next step: it is not hung.

        No effect for calls in the background.
        """


@dataclass(frozen=True)
class ChildStatus:
    """The state of a child; `reason` is that of its last end or failure, "" if it had none.

    `held_in` is the state of its life cycle in which it is held, "" if it is not held. A child that
    is the fallback of another one, `fallback_of`, is loaded while that one cannot be used.
    """

    name: str
    state: State
    incarnation: int
    reason: str
    held_in: str = ""
    fallback_of: str = ""


class AnyChild(ABC):
    """What a child on this machine and one on another have in common: their state, and its log."""

    def __init__(
        self, name: str, parent: LaunchRequest, host: SupervisorHost, log: logging.Logger
    ) -> None:
        """`parent` is the supervisor's launch."""
        self.name = name
        self.spec = parent.spec.children[name]
        self.incarnation = 0
        self.reason = ""
        self.state: State = "unloaded"
        self.target = LifecycleState.ACTIVE
        """The state of its life cycle in which it should be; see `hold`."""
        self.stop_failure = ""
        """Why the last stop was not clean, "" if it was."""
        self._host = host
        self._log = log

    @property
    @abstractmethod
    def runs(self) -> bool:
        """Whether it has been started and has not ended, as far as its supervisor knows."""

    @property
    def components(self) -> int:
        """How many components stop with it, itself included; 0 if it does not run."""
        return self.spec.components if self.runs else 0

    def status(self) -> ChildStatus:
        """Return the state of the child, that of one on another machine as last reported."""
        held_in = self.target.value if self.state == "held" else ""
        return ChildStatus(self.name, self.state, self.incarnation, self.reason, held_in)

    def _log_event(self, level: int, event: str, reason: str = "") -> None:
        words = f"child {event}: {self.name}"
        self._log.log(level, "%s", f"{words}: {reason}" if reason else words)

    def _without_name(self, error: BaseException) -> str:
        return str(error).removeprefix(f"{self.name}: ")


class Child(AnyChild):
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
        super().__init__(name, parent, host, log)
        self.handle: ChildHandle | None = None
        self._parent = parent
        self._on_exit = on_exit
        self._heartbeat: Heartbeat | None = None  # the last one of this incarnation
        self._heartbeat_at = 0.0  # awake time [s] when it was read, or the child became active
        self._deviates = False
        self._unkillable: ChildHandle | None = None

    @property
    def runs(self) -> bool:
        """Whether it has been started and has not ended."""
        return self.handle is not None

    def expect_stop(self, limit_s: float) -> None:
        """Have the child start nothing any more; see `ChildHandle`. From any thread."""
        handle = self.handle
        if handle is not None:
            handle.expect_stop(limit_s)

    def start(self, canceled: Callable[[], bool]) -> StartResult:
        """Launch the child and bring it to its target; if that fails, `reason` has the cause.

        Raises `ZygoteLost`.
        """
        if self._unkillable is not None and self._unkillable.wait(0) is None:
            return "unkillable"
        deadline = self._host.awake() + self.spec.start_limit_s
        self.incarnation += 1
        self.state = "starting"
        self._log_event(logging.DEBUG, "starting")
        try:
            self._host.report_progress(f"launching {self.name}")
            self.handle = self._host.launch_child(self._launch_request(), self._on_exit)
            for verb in self._verbs_from(LifecycleState.UNCONFIGURED):
                if canceled():
                    return "canceled"
                left_s = deadline - self._host.awake()
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
            refused = not isinstance(error, ChildUnavailable)
            has_logged = refused and self.handle is not None  # that it fails, and why
            level = logging.WARNING if has_logged else logging.ERROR
            self._log_event(level, "start failed", self.reason)
            if self.handle is not None:
                self._force_end(self.handle, terminate=True)
            self.handle, self.state = None, "ended"
            return "refused" if refused else "unavailable"
        self._heartbeat, self._heartbeat_at, self._deviates = None, self._host.awake(), False
        self._note_target_reached()
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

    def check(self, canceled: Callable[[], bool]) -> ExitReport | None:
        """Kill the child if it hangs, and restore its state if it deviates from its target.

        It hangs if it is too long in one handler, or if its process is silent for too long. It is
        killed as well if it uses too much memory, has sent something invalid, or cannot be
        restored. Returns how it ended; None if it runs.
        """
        if self.handle is None or self.state not in ("active", "held"):
            return None
        try:
            heartbeat = self.handle.heartbeat()
        except ChildUnavailable as error:
            return self._kill("failed", f"{error}; killed")
        if heartbeat is not None:
            self._heartbeat, self._heartbeat_at = heartbeat, self._host.awake()
        hang = self._hang()
        if hang:
            return self._kill("hung", f"{hang}; killed")
        used_mib, most_mib = self.handle.memory() >> 20, self.spec.memory_max_mib
        if used_mib > most_mib:
            excess = f"it uses {used_mib} MiB of memory, more than memory_max_mib, {most_mib}"
            return self._kill("failed", f"{excess}; killed")
        return self._restore(canceled) if heartbeat is not None else None

    def hold(self, state: LifecycleState) -> None:
        """Bring the child to a state of its life cycle and keep it there; ACTIVE releases it.

        A restart by the supervisor's own policy does not change that. Raises `CairnError` with the
        component's own error if it refuses, or if it does not run.
        """
        if self.handle is None:
            raise CairnError(f"{self.name}: it does not run; load it first")
        self.target = state
        self._log_event(logging.INFO, "held by request", str(state))
        self._reach_target(self.handle)

    def _hang(self) -> str:
        """Return for how long and where the child hangs, "" if it does not."""
        assert self.handle is not None
        heartbeat, silent_s = self._heartbeat, self._host.awake() - self._heartbeat_at
        handler = heartbeat.handler if heartbeat is not None else ""
        if heartbeat is not None and handler and heartbeat.handler_s > self._limit_s(handler):
            return f"hung for {heartbeat.handler_s + silent_s:.1f} s in {handler}"
        ending = heartbeat is not None and heartbeat.state is LifecycleState.FINALIZED
        limit_s = self.spec.stop_limit_s if ending else self.spec.hang_timeout_s
        if silent_s <= limit_s + _SILENCE_S:
            return ""
        if self.handle.is_stopped():
            where = "a process that was stopped by a signal such as SIGSTOP"
        elif ending:
            where = "the end of its process"
        else:
            where = f"{handler or 'a call'} that lets no other thread of its process run"
        return f"hung for {silent_s:.1f} s in {where}"

    def _limit_s(self, handler: str) -> float:
        """Return the time limit [s] of a handler, or of a transition that the child makes."""
        if handler in _STARTING_CALLS:
            return max(self.spec.start_limit_s, self.spec.handler_limit_s)
        if handler in _STOPPING_CALLS:
            return max(self.spec.stop_limit_s, self.spec.handler_limit_s)
        return self.spec.handler_limit_s

    def _restore(self, canceled: Callable[[], bool]) -> ExitReport | None:
        """Bring the child back to its target if two heartbeats in a row deviate from it.

        One may: a component that recovers from an error is unconfigured for a moment. The call that
        it makes meanwhile has a time limit of its own.
        """
        assert self.handle is not None
        assert self._heartbeat is not None
        state = self._heartbeat.state
        deviated = self._deviates
        self._deviates = (
            state not in (self.target, LifecycleState.FINALIZED) and not self._heartbeat.handler
        )
        if not (self._deviates and deviated):
            return None
        self._deviates = False
        deviation = f"{state} instead of {self.target}"
        self._log_event(logging.WARNING, "deviates", f"{deviation}; restoring it")
        try:
            self._reach_target(self.handle)
        except CairnError as error:
            # It may have recovered by itself, or stop, or have ended.
            if self._state_of(self.handle) is self.target or canceled():
                return None
            cause = f"{deviation}, and cannot be restored: {self._without_name(error)}"
            return self.poll() or self._kill("failed", f"{cause}; killed")
        return None

    def _kill(self, event: str, reason: str) -> ExitReport:
        assert self.handle is not None
        self.reason = reason
        self._force_end(self.handle)
        report = ExitReport(False, self.reason)
        self._note_exit(logging.ERROR, event, report)
        return report

    def _reach_target(self, handle: ChildHandle) -> None:
        """Make the transitions from the child's state to its target; raise the first error."""
        for verb in self._verbs_from(self._state_of(handle)):
            limit_s = self._limit_s(f"on_{verb}")
            self._host.report_progress(f"bringing {self.name} to {self.target}: {verb}")
            handle.request(verb, limit_s)
        self._note_target_reached()

    def _state_of(self, handle: ChildHandle) -> LifecycleState:
        """Return the state that the child has reported last; its target if it has not yet."""
        heartbeat = handle.heartbeat()
        if heartbeat is not None:
            self._heartbeat, self._heartbeat_at = heartbeat, self._host.awake()
        return self.target if self._heartbeat is None else self._heartbeat.state

    def _verbs_from(self, state: LifecycleState) -> list[Verb]:
        """Return the transitions that lead from a state to the target."""
        order = (LifecycleState.UNCONFIGURED, LifecycleState.INACTIVE, LifecycleState.ACTIVE)
        if state not in order:  # it has ended
            return []
        at, to = order.index(state), order.index(self.target)
        upwards = [verb for start, verb in _STARTING if at <= order.index(start) < to]
        return upwards or [verb for start, verb in _STOPPING if to < order.index(start) <= at]

    def _note_target_reached(self) -> None:
        self.state = "active" if self.target is LifecycleState.ACTIVE else "held"
        self._log_event(logging.INFO, self.target.value)

    def stop(self, limit_s: float = math.inf) -> None:
        """Deactivate and shut down the child and all below it; kill it if that fails.

        All of this takes at most `limit_s` [s], even if the deployment allows the child more.
        """
        self.stop_failure = ""
        handle = self.handle
        if handle is None:
            return
        latest = self._host.awake() + limit_s
        report = handle.wait(0)
        if report is None:
            answer_limit_s = min(self.spec.stop_limit_s, without_reserve(limit_s))
            deadline = self._host.awake() + answer_limit_s
            handle.expect_stop(answer_limit_s)
            verbs: tuple[Verb, ...] = ("deactivate", "shutdown")
            for verb in verbs if self.state == "active" else verbs[1:]:
                # Otherwise the step before has ended the child, or has used up the time.
                if handle.wait(0) is None and self._host.awake() < deadline:
                    self._stop_step(handle, verb, deadline)
            report = handle.wait(max(0.0, deadline - self._host.awake()))
        if report is None:
            self.reason = self.stop_failure
            report = self._force_end(handle, latest - self._host.awake())
        if report.normal:
            self._note_exit(logging.INFO, "stopped", report)
        else:
            self.stop_failure = self.stop_failure or report.reason  # the first is the cause
            self._note_exit(logging.WARNING, "stopped", report)

    def _launch_request(self) -> LaunchRequest:
        return LaunchRequest(
            name=self.name,
            spec=self.spec,
            parent=self._parent.context.parents.get(self.name, self._parent.name),
            # A restarted supervisor counts from zero, but the child has run before.
            incarnation=self.incarnation + self._parent.restarts,
            previous_exit=self.reason,
            context=self._parent.context,
            topic_keys=self._parent.keys_for(self.name),
        )

    def _stop_step(self, handle: ChildHandle, verb: Verb, deadline: float) -> None:
        self.state = "stopping"
        self._log_event(logging.DEBUG, "stopping", verb)
        self._host.report_progress(f"stopping {self.name}: {verb}")
        try:
            handle.request(verb, deadline - self._host.awake())
        except ChildUnavailable as error:
            if handle.wait(0) is None:  # otherwise its exit report has the reason
                self._note_stop_failure(f"{verb}: {error}")
        except Exception as error:  # the other children must be stopped all the same
            self._note_stop_failure(self._without_name(error))

    def _force_end(
        self, handle: ChildHandle, limit_s: float = math.inf, *, terminate: bool = False
    ) -> ExitReport:
        """Kill the child within `limit_s` [s]; before, with `terminate`, ask it to end.

        If it does not end, that is added to `reason`, the cause.
        """
        log_limit_s = max(0.0, min(_LOG_LIMIT_S, limit_s / 2))
        kill_limit_s = min(_KILL_LIMIT_S, max(_LEAST_KILL_LIMIT_S, limit_s - log_limit_s))
        steps: list[tuple[Callable[[], None], float]] = [
            (partial(handle.kill, log_limit_s), kill_limit_s)
        ]
        if terminate:
            steps.insert(0, (handle.terminate, _TERMINATE_LIMIT_S))
        for step, step_limit_s in steps:
            self._host.report_progress(f"ending {self.name} by force")
            try:
                step()
            except Exception as error:  # the next step must be taken all the same
                self._note_stop_failure(self._without_name(error))
                step_limit_s = 0.0
            report = handle.wait(step_limit_s)
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
