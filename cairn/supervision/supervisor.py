"""Supervisors: components that keep the components below them running.

When a child ends, the zygote reports its exit to the launcher, which calls `on_exit`; the
supervisor then reconciles: `RestartPolicy` decides which children stop and start, `Child` starts
them through the launcher.

Log lines begin with an event in stable words, then the child's name, then the reason:

| event | level | meaning |
|---|---|---|
| `child active: NAME` | INFO | it has started |
| `child stopped: NAME: REASON` | INFO, or WARNING after a failure | its supervisor has stopped it |
| `child ended: NAME: REASON` | INFO | it has finished of its own accord |
| `child failed: NAME: REASON` | WARNING | it has failed, or was killed from outside |
| `child hung: NAME: REASON` | ERROR | its supervisor has killed it as hung |
| `child start failed: NAME: REASON` | ERROR | it did not become active |
| `child stop failed: NAME: REASON` | WARNING | a step of stopping failed; a harder one follows |
| `restarting child NAME: REASON (2 of 3 restarts in 10 s)` | INFO | follows a failure or an end |

Level DEBUG adds `child starting` and `child stopping`.
"""

import logging
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, ClassVar, Literal, NoReturn, Protocol

from cairn.bus.qos import LATCHED
from cairn.deployment.model import ChildSpec, Supervision
from cairn.errors import CairnError
from cairn.process_exit import ExitReport
from cairn.runtime.component import Component
from cairn.runtime.ports import In, every, on
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.supervision.child import (
    Child,
    ChildEvent,
    ChildStatus,
    EventKind,
    Launcher,
    StartFailure,
    StopRequested,
)
from cairn.supervision.hang_detection import HangDetector
from cairn.supervision.restart_policy import Decision, RestartPolicy, UnknownChild

_LOG_LEVELS: dict[EventKind, int] = {
    "active": logging.INFO,
    "stopped": logging.INFO,
    "ended": logging.INFO,
    "failed": logging.WARNING,
    "stop_failed": logging.WARNING,
    "start_failed": logging.ERROR,
    "hung": logging.ERROR,
}


class Escalate(CairnError):  # noqa: N818 - what the owner has to do
    """A supervisor has given up and stopped all children: it must fail itself."""


class StartFailed(CairnError):  # noqa: N818 - reads as what happened
    """A child loaded on request did not become active and is unloaded again."""


class SupervisorHost(Protocol):
    """What runs a supervisor: its loop and its time."""

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


class Supervisor(Component):
    """Starts the components below it in its deployment, and restarts them as `supervision` says.

    Children are started in order when it is activated, each when the one before is active, and
    stopped in reverse order; those with `load: on_request` are loaded by
    `self.children.load(name)`. When too many restarts fall in the window, the supervisor itself
    fails, and its own supervisor decides what follows.
    """

    is_supervisor: ClassVar[bool] = True
    clock_source: ClassVar[Literal["deployment", "system"]] = "system"

    component_status: In[ComponentStatus] = In(qos=LATCHED.with_depth(500), optional=True)

    children: "ChildGroup"

    def adopt(self, spec: ChildSpec, launcher: Launcher, host: SupervisorHost) -> None:
        """Take over the children of the deployment; called by the placement before `configure`."""
        self._host = host
        self._hangs = HangDetector(spec.children, host.awake)
        self._failed_stops: dict[str, str] = {}
        self.children = ChildGroup(
            self.name,
            spec.children,
            spec.supervision,
            launcher,
            observe=self._observe,
            report_progress=host.report_progress,
            on_exit=partial(host.post, self._reconcile),
            now=host.now,
        )

    def on_activate(self) -> None:
        """Start the children."""
        self.children.start_all()
        self._finish_if_done()

    def on_deactivate(self) -> None:
        """Stop the children; raises `CairnError` naming those that failed while stopping."""
        self._failed_stops.clear()
        self.children.stop_all()
        self._raise_failed_stops()

    def on_shutdown(self) -> None:
        """Stop the children that are left."""
        self.children.stop_all()

    def on_error(self, error: Exception) -> bool:  # noqa: ARG002
        """Stop all children; do not recover."""
        self.children.stop_all()
        return False

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Load, unload or restart the child `name`; return its state."""
        if verb not in ("load", "unload", "restart") or set(arguments) != {"name"}:
            return super().on_request(verb, arguments)
        name = str(arguments["name"])
        try:
            getattr(self.children, verb)(name)
        except Escalate as error:
            # The request is answered, but the failure is the supervisor's own.
            self._host.post(partial(_raise, error))
            raise CairnError(f"{self.name}: {error}") from error
        return {status.name: status.state for status in self.children.status()}[name]

    @on("component_status")
    def on_heartbeat(self, status: ComponentStatus) -> None:
        """Keep the heartbeat of a child."""
        self._hangs.receive(status)

    @every(hz=2)
    def check_children(self) -> None:
        """Kill children that hang, and restart what has ended."""
        for child in self.children.status():
            hang = self._hangs.check(child)
            if hang is not None:
                self.children.kill_hung(child.name, child.incarnation, hang.where, hang.seconds)
        self._reconcile()

    def _reconcile(self) -> None:
        self._failed_stops.clear()
        self.children.reconcile()
        self._finish_if_done()

    def _finish_if_done(self) -> None:
        report = self.children.finished
        if report is not None:
            self._raise_failed_stops()
            self.finish(report.reason, success=report.success)

    def _raise_failed_stops(self) -> None:
        if self._failed_stops:  # perhaps a report was not written: that is not a success
            reasons = "; ".join(f"{name}: {why}" for name, why in self._failed_stops.items())
            raise CairnError(f"not all children stopped cleanly: {reasons}")

    def _observe(self, event: ChildEvent) -> None:
        child, reason = event.child, event.reason
        if event.kind == "stop_failed" or (event.kind == "stopped" and not event.normal):
            self._failed_stops.setdefault(child, reason)  # the first reason is the cause
        if event.kind == "restarting":
            self.log.info("restarting child %s: %s", child, reason)
            return
        level = _LOG_LEVELS.get(event.kind, logging.DEBUG)
        if event.kind == "stopped" and not event.normal:
            level = logging.WARNING
        words = f"child {event.kind.replace('_', ' ')}: {child}"
        self.log.log(level, "%s", f"{words}: {reason}" if reason else words)


def _raise(error: Exception) -> NoReturn:
    raise error


class ChildGroup:
    """The children of one supervisor: brings what runs to what its restart policy requires.

    All methods are for one thread, the supervisor's, except `request_stop`, which may be called
    from any thread and from signal handlers.
    """

    def __init__(
        self,
        name: str,
        children: Mapping[str, ChildSpec],
        supervision: Supervision,
        launcher: Launcher,
        *,
        observe: Callable[[ChildEvent], None],
        report_progress: Callable[[str], None],
        on_exit: Callable[[], None],
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """Take the children, by name in start order, of the supervisor `name`.

        `observe` receives all events. `report_progress` is called before each step that may take
        long. `on_exit` is called from any thread when a child has ended: `reconcile` is then due.
        """
        self.name = name
        self._launcher = launcher
        self._policy = RestartPolicy(children, supervision)
        self._observe = observe
        self._now = now
        self._children = {
            child: Child(
                child,
                spec,
                launcher,
                observe=observe,
                report_progress=report_progress,
                on_exit=on_exit,
                now=now,
            )
            for child, spec in children.items()
        }
        self._stop_requested = False
        self._finished: ExitReport | None = None

    @property
    def finished(self) -> ExitReport | None:
        """The report on the normal end of a significant child; None if there was none."""
        return self._finished

    @property
    def stop_requested(self) -> bool:
        """Whether `request_stop` was called."""
        return self._stop_requested

    def status(self) -> list[ChildStatus]:
        """Return the states of all children in start order."""
        return [child.status() for child in self._children.values()]

    def request_stop(self) -> None:
        """Start nothing any more, and cut short the start in progress; `stop_all` is then due."""
        self._stop_requested = True
        self._launcher.request_stop()

    def start_all(self) -> None:
        """Start the children that load at start, each when the one before is active.

        A child that dies meanwhile is restarted as at any time; a child that refuses to start makes
        the supervisor fail, see `RestartPolicy`. Returns when all are active, or a stop was
        requested, or a significant child has finished. Raises the same as `reconcile`.
        """
        self._finished = None
        for name, child in self._children.items():
            if child.spec.load == "at_start":
                self._policy.load(name)
        self.reconcile()

    def reconcile(self) -> None:
        """Find children that have ended, and stop and start children as the policy decides.

        Call it after `on_exit`, and now and then. Raises `Escalate` if the policy gives up, or if a
        child must be restarted that does not end even when killed: two incarnations must never run
        at once. All children are stopped then. Raises `LauncherLost`; call `stop_all` then.
        """
        try:
            while not self._stop_requested:
                self._note_exits()
                child = self._next_to_start()
                if child is None:
                    return
                if child.unkillable:
                    self._give_up(f"given up: {child.name} does not end even when killed")
                self._start_or_decide(child)
        except StopRequested:
            return

    def kill_hung(self, name: str, incarnation: int, where: str, seconds: float) -> None:
        """Kill a child that has been hanging in a handler; `reconcile` is then due.

        No effect on a later incarnation. Raises the same as `reconcile`.
        """
        child = self._child(name)
        if self._stop_requested or child.handle is None or incarnation != child.incarnation:
            return
        child.kill()
        reason = f"hung for {seconds:.1f} s in {where}; killed"
        self._note_exit(child, "hung", ExitReport(False, reason))

    def load(self, name: str) -> None:
        """Start a child that is not loaded; no effect if it is loaded.

        If it dies during the start, the start is repeated, as often as restarts are allowed. Raises
        `UnknownChild`; `StartFailed` with the cause if the child does not become active, which does
        not count as a restart: the caller decides what follows.
        """
        child = self._child(name)
        if not self._policy.load(name).start:
            return
        failure = self._start_on_request(child)
        if failure:
            self._policy.unload(name)
            raise StartFailed(f"{name}: {failure}")

    def unload(self, name: str) -> None:
        """Stop a child and leave it stopped. Raises `UnknownChild`."""
        child = self._child(name)
        self._policy.unload(name)
        child.stop()
        child.state = "unloaded"

    def restart(self, name: str) -> None:
        """Stop and start a child, or load it. Raises `UnknownChild` and the same as `reconcile`."""
        child = self._child(name)
        if name not in self._policy.required:
            self.load(name)
            return
        self._policy.restart(name)
        child.stop()
        self.reconcile()

    def stop_all(self) -> None:
        """Stop all children in reverse order, whatever any of them does, and unload them."""
        for name in self._children:
            self._policy.unload(name)
        for child in reversed(self._children.values()):
            child.stop()
            child.state = "unloaded"

    def _note_exits(self) -> None:
        for child in self._children.values():
            report = child.exit_report()
            if report is not None:
                self._note_exit(child, "ended" if report.normal else "failed", report)

    def _note_exit(self, child: Child, kind: EventKind, report: ExitReport) -> None:
        child.note_exit(kind, report)
        decision = self._policy.ended(
            child.name, normal=report.normal, at_s=self._now(), reason=report.reason
        )
        if decision.finished:
            self._finished = ExitReport(True, decision.finished, report.success)
        self._apply(decision, child.name, report.reason)

    def _apply(self, decision: Decision, child: str, reason: str) -> None:
        if child in decision.start:
            count = self._policy.restart_count
            self._observe(ChildEvent(child, "restarting", f"{reason} ({count})"))
        for name in decision.stop:
            self._children[name].stop()
        if decision.give_up:
            self._give_up(decision.give_up)

    def _give_up(self, reason: str) -> NoReturn:
        self.stop_all()
        self._observe(ChildEvent(self.name, "given_up", reason))
        raise Escalate(reason)

    def _next_to_start(self) -> Child | None:
        children = (self._children[name] for name in self._policy.required)
        return next((child for child in children if child.handle is None), None)

    def _start_or_decide(self, child: Child) -> None:
        failure = self._start(child)
        if failure is not None:
            decision = self._policy.start_failed(
                child.name, at_s=self._now(), reason=failure.reason, refused=failure.refused
            )
            self._apply(decision, child.name, failure.reason)

    def _start_on_request(self, child: Child) -> str:
        """Start a child, repeatedly if it dies; return why that failed, "" if it did not."""
        attempts_left = 1 + self._policy.supervision.max_restarts
        try:
            while not self._stop_requested:
                if child.unkillable:
                    return "it still runs, and does not end even when killed"
                failure = self._start(child)
                if failure is None:
                    return ""
                attempts_left -= 1
                if attempts_left == 0 or failure.refused:
                    return failure.reason
        except StopRequested:
            child.stop()
        return "a stop was requested"

    def _start(self, child: Child) -> StartFailure | None:
        failure = child.start(lambda: self._stop_requested)
        if failure is None:
            self._policy.started(child.name)
        return failure

    def _child(self, name: str) -> Child:
        if name not in self._children:
            known = ", ".join(self._children) or "(none)"
            raise UnknownChild(f"{self.name}: no child is named {name}; choose one of: {known}")
        return self._children[name]
