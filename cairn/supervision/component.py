"""A component that keeps other components running: the base of every supervisor."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Protocol

import psutil

from cairn.bus.qos import LATCHED
from cairn.deployment.model import ChildSpec, Supervision
from cairn.errors import CairnError
from cairn.runtime.component import Component
from cairn.runtime.ports import In, every, on
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.supervision.child import ChildRules, Launcher
from cairn.supervision.events import ChildStatus, SupervisionEvent
from cairn.supervision.policy import Intensity
from cairn.supervision.supervisor import Escalate, Supervisor

_SILENCE_S = 3.0
"""Beyond its limit for one handler a process may be silent for so long: it may get no processor."""
_FORCE_S = 3.0
"""What it takes to end a child by force that has not stopped in time."""


class Host(Protocol):
    """The supervisor's own place: its loop and its time."""

    def now(self) -> float:
        """Time [s] that nobody sets: that of the machine, or virtual in lockstep."""
        ...

    def awake(self) -> float:
        """The same without the time in which the machine did not let the supervisor run."""
        ...

    def post(self, call: Callable[[], None]) -> None:
        """Have `call` made as a handler of the supervisor."""
        ...

    def progress(self, what: str) -> None:
        """Say that a long call of the supervisor gets on."""
        ...


@dataclass
class _Heartbeat:
    status: ComponentStatus
    heard_at: float


class SupervisorComponent(Component):
    """Loads the components below it in its deployment, and restarts them as supervision says.

    Children are started in order when it is activated, each when the former is active, and stopped
    in reverse; those with `load: on_request` are loaded by `self.children.load(name)`. When too
    many restarts fall in the window, it fails itself, and its own supervisor decides.
    """

    is_supervisor: ClassVar[bool] = True
    clock_source: ClassVar[Literal["deployment", "system"]] = "system"

    component_status: In[ComponentStatus] = In(qos=LATCHED.with_depth(500), optional=True)

    children: Supervisor

    def adopt(
        self,
        specs: Mapping[str, ChildSpec],
        supervision: Supervision,
        launcher: Launcher,
        host: Host,
    ) -> None:
        """Take over the children of the deployment; called by the placement before `configure`."""
        self._specs = specs
        self._host = host
        self._heartbeats: dict[str, _Heartbeat] = {}
        self._failed_stops: dict[str, str] = {}
        self.children = Supervisor(
            self.name,
            [child_spec(name, spec) for name, spec in specs.items()],
            launcher,
            observe=self._observe,
            progress=lambda what, _limit_s: host.progress(what),
            strategy=supervision.strategy,
            intensity=Intensity(supervision.max_restarts, supervision.within_s),
            now=host.now,
        )

    def on_activate(self) -> None:
        """Start the children."""
        self.children.start_all()
        self._see_to_the_end()

    def on_deactivate(self) -> None:
        """Stop the children; raises `CairnError` naming those that failed in stopping."""
        self._failed_stops.clear()
        self.children.stop_all()
        self._insist_on_good_order()

    def on_shutdown(self) -> None:
        """Stop the children, should any be left."""
        self.children.stop_all()

    def on_error(self, error: Exception) -> bool:  # noqa: ARG002
        """Leave nothing running."""
        self.children.stop_all()
        return False

    def on_request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Load, unload or restart the child `name`."""
        if verb not in ("load", "unload", "restart") or set(arguments) != {"name"}:
            return super().on_request(verb, arguments)
        name = str(arguments["name"])
        if name not in self._specs:
            raise CairnError(
                f"{self.name} has no child {name}; it has {', '.join(self._specs) or 'none'}"
            )
        try:
            getattr(self.children, verb)(name)
        except Escalate as error:
            given_up = error

            def give_up() -> None:
                raise given_up

            self._host.post(give_up)  # who asked is told, but the failure is the supervisor's
            raise CairnError(f"{self.name}: {error}") from error
        states = {status.name: status.state for status in self.children.status()}
        return states[name]

    def child_changed(self) -> None:
        """Have the children seen to soon; from any thread, when one of them has ended."""
        self._host.post(self._reconcile)

    @on("component_status")
    def hear(self, status: ComponentStatus) -> None:
        """Keep the heartbeat of a child."""
        if status.component in self._specs:
            self._heartbeats[status.component] = _Heartbeat(status, self._host.awake())

    @every(hz=2)
    def watch(self) -> None:
        """Find children that hang: one handler for too long, or no sign of life."""
        for child in self.children.status():
            beat = self._heartbeats.get(child.name)
            if child.state == "active" and beat is not None:
                self._judge(child, beat)
        self._reconcile()

    def _judge(self, child: ChildStatus, beat: _Heartbeat) -> None:
        status, spec = beat.status, self._specs[child.name]
        if status.restarts + 1 != child.incarnation or status.state != "active":
            return
        silent_s = self._host.awake() - beat.heard_at
        limit_s = longest_handler_s(spec)
        if status.handler and status.handler_s > limit_s:
            busy_s = status.handler_s + silent_s
            self.children.child_hung(child.name, child.incarnation, status.handler, busy_s)
        elif silent_s > spec.hang_timeout_s + _SILENCE_S and spec.placement == "process":
            where = _where_silent(status)
            self.children.child_hung(child.name, child.incarnation, where, silent_s)

    def _reconcile(self) -> None:
        self._failed_stops.clear()
        self.children.reconcile()
        self._see_to_the_end()

    def _see_to_the_end(self) -> None:
        end = self.children.finished
        if end is not None:
            self._insist_on_good_order()
            self.finish(end.reason, success=end.success)

    def _insist_on_good_order(self) -> None:
        if self._failed_stops:  # a report that was not written, perhaps: that is no success
            what = "; ".join(f"{name}: {why}" for name, why in self._failed_stops.items())
            raise CairnError(f"not all stopped in good order: {what}")

    def _observe(self, event: SupervisionEvent) -> None:
        reason = event.reason
        if event.what == "stop_failed" or (event.what == "stopped" and not event.normal):
            self._failed_stops.setdefault(event.child, reason)  # the first tells the cause
        match event.what:
            case "hung":
                self.log.error("%s %s", event.child, reason)
            case "start_failed":
                self.log.error("%s could not be started: %s", event.child, reason)
            case "stop_failed":
                self.log.warning("%s is being stopped: %s", event.child, reason)
            case "ended" if not event.normal:
                self.log.warning("%s %s", event.child, reason)
            case "ended" | "stopped":
                what = "ended" if event.what == "ended" else "stopped"
                level = logging.INFO if event.normal else logging.WARNING
                self.log.log(level, "%s %s: %s", event.child, what, reason)
            case "active":
                self.log.info("%s active", event.child)
            case _:
                self.log.debug("%s %s %s", event.child, event.what, reason)


def child_spec(name: str, spec: ChildSpec) -> ChildRules:
    """A component of the deployment as its supervisor's engine sees it.

    A supervisor with something significant below it is significant itself: its normal end, which
    only that can bring about, is passed on upwards. Its limits are added to those of its children,
    whom it starts and stops one after the other.
    """
    inherits = any(child_spec(*child).significant for child in spec.children.items())
    return ChildRules(
        name=name,
        restart="transient" if inherits and spec.restart == "permanent" else spec.restart,
        significant=spec.significant or inherits,
        load=spec.load,
        start_timeout_s=_start_limit_s(spec),
        stop_timeout_s=_stop_limit_s(spec),
    )


def _start_limit_s(spec: ChildSpec) -> float:
    below = (_start_limit_s(child) for child in spec.children.values() if child.load == "at_start")
    return spec.start_timeout_s + sum(below)


def _stop_limit_s(spec: ChildSpec) -> float:
    below = (_stop_limit_s(child) + _FORCE_S for child in spec.children.values())
    return spec.stop_timeout_s + sum(below)


def longest_handler_s(spec: ChildSpec) -> float:
    """How long one handler of a component may last before it is taken for hung [s]."""
    return spec.hang_timeout_s + _longest_step_s(spec)


def _longest_step_s(spec: ChildSpec) -> float:
    """The longest that a supervisor may be busy with one of its children, 0 for others."""
    children = spec.children.values()
    return max((max(_start_limit_s(child), _stop_limit_s(child)) for child in children), default=0)


def _where_silent(status: ComponentStatus) -> str:
    """Where a component is whose process says nothing any more."""
    try:
        if psutil.Process(status.pid).status() == psutil.STATUS_STOPPED:
            return "a process that was stopped by a signal, as by SIGSTOP,"
    except psutil.Error:  # another user's, or just gone
        pass
    return f"{status.handler or 'a call'} that lets no other thread of its process run,"
