"""Supervisors: components that keep the components below them running.

When a child ends, the zygote reports its exit to the supervisor's host, which calls `on_exit`; the
supervisor then reconciles: `RestartPolicy` decides which children stop and start, `Child` stops
them and starts them through the host. Starts are made in the background, so that a slow one delays
neither the restart of another child nor a request.

Log lines begin with an event in stable words, then the child's name, then the reason:

| event | level | meaning |
|---|---|---|
| `child active: NAME` | INFO | it has started |
| `child stopped: NAME: REASON` | INFO, or WARNING after a failure | its supervisor has stopped it |
| `child ended: NAME: REASON` | INFO | it has finished of its own accord |
| `child failed: NAME: REASON` | WARNING | it has failed, or was killed from outside |
| `child hung: NAME: REASON` | ERROR | its supervisor has killed it as hung |
| `child deviates: NAME: REASON` | WARNING | it is not in its state; its supervisor restores that |
| `child held by request: NAME: STATE` | INFO | it is kept in that state until `active` is |
| `child start failed: NAME: REASON` | ERROR, or WARNING after its own | it is not active |
| `child stop failed: NAME: REASON` | WARNING | a step of stopping failed; a harder one follows |
| `restarting child NAME: REASON (2 of 3 restarts in 10 s)` | INFO | follows a failure or an end |

Level DEBUG adds `child starting` and `child stopping`. Children on other machines are in
`cairn.processes.remote_child`.
"""

import logging
import math
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from concurrent.futures import wait as wait_for
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, Literal, NoReturn

from cairn.bus.bus import Post, full_name
from cairn.deployment.model import fallback_name
from cairn.errors import CairnError, Escalate, LoggedFailure
from cairn.processes.child import (
    Child,
    ChildStatus,
    StartResult,
    SupervisorHost,
    stop_share,
    without_reserve,
)
from cairn.processes.remote_child import RemoteChild
from cairn.processes.restart_policy import RestartDecision, RestartPolicy
from cairn.processes.ros_services import ChildLifecycle, Container
from cairn.runtime.component import Component
from cairn.runtime.handlers import every
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.lifecycle import LifecycleState
from cairn.runtime.process_exit import ExitReport

_STEP_S = 0.5
"""Longest time between two checks of the others while a child starts."""

HELD_STATES = ("unconfigured", "inactive", "active")
"""The states of its life cycle in which a child can be held."""


class StartFailed(LoggedFailure):
    """A child loaded on request did not become active and is unloaded again."""


class EscalatedStart(Escalate, LoggedFailure):
    """A supervisor has given up because a child did not become active."""


class UnknownChild(CairnError):
    """A supervisor has no child of that name."""


class Supervisor(Component):
    """Starts the components below it in its deployment, and restarts them as `supervision` says.

    Children are started in order when it is activated, each when the one before is active, and
    stopped in reverse order; those with `load: on_request` are loaded by
    `self.children.load(name)`. When too many restarts fall in the window, the supervisor itself
    fails, and its own supervisor decides what follows.
    """

    is_supervisor: ClassVar[bool] = True
    clock_source: ClassVar[Literal["deployment", "system"]] = "system"

    children: "ChildGroup"

    def adopt(self, launch: LaunchRequest, host: SupervisorHost) -> None:
        """Take over the children of the deployment; called by the placement before `configure`."""
        from cairn.processes.logged_children import LoggedChildren

        self._launch = launch
        self._post: Post = host.post
        on_exit = partial(host.post, self.reconcile)
        log = self._context.call_log
        if log is None:
            self.children = ChildGroup(launch, host, self.log, on_exit)
        else:
            self.children = LoggedChildren(launch, host, self.log, on_exit, log)
        self._serve_children(launch)

    def _serve_children(self, launch: LaunchRequest) -> None:
        """Serve what ROS 2 tools use to see and change the life cycle of the children.

        Those that were loaded by a parent on another machine are served by that parent.
        """
        robot, request = launch.context.robot, self._context.request
        for name in launch.spec.children:
            if name in launch.context.parents:
                continue
            child = ChildLifecycle(name, partial(self._lifecycle_of, name), request)
            self._context.serve_node(full_name(robot, name), child.services())
        plugins = {name: spec.plugin for name, spec in launch.spec.children.items()}
        container = Container(
            robot, plugins, lambda name: self._state_of(name) != "unloaded", request
        )
        self._context.serve_node(full_name(robot, self.name), container.services())

    def _lifecycle_of(self, name: str) -> str:
        status = {status.name: status for status in self.children.status()}[name]
        return status.held_in or status.state

    def _state_of(self, name: str) -> str:
        return {status.name: status.state for status in self.children.status()}[name]

    def adopt_recorded(self, children: "ChildGroup", post: Post) -> None:
        """Take over children of which a call log has what they answered, for a re-run."""
        self._launch = self._context.launch
        self._post = post
        self.children = children

    def on_activate(self) -> None:
        """Start the children."""
        self.children.start_all()
        self._finish_if_done()

    def on_deactivate(self) -> None:
        """Stop the children; raises `CairnError` naming those that failed while stopping."""
        self.children.stop_all()
        self.children.check_stops()

    def on_shutdown(self) -> None:
        """Stop the children that are left."""
        self.children.stop_all()

    def on_error(self, _: Exception) -> bool:
        """Stop all children; do not recover."""
        self.children.stop_all()
        return False

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Load, unload, restart the child `name`, or hold it in a `state`; return its state.

        The root answers `run` with the deployment (JSON), the seed, and whether it is lockstep.
        """
        if verb == "run" and not arguments and not self._launch.parent:
            run = self._launch.context
            return {"deployment": run.deployment, "seed": run.seed, "lockstep": run.lockstep}
        expected = {"load": {"name"}, "unload": {"name"}, "restart": {"name"}}
        expected["hold"] = {"name", "state"}
        if set(arguments) != expected.get(verb):
            return super().on_request(verb, arguments)
        name = str(arguments["name"])
        try:
            if verb == "hold":
                return self.children.hold(name, str(arguments["state"]))
            getattr(self.children, verb)(name)
        except Escalate as error:
            # The request is answered, but the failure is the supervisor's own.
            self._post(partial(_raise, error))
            raise CairnError(f"{self.name}: {error}") from error
        return self._state_of(name)

    @every(hz=2)
    def check_children(self) -> None:
        """Kill children that hang, restore those that deviate, and restart what has ended."""
        self.children.check()
        self.reconcile()

    def reconcile(self) -> None:
        """Stop and start children as the restart policy decides; end with a significant one."""
        self.children.reconcile()
        self._finish_if_done()

    def _finish_if_done(self) -> None:
        report = self.children.finished
        if report is not None:
            self.children.check_stops()
            self.finish(report.reason, success=report.success)


def _raise(error: Exception) -> NoReturn:
    raise error


class _Start:
    """A start of a child, in the background; `is_own` if `load` takes its result."""

    def __init__(self, child: Child | RemoteChild, *, is_own: bool) -> None:
        self.child = child
        self.is_own = is_own
        self.is_canceled = False
        self.result: Future[StartResult] = Future()


class ChildGroup:
    """The children of one supervisor: brings what runs to what its restart policy requires.

    A child starts in the background. Meanwhile the others are looked after: what ends is restarted,
    what hangs is killed.

    All methods are for one thread, the supervisor's, except `request_stop`, which may be called
    from any thread and from signal handlers.
    """

    def __init__(
        self,
        launch: LaunchRequest,
        host: SupervisorHost,
        log: logging.Logger,
        on_exit: Callable[[], None],
    ) -> None:
        """Take the children of the supervisor that was launched like this.

        `on_exit` is called from any thread when a child has ended: `reconcile` is then due.
        """
        self.finished: ExitReport | None = None
        """The report on the normal end of a significant child; None if there was none."""
        self.stop_requested = False
        self._name = launch.name
        self._stop_limit_s = launch.context.stop_limit_s
        # When all must have stopped [s]: as requested, and in the stop in progress. A pause counts.
        self._requested_by = self._stopping_by = math.inf
        self._host = host
        self._log = log
        self._on_exit_due = on_exit
        self._policy = RestartPolicy(launch.spec.children, launch.spec.supervision)
        self._starts: dict[str, _Start] = {}  # in progress, or with a result that was not taken yet
        self._news = threading.Event()  # a child has ended, or a start
        self._children: dict[str, Child | RemoteChild] = {
            name: RemoteChild(name, launch, host, log)
            if launch.is_elsewhere(spec)
            else Child(name, launch, host, log, self._note_news)
            for name, spec in launch.spec.children.items()
        }
        self._fallbacks = {
            fallback_name(name): name
            for name, spec in launch.spec.children.items()
            if spec.fallback is not None
        }

    def status(self) -> list[ChildStatus]:
        """Return the states of all children in start order."""
        return [
            replace(child.status(), fallback_of=self._fallbacks.get(child.name, ""))
            for child in self._children.values()
        ]

    def request_stop(self, limit_s: float | None = None) -> None:
        """Start nothing any more, here and below, and cut short the starts in progress.

        `stop_all` is then due, and takes at most `limit_s` [s] from now on, by default the
        deployment's `stop_limit_s`.
        """
        own_s = without_reserve(self._stop_limit_s if limit_s is None else limit_s)
        self._requested_by = min(self._requested_by, self._host.now() + own_s)
        self.stop_requested = True
        self._host.cancel_starts()
        for child in self._children.values():
            child.expect_stop(own_s)

    @property
    def stop_overdue(self) -> bool:
        """Whether a stop takes longer than it may; from any thread."""
        return self._host.now() > min(self._requested_by, self._stopping_by)

    def start_all(self) -> None:
        """Start the children that load at start, each when the one before is active.

        A child that dies meanwhile is restarted as at any time; a child that refuses to start makes
        the supervisor fail, see `RestartPolicy`. Returns when all are active, or a stop was
        requested, or a significant child has finished. Raises the same as `reconcile`.
        """
        self.finished = None
        for name, child in self._children.items():
            if child.spec.load == "at_start":
                self._policy.load(name)
        self.reconcile()
        self._await(lambda: not self._starts)

    def reconcile(self) -> None:
        """Find children that have ended, and stop and start children as the policy decides.

        Call it after `on_exit`, and now and then. It does not wait for the starts: `on_exit` is
        called when one is done. Raises `Escalate` if the policy gives up, or if a
        child must be restarted that does not end even when killed: two incarnations must never run
        at once. All children are stopped then. Raises `ZygoteLost`; call `stop_all` then.
        """
        while not self.stop_requested:
            self._take_results()
            for running in self._settled():
                report = running.poll()
                if report is not None:
                    self._on_exit(running, report)
            child = self._next_to_start()
            if child is None:
                return
            self._begin_start(child)

    def check(self) -> None:
        """Kill the children that hang, and restore those that are not in the state they should be.

        `reconcile` is then due. Raises the same as `reconcile`.
        """
        self._check_settled()
        for name, child in self._children.items():
            if isinstance(child, RemoteChild) and fallback_name(name) in self._children:
                self._switch_fallback(child, fallback_name(name))

    def _switch_fallback(self, child: RemoteChild, fallback: str) -> None:
        """Load the fallback of a remote child while it is needed."""
        loaded = fallback in self._policy.required
        if child.needs_fallback and not loaded and not self.stop_requested:
            try:
                self.load(fallback)
            except StartFailed as error:  # its start has been logged; the next check tries it again
                child.reason = f"{child.reason}; its fallback failed: {error}"
        elif loaded and not child.needs_fallback:
            self.unload(fallback)

    def hold(self, name: str, state: str) -> str:
        """Bring a child to a state of its life cycle and keep it there; "active" releases it.

        Returns the state. Unloading and restarting it on request releases it, too. Raises
        `UnknownChild`; `CairnError` for an unknown state, if the child does not run, or with the
        component's own error if it refuses.
        """
        child = self._child(name)
        if state not in HELD_STATES:
            choice = ", ".join(HELD_STATES)
            raise CairnError(f"{name}: cannot be held in state {state}; choose one of: {choice}")
        self._await(lambda: name not in self._starts)
        child.hold(LifecycleState(state))
        return state

    def load(self, name: str) -> None:
        """Start a child that is not loaded; no effect if it is loaded.

        If it dies during the start, the start is repeated, as often as restarts are allowed. Raises
        `UnknownChild`; `StartFailed` with the cause if the child does not become active, which does
        not count as a restart: the caller decides what follows. If the policy gives up another
        child meanwhile, the supervisor fails after the call.
        """
        child = self._child(name)
        if name in self._policy.required:
            return
        self._policy.load(name)
        for _ in range(1 + self._policy.supervision.max_restarts):
            result = "canceled" if self.stop_requested else self._start_now(child)
            if result != "unavailable":
                break
        if result == "active":
            return
        reason = child.reason
        if result == "canceled":
            self._stop(child)
            reason = "all children were stopped meanwhile"
            if self.stop_requested:
                reason = "a stop was requested"
        self._policy.unload(name)
        raise StartFailed(f"{name}: {reason}")

    def unload(self, name: str) -> None:
        """Stop a child and leave it stopped. Raises `UnknownChild`."""
        child = self._child(name)
        self._policy.unload(name)
        self._stop(child)
        child.state, child.target = "unloaded", LifecycleState.ACTIVE

    def restart(self, name: str) -> None:
        """Stop and start a child, or load it. Raises `UnknownChild` and the same as `reconcile`."""
        child = self._child(name)
        if name not in self._policy.required:
            self.load(name)
            return
        self._policy.unload(name)
        self._stop(child)
        child.target = LifecycleState.ACTIVE
        self._policy.load(name)
        self.reconcile()
        self._await(lambda: name not in self._starts)

    def stop_all(self) -> None:
        """Stop all children in reverse order, whatever any of them does, and unload them.

        All of this takes no longer than `request_stop` allowed, or the deployment's `stop_limit_s`.
        Each child gets its `stop_share` of the time that is left then.
        """
        for name in self._children:
            self._policy.unload(name)
        self._stopping_by = self._host.now() + without_reserve(self._stop_limit_s)
        for child in reversed(self._children.values()):
            self._stop(child)
            child.state, child.target = "unloaded", LifecycleState.ACTIVE
        self._stopping_by = math.inf

    def check_stops(self) -> None:
        """Raise `CairnError` if a child has failed while it was stopped.

        Perhaps a report was not written: that is not a success.
        """
        failures = {name: child.stop_failure for name, child in self._children.items()}
        reasons = "; ".join(f"{name}: {reason}" for name, reason in failures.items() if reason)
        if reasons:
            raise CairnError(f"not all children stopped cleanly: {reasons}")

    def _stop(self, child: Child | RemoteChild) -> None:
        """Stop a child in the time that it may take if all must stop, otherwise in its own."""
        start = self._starts.pop(child.name, None)
        if start is not None:
            self._cancel(start)
        remaining = sum(one.components for one in self._children.values())
        child.stop(stop_share(self._left_s, child.components, remaining))

    @property
    def _left_s(self) -> float:
        """The time that is left for a stop of all children [s]; infinite if there is none."""
        return min(self._requested_by, self._stopping_by) - self._host.now()

    def _cancel(self, start: _Start) -> None:
        """Cut short a start, and wait until that is done; the child may run then."""
        start.is_canceled = True
        if not start.result.done():
            self._host.cancel_start(start.child.name)
            start.child.expect_stop(max(0.0, min(self._left_s, start.child.spec.stop_limit_s)))
        while not start.result.done():
            self._host.report_progress(f"canceling the start of {start.child.name}")
            wait_for([start.result], _STEP_S)

    def _settled(self) -> list[Child | RemoteChild]:
        """Return the children that are not being started."""
        return [child for name, child in self._children.items() if name not in self._starts]

    def _check_settled(self) -> None:
        for child in self._settled():
            report = None if self.stop_requested else child.check(lambda: self.stop_requested)
            if report is not None and isinstance(child, RemoteChild):
                self._give_up(f"{child.name} is lost: {report.reason}")
            if report is not None:
                self._on_exit(child, report)

    def _next_to_start(self) -> Child | RemoteChild | None:
        """Return the next child to start; None if there is none, or another one comes first.

        Children start in order, each when the one before is active. A restart waits for no start of
        another child, unless the strategy restarts both together.
        """
        alone = self._policy.supervision.strategy == "one_for_one"
        for name in self._policy.required:
            if name in self._starts or self._children[name].runs:
                continue
            if not self._starts or (alone and self._policy.was_started(name)):
                return self._children[name]
        return None

    def _begin_start(self, child: Child | RemoteChild, *, is_own: bool = False) -> _Start:
        start = _Start(child, is_own=is_own)

        def run() -> StartResult:
            return child.start(lambda: self.stop_requested or start.is_canceled)

        start.result = self._host.in_background(run)
        self._starts[child.name] = start
        if not start.result.done():
            start.result.add_done_callback(lambda _: self._note_news())
        return start

    def _start_now(self, child: Child | RemoteChild) -> StartResult:
        """Start a child and wait until that is done, or a stop was requested."""
        start = self._begin_start(child, is_own=True)
        try:
            self._await(start.result.done)
        except Escalate as error:  # all children are stopped; not the caller's to handle
            self._host.post(partial(_raise, error))
        if not start.result.done() or self._starts.pop(child.name, None) is not start:
            return "canceled"
        result = start.result.result()
        if result == "active":
            self._policy.started(child.name)
        return result

    def _take_results(self) -> None:
        """Do what follows from the starts that are done."""
        for name, start in list(self._starts.items()):
            if start.is_own or not start.result.done() or self._starts.get(name) is not start:
                continue
            del self._starts[name]
            self._follow(start.child, start.result.result())

    def _follow(self, child: Child | RemoteChild, result: StartResult) -> None:
        if result == "active":
            self._policy.started(child.name)
        elif result == "unkillable":
            in_process = child.spec.placement == "in_process"
            remedy = "give it `placement: process`" if in_process else "check its device, or reboot"
            self._give_up(f"given up: {child.name}: {child.reason}; {remedy}")
        elif result in ("refused", "unavailable"):
            now, refused = self._host.now(), result == "refused"
            decision = self._policy.start_failed(
                child.name, at_s=now, reason=child.reason, refused=refused
            )
            self._apply(decision, child, EscalatedStart)

    def _await(self, is_over: Callable[[], bool]) -> None:
        """Look after the children until something is over, or a stop was requested.

        Raises the same as `reconcile`.
        """
        while not (is_over() or self.stop_requested):
            self._news.wait(_STEP_S)
            self._news.clear()
            self._host.report_progress(f"starting {', '.join(self._starts)}")
            self._check_settled()
            self.reconcile()

    def _note_news(self) -> None:
        """Note that a child or a start has ended; from any thread."""
        self._news.set()
        self._on_exit_due()

    def _on_exit(self, child: Child | RemoteChild, report: ExitReport) -> None:
        decision = self._policy.ended(
            child.name, normal=report.normal, at_s=self._host.now(), reason=report.reason
        )
        if decision.finished:
            self.stop_all()
            self.finished = ExitReport(True, decision.finished, report.success)
        else:
            self._apply(decision, child)

    def _apply(
        self,
        decision: RestartDecision,
        child: Child | RemoteChild,
        failure: type[Escalate] = Escalate,
    ) -> None:
        if decision.give_up:
            self._give_up(decision.give_up, failure)
        if child.name in decision.start:
            count = self._policy.restart_count
            self._log.info("restarting child %s: %s (%s)", child.name, child.reason, count)
        for name in decision.stop:
            self._stop(self._children[name])

    def _give_up(self, reason: str, failure: type[Escalate] = Escalate) -> NoReturn:
        self.stop_all()
        raise failure(reason)

    def _child(self, name: str) -> Child | RemoteChild:
        if name not in self._children:
            known = ", ".join(self._children) or "(none)"
            raise UnknownChild(f"{self._name}: no child is named {name}; choose one of: {known}")
        return self._children[name]
