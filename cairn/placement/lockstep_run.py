"""Runs a whole deployment in lockstep: the same components, one thread, virtual time."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import Any

from cairn.bus.lockstep_bus import LockstepBus
from cairn.clock import SECOND
from cairn.deployment.model import ROOT, ChildSpec, Deployment
from cairn.deployment.plugins import load_plugin
from cairn.errors import CairnError
from cairn.placement.lockstep import LockstepExecutor
from cairn.placement.root import root_spec
from cairn.process_exit import ExitReport
from cairn.runtime.launch_request import LaunchRequest, RunContext
from cairn.runtime.lifecycle import Transition
from cairn.runtime.runtime import Runtime
from cairn.supervision.child import Child, ChildEnd, ChildRules, Verb
from cairn.supervision.component import SupervisorComponent

_HEARTBEAT_NS = SECOND


class LockstepRun:
    """A deployment on virtual time; `bus` may be watched, `executor` is its clock.

    `run` runs it from beginning to end. To run it piece by piece: `start`, then `executor.run_to`
    or `run_until` as often as wanted, then `shutdown`.
    """

    def __init__(self, deployment: Deployment, seed: int) -> None:
        """Raises `CairnError` if the root cannot be made."""
        self.executor = LockstepExecutor()
        self.bus = LockstepBus()
        self.robot = deployment.robot
        self.simulated = deployment.clock == "simulated"
        self.seed = seed
        self.end: ExitReport | None = None
        self._root = _Place(self, ROOT, "", root_spec(deployment), 1, "", self._note_end)
        self._stopping = False

    def run(self, refresh: Callable[[], None]) -> ExitReport:
        """Run until a significant component ends, all fails, or `stop`; gives how it ended.

        `refresh` is called before every event.
        """

        def refreshed() -> bool:
            refresh()
            return False

        self._configure()
        try:
            with suppress(CairnError):  # it has ended then, with that as its reason
                self._root.runtime.transition(Transition.ACTIVATE)
            self.run_until(refreshed)
        finally:
            self.shutdown()
        return self.end or ExitReport(False, "the root ended without a word")

    def start(self) -> None:
        """Configure and activate all components.

        Raises `CairnError` if one of them cannot be; the run has ended then, with that as its
        reason.
        """
        self._configure()
        self._root.runtime.transition(Transition.ACTIVATE)

    def run_until(self, condition: Callable[[], bool]) -> None:
        """Run until `condition()` holds, which is asked before every event, or until the end.

        That end is the deployment's own, or that of `stop`.
        """
        self.executor.run(lambda: condition() or self.end is not None or self._stopping)

    def shutdown(self) -> None:
        """Shut down all components in good order, unless the run has ended."""
        if self.end is None:
            self._root.runtime.transition(Transition.SHUTDOWN)

    def stop(self) -> None:
        """End the run at the next event; from a signal handler."""
        self._stopping = True

    def runtime(self, component: str) -> Runtime:
        """Return what runs a component, which takes requests and has its state.

        Raises `CairnError` if no component of that name runs.
        """
        return self._place(component).runtime

    def suspend(self, component: str) -> None:
        """Have a component make no further calls, as if its process were stopped (SIGSTOP).

        Raises `CairnError` if no component of that name runs.
        """
        self._place(component).suspend()

    def _configure(self) -> None:
        self.executor.at(0, self._heartbeat)
        self._root.runtime.transition(Transition.CONFIGURE)

    def _place(self, component: str) -> "_Place":
        for place in self._root.tree():
            if place.runtime.name == component:
                return place
        raise CairnError(f"{component}: no component of this name runs in lockstep")

    def _note_end(self, end: ExitReport) -> None:
        self.end = end

    def _heartbeat(self) -> None:
        self._root.heartbeat()
        self.executor.at(self.executor.now() + _HEARTBEAT_NS, self._heartbeat)


class _Place:
    """One component in lockstep, and what it launches if it is a supervisor."""

    def __init__(
        self,
        run: LockstepRun,
        name: str,
        parent: str,
        spec: ChildSpec,
        incarnation: int,
        previous_exit: str,
        on_end: Callable[[ExitReport], None],
    ) -> None:
        self.run = run
        self.spec = spec
        self._scheduler = run.executor.scheduler()
        self._children: list[_LockstepChild] = []
        request = LaunchRequest(
            name=name,
            spec=spec,
            parent=parent,
            incarnation=incarnation,
            previous_exit=previous_exit,
            context=RunContext(
                robot=run.robot, simulated_time=run.simulated, seed=run.seed, lockstep=True
            ),
        )
        self.runtime = Runtime(
            load_plugin(spec.plugin), request, run.bus, self._scheduler, run.executor, on_end
        )
        if isinstance(self.runtime.component, SupervisorComponent):
            self.runtime.component.adopt(spec.children, spec.supervision, self, self)

    def tree(self) -> Iterator["_Place"]:
        """Give itself and all that run below it."""
        yield self
        for child in self._children:
            if child.end is None:
                yield from child.place.tree()

    def suspend(self) -> None:
        """Make no further calls."""
        self._scheduler.stop()

    def launch(self, spec: ChildRules, incarnation: int, previous_exit: str) -> Child:
        """Construct a child."""
        child = _LockstepChild(self, spec.name, incarnation, previous_exit)
        self._children = [other for other in self._children if other.end is None]
        self._children.append(child)
        return child

    def post(self, call: Callable[[], None]) -> None:
        """Have `call` made as a handler of the supervisor."""
        self._scheduler.post(lambda: self.runtime.run("supervision", call))

    def awake(self) -> float:
        """Virtual time [s], in which nothing pauses."""
        return self.now()

    def now(self) -> float:
        """Virtual time [s]."""
        return self.run.executor.now() / SECOND

    def progress(self, what: str) -> None:
        """Nothing hangs in virtual time: a call that does not return, does not return."""

    def heartbeat(self) -> None:
        """Publish the status of the component and of all below it."""
        self.runtime.heartbeat.publish()
        for child in tuple(self._children):
            child.place.heartbeat()

    def child_changed(self) -> None:
        """Have the supervisor look at its children."""
        component = self.runtime.component
        if isinstance(component, SupervisorComponent):
            component.child_changed()


class _LockstepChild:
    def __init__(self, supervisor: _Place, name: str, incarnation: int, previous_exit: str) -> None:
        self.end: ExitReport | None = None
        self._supervisor = supervisor
        spec = supervisor.spec.children[name]
        parent = supervisor.runtime.name
        self.place = _Place(
            supervisor.run, name, parent, spec, incarnation, previous_exit, self._note_end
        )

    def request(self, verb: Verb, timeout_s: float) -> None:  # noqa: ARG002 - time stands still
        """Make a transition at once."""
        self.place.runtime.request(verb, {})

    def terminate(self) -> None:
        """Shut it down."""
        if self.end is None:
            self.place.runtime.request("shutdown", {})

    def kill(self) -> None:
        """End it without a step of its life cycle."""
        if self.end is None:
            raise CairnError(f"{self.place.runtime.name} cannot be killed in lockstep")

    def wait(self, timeout_s: float) -> ChildEnd | None:  # noqa: ARG002 - time stands still
        """Its end."""
        if self.end is None:
            return None
        end = self.end
        return (
            ChildEnd(True, end.reason, end.success)
            if end.normal
            else ChildEnd(False, f"failed: {end.reason}")
        )

    def _note_end(self, end: ExitReport) -> Any:
        self.end = end
        self._supervisor.child_changed()
