"""One child of a supervisor: how it is started, stopped, and terminated or killed if need be."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

from cairn.deployment.model import ChildSpec
from cairn.errors import CairnError
from cairn.process_exit import ExitReport

Verb = Literal["configure", "activate", "deactivate", "shutdown"]
State = Literal["unloaded", "starting", "active", "stopping", "ended"]
EventKind = Literal[
    "starting",
    "active",
    "start_failed",
    "stopping",
    "stop_failed",  # a step of stopping failed; the next, harder step follows
    "stopped",
    "ended",  # normally, of its own accord
    "failed",  # of its own accord, or killed from outside
    "hung",  # killed because it did not return from a handler
    "restarting",  # the start follows
    "given_up",  # the supervisor itself fails
]

_TERMINATE_LIMIT_S = 2.0  # from terminating a child that has not stopped in time to killing it
_KILL_LIMIT_S = 5.0  # for the kernel to end a killed process and its group


class LauncherLost(CairnError):  # noqa: N818 - an event as much as an error
    """All that a launcher has started has ended, and it cannot start anything any more."""


class ChildUnavailable(CairnError):  # noqa: N818 - the state of the child
    """A child was killed or did not answer in time, and did not report itself why it fails."""


class StopRequested(Exception):  # noqa: N818 - leaves a start half-way
    """A stop was requested while a child was being started; the child still runs."""


class ChildHandle(Protocol):
    """One running incarnation of a child, in a process of its own or not."""

    def request(self, verb: Verb, timeout_s: float) -> None:
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


class Launcher(Protocol):
    """Starts the children of one supervisor."""

    def launch(
        self,
        name: str,
        spec: ChildSpec,
        incarnation: int,
        previous_exit: str,
        on_exit: Callable[[], None],
    ) -> ChildHandle:
        """Start a child for the `incarnation`th time (from 1); return when it accepts requests.

        `previous_exit` is the reason for the end of the incarnation before, "" for the first.
        `on_exit` is called from any thread when the child has ended. Raises `CairnError` with the
        cause if the start fails, `ChildUnavailable` if the child is killed or the start exceeds
        `spec.start_limit_s`; then nothing of it runs. Raises `LauncherLost` if the failure is not
        the child's.
        """
        ...

    def request_stop(self) -> None:
        """Reject further starts and cancel the start in progress; thread-safe."""
        ...


@dataclass(frozen=True)
class ChildEvent:
    """Something that happened to a child; `child` is the supervisor itself for `given_up`."""

    child: str
    kind: EventKind
    reason: str = ""
    normal: bool = True  # False if the child ended by a failure or by force


@dataclass(frozen=True)
class ChildStatus:
    """The state of a child; `reason` is that of its last end or failure, "" if it had none."""

    name: str
    state: State
    incarnation: int
    reason: str


@dataclass(frozen=True)
class StartFailure:
    """Why a child did not become active; `refused` if the component reported the reason itself."""

    reason: str
    refused: bool


class Child:
    """One child of a supervisor, through all of its incarnations."""

    def __init__(
        self,
        name: str,
        spec: ChildSpec,
        launcher: Launcher,
        *,
        observe: Callable[[ChildEvent], None],
        report_progress: Callable[[str], None],
        on_exit: Callable[[], None],
        now: Callable[[], float],
    ) -> None:
        self.name = name
        self.spec = spec
        self.handle: ChildHandle | None = None
        self.incarnation = 0
        self.reason = ""
        self.state: State = "unloaded"
        self._unkillable: ChildHandle | None = None
        self._launcher = launcher
        self._observe = observe
        self._report_progress = report_progress
        self._on_exit = on_exit
        self._now = now

    @property
    def unkillable(self) -> bool:
        """Whether an earlier incarnation still runs, although it was killed."""
        return self._unkillable is not None and self._unkillable.wait(0) is None

    def status(self) -> ChildStatus:
        """Return the state of the child."""
        return ChildStatus(self.name, self.state, self.incarnation, self.reason)

    def start(self, stop_requested: Callable[[], bool]) -> StartFailure | None:
        """Launch, configure and activate the child; return why that failed, None if it did not.

        After a failure nothing of the child runs. Raises `StopRequested`, `LauncherLost`.
        """
        limit_s = self.spec.start_limit_s
        deadline = self._now() + limit_s
        self.incarnation += 1
        self.state = "starting"
        self._emit("starting")
        try:
            self._report_progress(f"launching {self.name}")
            self.handle = self._launcher.launch(
                self.name, self.spec, self.incarnation, self.reason, self._on_exit
            )
            verbs: tuple[Verb, ...] = ("configure", "activate")
            for verb in verbs:
                if stop_requested():
                    raise StopRequested
                left_s = deadline - self._now()
                if left_s <= 0:
                    raise ChildUnavailable(f"it was not active after {limit_s:g} s")
                self._report_progress(f"starting {self.name}: {verb}")
                self.handle.request(verb, left_s)
        except LauncherLost:
            self.state = "ended"
            raise
        except CairnError as error:
            if stop_requested():  # the request has cut the step short
                raise StopRequested from error
            self.reason = self._without_name(error)
            self._emit("start_failed", self.reason)
            if self.handle is not None:
                self._force_end(self.handle, self.handle.terminate, self.handle.kill)
            self.handle, self.state = None, "ended"
            return StartFailure(self.reason, refused=not isinstance(error, ChildUnavailable))
        self.state = "active"
        self._emit("active")
        return None

    def exit_report(self) -> ExitReport | None:
        """Return how the child ended, None if it runs or there is none."""
        return None if self.handle is None else self.handle.wait(0)

    def stop(self) -> None:
        """Deactivate and shut down the child; terminate and kill it if that fails."""
        handle = self.handle
        if handle is None:
            return
        report = handle.wait(0)
        if report is None:
            deadline = self._now() + self.spec.stop_limit_s
            verbs: tuple[Verb, ...] = ("deactivate", "shutdown")
            for verb in verbs if self.state == "active" else verbs[1:]:
                # Otherwise the step before has ended the child, or has used up the time.
                if handle.wait(0) is None and self._now() < deadline:
                    self._stop_step(handle, verb, deadline)
            report = handle.wait(max(0.0, deadline - self._now()))
        if report is None:
            report = self._force_end(handle, handle.terminate, handle.kill)
        self.note_exit("stopped", report)

    def kill(self) -> None:
        """Kill the child at once; no effect if there is none."""
        if self.handle is not None:
            self._force_end(self.handle, self.handle.kill)
        self.handle, self.state = None, "ended"

    def note_exit(self, kind: EventKind, report: ExitReport) -> None:
        """Record that the child ended."""
        self.handle, self.state, self.reason = None, "ended", report.reason
        self._emit(kind, report.reason, normal=report.normal)

    def _emit(self, kind: EventKind, reason: str = "", *, normal: bool = True) -> None:
        self._observe(ChildEvent(self.name, kind, reason, normal))

    def _stop_step(self, handle: ChildHandle, verb: Verb, deadline: float) -> None:
        self.state = "stopping"
        self._emit("stopping", verb)
        try:
            self._report_progress(f"stopping {self.name}: {verb}")
            handle.request(verb, deadline - self._now())
        except ChildUnavailable as error:
            if handle.wait(0) is None:  # otherwise its exit report has the reason
                self._emit("stop_failed", f"{verb}: {error}")
        except Exception as error:  # the other children must be stopped all the same
            self._emit("stop_failed", self._without_name(error))

    def _without_name(self, error: Exception) -> str:
        return str(error).removeprefix(f"{self.name}: ")

    def _force_end(self, handle: ChildHandle, *steps: Callable[[], None]) -> ExitReport:
        """Take steps of growing force, the last one killing, until the child has ended."""
        for step in steps:
            limit_s = _KILL_LIMIT_S if step is steps[-1] else _TERMINATE_LIMIT_S
            self._report_progress(f"ending {self.name} by force")
            try:
                step()
            except Exception as error:  # the next step must be taken all the same
                self._emit("stop_failed", str(error))
                limit_s = 0.0
            report = handle.wait(limit_s)
            if report is not None:
                return report
        self._unkillable = handle
        reason = "did not end even when killed"
        self._emit("stop_failed", reason)
        return ExitReport(False, reason)
