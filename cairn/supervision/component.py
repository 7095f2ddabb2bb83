"""A component that keeps other components running: the base of every supervisor."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Protocol

from cairn.bus.qos import LATCHED
from cairn.component.component import Component
from cairn.component.handlers import every, on
from cairn.component.ports import In
from cairn.deployment.model import ComponentSpec, Supervision
from cairn.errors import CairnError
from cairn.supervision.child import ChildSpec, Launcher
from cairn.supervision.events import SupervisionEvent
from cairn.supervision.policy import Intensity
from cairn.supervision.supervisor import Supervisor
from schemas.cairn_msgs import ComponentStatus

_SILENCE_S = 3.0
"""Beyond its limit for one handler a child may be silent for so long: the machine may be busy."""


class Host(Protocol):
    """The supervisor's own place: its loop."""

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
    in reverse; those with `load: on_order` are loaded by `self.children.load(name)`. When too many
    restarts fall in the window, it fails itself, and its own supervisor decides.
    """

    is_supervisor: ClassVar[bool] = True
    clock_source: ClassVar[Literal["deployment", "system"]] = "system"

    component_status: In[ComponentStatus] = In(qos=LATCHED.with_depth(500), optional=True)

    children: Supervisor

    def adopt(
        self,
        specs: Mapping[str, ComponentSpec],
        supervision: Supervision,
        launcher: Launcher,
        host: Host,
    ) -> None:
        """Take over the children of the deployment; called by the placement before `configure`."""
        self._specs = specs
        self._host = host
        self._heartbeats: dict[str, _Heartbeat] = {}
        self.children = Supervisor(
            self.name,
            [child_spec(name, spec) for name, spec in specs.items()],
            launcher,
            observe=self._observe,
            progress=lambda what, _limit_s: host.progress(what),
            strategy=supervision.strategy,
            intensity=Intensity(supervision.max_restarts, supervision.within_s),
        )

    def on_activate(self) -> None:
        """Start the children."""
        self.children.start_all()
        self._see_to_the_end()

    def on_deactivate(self) -> None:
        """Stop the children."""
        self.children.stop_all()

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
        getattr(self.children, verb)(name)
        states = {status.name: status.state for status in self.children.status()}
        return states[name]

    def child_changed(self) -> None:
        """Have the children seen to soon; from any thread, when one of them has ended."""
        self._host.post(self._reconcile)

    @on("component_status")
    def hear(self, status: ComponentStatus) -> None:
        """Keep the heartbeat of a child."""
        if status.component in self._specs:
            self._heartbeats[status.component] = _Heartbeat(status, time.monotonic())

    @every(hz=2)
    def watch(self) -> None:
        """Find children that hang: one handler for too long, or no sign of life."""
        for child in self.children.status():
            beat = self._heartbeats.get(child.name)
            if child.state != "active" or beat is None:
                continue
            if beat.status.restarts + 1 != child.incarnation or beat.status.state != "active":
                continue
            self._judge(child.name, child.incarnation, beat)
        self._reconcile()

    def _judge(self, name: str, incarnation: int, beat: _Heartbeat) -> None:
        spec = self._specs[name]
        silent_s = time.monotonic() - beat.heard_at
        handler, busy_s = beat.status.handler, beat.status.handler_s
        limit_s = spec.hang_timeout_s
        if handler and not spec.children and busy_s > limit_s:
            self.children.child_hung(name, incarnation, handler, busy_s + silent_s)
        elif silent_s > limit_s + _SILENCE_S and spec.placement == "process":
            where = handler or "no handler, its process gives no sign of life"
            self.children.child_hung(name, incarnation, where, silent_s)

    def _reconcile(self) -> None:
        self.children.reconcile()
        self._see_to_the_end()

    def _see_to_the_end(self) -> None:
        if self.children.finished:
            self.finish(self.children.finished)

    def _observe(self, event: SupervisionEvent) -> None:
        reason = f": {event.reason}" if event.reason else ""
        text = f"{event.child} {event.what.replace('_', ' ')}{reason}"
        if event.what in ("start_failed", "hung", "given_up"):
            self.log.error("%s", text)
        elif event.what in ("ended", "stop_failed"):
            self.log.warning("%s", text)
        elif event.what in ("active", "stopped", "finished"):
            self.log.info("%s", text)
        else:
            self.log.debug("%s", text)


def child_spec(name: str, spec: ComponentSpec) -> ChildSpec:
    """A component of the deployment as its supervisor's engine sees it.

    A supervisor with something significant below it is significant itself: its normal end, which
    only that can bring about, is passed on upwards.
    """
    inherits = any(child_spec(*child).significant for child in spec.children.items())
    return ChildSpec(
        name=name,
        restart="transient" if inherits and spec.restart == "permanent" else spec.restart,
        significant=spec.significant or inherits,
        load=spec.load,
        start_timeout_s=spec.start_timeout_s,
        stop_timeout_s=spec.stop_timeout_s,
    )
