"""Lockstep: a whole deployment on one thread and virtual time; the same seed, the same run."""

import heapq
import itertools
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import NoReturn, TypeVar

from cairn.bus.lockstep_bus import LockstepBus
from cairn.deployment.exclusive_topics import exclusive_topics
from cairn.deployment.model import ROOT, Deployment
from cairn.deployment.plugins import load_plugin
from cairn.errors import CairnError
from cairn.processes.child import ChildHandle, completed
from cairn.processes.child_channel import Heartbeat, Verb
from cairn.processes.supervisor import Supervisor
from cairn.runtime.launch_request import LaunchRequest, RunContext
from cairn.runtime.lifecycle import Transition
from cairn.runtime.process_exit import ExitReport
from cairn.runtime.runtime import Runtime
from cairn.system.clock import SECOND

T = TypeVar("T")

_HEARTBEAT_NS = SECOND
_CALLS_AT_ONE_TIME = 1_000_000


class LockstepRun:
    """A deployment on virtual time; `bus` may be watched, `executor` is its clock.

    A run beside another one shares its bus and its time: the deployments of several robots, each
    with its own name.

    `run` runs it from beginning to end. To run it piece by piece: `start`, then `executor.run_to`
    or `run_until` as often as needed, then `shutdown`.
    """

    def __init__(
        self, deployment: Deployment, seed: int, beside: "LockstepRun | None" = None
    ) -> None:
        """Raises `CairnError` if the root cannot be constructed."""
        self.executor: LockstepExecutor = LockstepExecutor() if beside is None else beside.executor
        self.bus: LockstepBus = LockstepBus(self.executor.after) if beside is None else beside.bus
        self.simulated = deployment.clock == "simulated"
        self.end: ExitReport | None = None
        context = RunContext(
            robot=deployment.robot.name,
            simulated_time=deployment.clock == "simulated",
            seed=seed,
            stop_limit_s=deployment.stop_limit_s,
            lockstep=True,
            call_log=deployment.has_call_log,
            log_level=deployment.log_level,
            deployment=deployment.model_dump_json(),
            exclusive_topics=exclusive_topics(deployment),
        )
        launch = LaunchRequest(name=ROOT, spec=deployment.root(), context=context)
        self._root = _LockstepHost(self, launch, self._note_exit)
        self._stopping = False

    def run(self, refresh: Callable[[], None]) -> ExitReport:
        """Run until a significant component ends, all fails, or `stop`; return how it ended.

        `refresh` is called before every event.
        """

        def refreshed() -> bool:
            refresh()
            return False

        self._configure()
        try:
            with suppress(CairnError):  # the root has ended then, with that as its reason
                self._root.runtime.transition(Transition.ACTIVATE)
            self.run_until(refreshed)
        finally:
            self.shutdown()
        return self.end or ExitReport(False, "the root ended without a report")

    def start(self) -> None:
        """Configure and activate all components.

        Raises `CairnError` if one of them cannot be; the run has ended then, with that as its
        reason.
        """
        self._configure()
        self._root.runtime.transition(Transition.ACTIVATE)

    def run_until(self, condition: Callable[[], bool]) -> None:
        """Run until `condition()` holds, which is checked before every event, or until the end.

        The end is the deployment's own, or that of `stop`.
        """
        self.executor.run(lambda: condition() or self.end is not None or self._stopping)

    def shutdown(self) -> None:
        """Shut down all components, unless the run has ended."""
        if self.end is None:
            self._root.runtime.transition(Transition.SHUTDOWN)

    def stop(self) -> None:
        """End the run at the next event; from a signal handler."""
        self._stopping = True

    def runtime(self, component: str) -> Runtime:
        """Return what runs a component, which takes requests and has its state.

        Raises `CairnError` if no component of that name runs.
        """
        return self._host(component).runtime

    def suspend(self, component: str) -> None:
        """Have a component make no further calls, as if its process were stopped (SIGSTOP).

        Raises `CairnError` if no component of that name runs.
        """
        self._host(component).suspend()

    def _configure(self) -> None:
        self.executor.at(0, self._publish_heartbeats)
        self._root.runtime.transition(Transition.CONFIGURE)

    def _host(self, component: str) -> "_LockstepHost":
        for host in self._root.tree():
            if host.runtime.name == component:
                return host
        raise CairnError(f"{component}: no component of this name runs in lockstep")

    def _note_exit(self, report: ExitReport) -> None:
        self.end = report

    def _publish_heartbeats(self) -> None:
        self._root.publish_heartbeats()
        self.executor.at(self.executor.now() + _HEARTBEAT_NS, self._publish_heartbeats)


class LockstepExecutor:
    """Runs calls in order of their virtual time, ties in order of arrival. It is also the clock."""

    def __init__(self, start: int = 0) -> None:
        self._now = start
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._calls_at_now = 0

    def now(self) -> int:
        """Return the virtual time [ns]."""
        return self._now

    def at(self, time: int, call: Callable[[], None]) -> None:
        """Make `call` at virtual time `time` [ns], now if that is past."""
        heapq.heappush(self._events, (max(time, self._now), next(self._order), call))

    def after(self, delay_ns: int, call: Callable[[], None]) -> None:
        """Make `call` after that virtual time [ns]."""
        self.at(self._now + delay_ns, call)

    def scheduler(self) -> "LockstepScheduler":
        """Return a scheduler for one component."""
        return LockstepScheduler(self)

    def run(self, until: Callable[[], bool]) -> None:
        """Make calls until `until()` holds.

        Raises `CairnError` when no calls are left before that, or when time stands still under a
        flood of calls: two components that answer each other without end.
        """
        while not until():
            if not self._events:
                raise CairnError(
                    "lockstep: nothing is left to happen and nothing has ended the run; a "
                    "component with `significant: true` must finish"
                )
            self._step()

    def run_to(self, time: int) -> None:
        """Make all calls that are due at virtual time `time` [ns] or before; it is `time` then.

        Calls that these calls add for `time` or before are made too. Raises `CairnError` under a
        flood of calls at one instant, as `run` does.
        """
        while self._events and self._events[0][0] <= time:
            self._step()
        self._now = max(self._now, time)

    def _step(self) -> None:
        """Make the next call."""
        time, _, call = heapq.heappop(self._events)
        self._calls_at_now = self._calls_at_now + 1 if time == self._now else 0
        if self._calls_at_now > _CALLS_AT_ONE_TIME:
            raise CairnError(
                f"lockstep: {_CALLS_AT_ONE_TIME} calls at one instant ({time} ns); do two "
                "components answer each other without end?"
            )
        self._now = time
        call()


class LockstepScheduler:
    """Queues the calls of one component in the executor."""

    def __init__(self, executor: LockstepExecutor) -> None:
        self._executor = executor
        self._on_time: Callable[[], None] | None = None
        self._wake_at: int | None = None
        self._running = True

    def post(self, call: Callable[[], None]) -> None:
        """Make `call` now, after what was posted before."""
        self._executor.at(self._executor.now(), partial(self._make, call))

    deliver = receive = post

    def wake_at(self, time: int) -> None:
        """Run the timers that are due at virtual time `time` [ns]."""
        if self._wake_at is not None and self._wake_at <= time:
            return
        self._wake_at = time
        self._executor.at(time, partial(self._wake, time))

    def bind(self, on_time: Callable[[], None]) -> None:
        """Set the function that runs due timers."""
        self._on_time = on_time

    def stop(self) -> None:
        """Make no further calls."""
        self._running = False

    def _make(self, call: Callable[[], None]) -> None:
        if self._running:
            call()

    def _wake(self, time: int) -> None:
        if self._wake_at != time:
            return
        self._wake_at = None
        if self._running and self._on_time is not None:
            self._on_time()


class _LockstepHost:
    """One component in lockstep; also `SupervisorHost` of its children, and `ChildHandle`."""

    def __init__(
        self,
        run: LockstepRun,
        launch: LaunchRequest,
        on_exit: Callable[[ExitReport], None],
    ) -> None:
        self.run = run
        self.end: ExitReport | None = None
        self._on_exit = on_exit
        self._scheduler = run.executor.scheduler()
        self._children: list[_LockstepHost] = []
        self.runtime = Runtime(
            load_plugin(launch.spec.plugin),
            launch,
            run.bus,
            self._scheduler,
            run.executor,
            self._note_exit,
        )
        if isinstance(self.runtime.component, Supervisor):
            self.runtime.component.adopt(launch, self)

    def tree(self) -> Iterator["_LockstepHost"]:
        """Yield this host and all that run below it."""
        yield self
        for child in self._children:
            if child.end is None:
                yield from child.tree()

    def suspend(self) -> None:
        """Make no further calls."""
        self._scheduler.stop()

    def publish_heartbeats(self) -> None:
        """Publish the status of the component and of all below it."""
        self.runtime.publish_heartbeat()
        for child in tuple(self._children):
            child.publish_heartbeats()

    def now(self) -> float:
        """Return the virtual time [s]."""
        return self.run.executor.now() / SECOND

    def awake(self) -> float:
        """Return the virtual time [s], which has no pauses."""
        return self.now()

    def post(self, call: Callable[[], None]) -> None:
        """Have `call` made as a handler of the supervisor."""
        self._scheduler.post(lambda: self.runtime.run("supervision", call))

    def report_progress(self, step: str) -> None:
        """Do nothing: virtual time stands still during a call, so that it cannot hang."""

    def in_background(self, call: Callable[[], T]) -> "Future[T]":
        """Make a call at once: it takes no virtual time."""
        return completed(call)

    def launch_child(self, launch: LaunchRequest, on_exit: Callable[[], None]) -> ChildHandle:
        """Construct a child."""
        child = _LockstepHost(self.run, launch, lambda _: on_exit())
        self._children = [other for other in self._children if other.end is None]
        self._children.append(child)
        return child

    def machines(self) -> NoReturn:
        """Raise `CairnError`: all components of a lockstep run are here."""
        raise CairnError("a lockstep run has no machines")

    def cancel_starts(self) -> None:
        """Do nothing: a start takes no virtual time."""

    def cancel_start(self, name: str) -> None:
        """Do nothing: a start takes no virtual time."""

    def request(self, verb: Verb, timeout_s: float) -> None:
        """Make a transition at once."""
        self.runtime.request(verb, {})

    def heartbeat(self) -> Heartbeat:
        """Return its state; no call is in progress."""
        return Heartbeat(self.runtime.state)

    def memory(self) -> int:
        """Return 0: it has no process of its own."""
        return 0

    def is_stopped(self) -> bool:
        """Return False: it has no process of its own."""
        return False

    def expect_stop(self, limit_s: float) -> None:
        """Do nothing: a stop takes no virtual time."""

    def terminate(self) -> None:
        """Shut it down."""
        if self.end is None:
            self.runtime.request("shutdown", {})

    def kill(self, log_limit_s: float) -> None:
        """Raise `CairnError` unless it has ended."""
        if self.end is None:
            raise CairnError(f"{self.runtime.name}: a component cannot be killed in lockstep")

    def wait(self, timeout_s: float) -> ExitReport | None:
        """Return the report on its end, None if it runs."""
        return self.end

    def _note_exit(self, report: ExitReport) -> None:
        self.end = report
        self._on_exit(report)
