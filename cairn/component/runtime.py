"""Runs one component: joins it to the bus, its clock and its loop, and walks its life cycle."""

import logging
import os
import time
import zlib
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from cairn.bus.bus import Bus, full_name
from cairn.clock import Clock, SimulatedClock, from_ns
from cairn.component.clock_input import TOPIC, ClockInput
from cairn.component.component import Component
from cairn.component.lifecycle import State, Transition, goal
from cairn.component.loop import Scheduler
from cairn.component.parameters import Config, changed, describe
from cairn.component.port_table import PortTable
from cairn.component.status import StatusPublisher
from cairn.component.timers import Timers
from cairn.errors import CairnError
from schemas.cairn_msgs import ComponentStatus
from schemas.std_msgs import Header

SETTLE_LIMIT_S = 2.0
RECOVERIES = 3
RECOVERY_WINDOW_S = 10.0


@dataclass(frozen=True)
class Assignment:
    """What a component is told about itself by its deployment."""

    name: str
    plugin: str
    robot: str = "robot"
    parent: str = ""
    placement: str = "process"
    parameters: Mapping[str, Any] = field(default_factory=dict)
    topics: Mapping[str, str] = field(default_factory=dict)
    simulated_time: bool = False
    seed: int = 0
    restarts: int = 0
    children: tuple[str, ...] = ()


@dataclass(frozen=True)
class End:
    """How a component ended: normally (it finished, or was told to stop), or by a failure."""

    normal: bool
    reason: str


class Runtime:
    """One running component. All methods but `status` belong to the scheduler's thread."""

    def __init__(
        self,
        component: type[Component],
        assignment: Assignment,
        bus: Bus,
        scheduler: Scheduler,
        system_clock: Clock,
        on_end: Callable[[End], None],
    ) -> None:
        """Construct the component; `CairnError` names it, its plugin and what went wrong."""
        self.assignment = assignment
        self.name = assignment.name
        self.log = logging.getLogger(f"cairn.{assignment.robot}.{assignment.name}")
        self.config = _config(component, assignment)
        self.random = np.random.default_rng([assignment.seed, zlib.crc32(assignment.name.encode())])
        self._bus = bus
        self._scheduler = scheduler
        self._system_clock = system_clock
        self._on_end = on_end
        self._state = State.UNCONFIGURED
        self._busy: tuple[str, float] | None = None
        self._finish_reason: str | None = None
        self._reason = ""
        self._recoveries: deque[float] = deque(maxlen=RECOVERIES)
        self._timers = Timers()
        simulated = assignment.simulated_time and component.clock_source == "deployment"
        told = SimulatedClock() if simulated else None
        self.clock: Clock = system_clock if told is None else told
        self._scheduler.bind(self._run_due)
        self.node = bus.node(full_name(assignment.robot, assignment.name), self.log.error)
        try:
            self.component = component(self)
        except Exception as error:
            self.node.close()
            raise CairnError(
                f"{self.name}: plugin {assignment.plugin} cannot be constructed: {_text(error)}"
            ) from error
        self.component.config = self.config
        robot = assignment.robot
        self._ports = PortTable(
            self.component, self, self.node, scheduler, robot, assignment.topics
        )
        self._clock_input: ClockInput | None = None
        if told is not None:
            topic = full_name(robot, assignment.topics.get(TOPIC, TOPIC))
            self._clock_input = ClockInput(
                told, self.node, topic, scheduler, self._time_moved, self.log.error
            )
        self.heartbeat = StatusPublisher(self.node, robot, self.status)

    @property
    def state(self) -> State:
        """The primary state of the life cycle."""
        return self._state

    def schedule(self, at: int, call: Callable[[], None]) -> None:
        """Have the component's `call` made at `at` [ns] of its clock."""
        name = getattr(call, "__name__", "scheduled call")
        self._timers.at(at, lambda: self.run(name, call))
        self._arm()

    def finish(self, reason: str) -> None:
        """End normally once the current handler returns."""
        self._finish_reason = reason

    def transition(self, transition: Transition) -> None:
        """Walk one step of the life cycle.

        Raises `CairnError` with the component's own error if it fails; the component is then
        either unconfigured again (its `on_error` recovered) or has ended.
        """
        end = goal(self._state, transition)
        try:
            self._step(transition)
        except Exception as error:
            text = self._fail(f"on_{transition}", error, retry=False)
            raise CairnError(f"{self.name}: {transition} failed: {text}") from error
        self._state = end
        if transition is Transition.SHUTDOWN:
            self._ended(End(True, self._reason or "shut down"))
        else:
            self.heartbeat.publish()

    def set_parameters(self, changes: Mapping[str, Any]) -> None:
        """Change live parameters, all or none; `ParameterRefused` says which and why."""
        new = changed(self.config, changes)
        self.component.on_parameters(new)
        self.config = new
        self.component.config = new
        self.log.info("parameters changed: %s", dict(changes))

    def request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Answer a control request; raises `CairnError` when it cannot be done."""
        if verb in set(Transition):
            self.transition(Transition(verb))
            return self._state.value
        if verb == "parameters":
            return [vars(parameter) for parameter in describe(self.config)]
        try:
            if verb == "set_parameters":
                return self.set_parameters(arguments)
            return self.component.on_request(verb, arguments)
        except CairnError:
            raise
        except Exception as error:
            self.log.exception("request %s failed", verb)
            raise CairnError(f"{self.name}: {verb} failed: {_text(error)}") from error

    def run(self, where: str, call: Callable[..., None], *arguments: Any) -> None:
        """Make one call into the component if it is active; an exception fails the component."""
        if self._state is not State.ACTIVE:
            return
        self._busy = (where, time.monotonic())
        try:
            call(*arguments)
        except Exception as error:
            self._fail(where, error, retry=True)
        finally:
            self._busy = None
        if self._finish_reason is not None and self._state is State.ACTIVE:
            self._reason, self._finish_reason = self._finish_reason, None
            self.transition(Transition.SHUTDOWN)

    def progress(self, what: str) -> None:
        """Tell the watch that a long call gets on: it is not hung."""
        self._busy = (what, time.monotonic())

    def _time_moved(self, back: bool) -> None:
        """Run what simulated time has made due; `back` means that time was set back."""
        if back:
            self.log.warning("time on topic clock was set back; periodic calls start anew")
            self._timers.clear()
            if self._state is State.ACTIVE:
                self._start_timers()
        self._run_due()

    def status(self) -> ComponentStatus:
        """The component's status now; from any thread."""
        busy = self._busy
        return ComponentStatus(
            header=Header(stamp=from_ns(self._system_clock.now()), frame_id=""),
            component=self.name,
            plugin=self.assignment.plugin,
            parent=self.assignment.parent,
            placement=self.assignment.placement,
            state=self._state.value,
            pid=os.getpid(),
            handler=busy[0] if busy else "",
            handler_s=time.monotonic() - busy[1] if busy else 0.0,
            restarts=self.assignment.restarts,
            reason=self._reason,
            children=self.assignment.children,
            ports=self._ports.status(),
        )

    @property
    def may_publish(self) -> bool:
        """Whether messages leave the component: an inactive component publishes nothing."""
        return self._state is State.ACTIVE or self._busy_with(Transition.ACTIVATE)

    def _step(self, transition: Transition) -> None:
        self._busy = (f"on_{transition}", time.monotonic())
        try:
            match transition:
                case Transition.CONFIGURE:
                    self._ports.advertise()
                    if self._clock_input is not None:
                        self._clock_input.open()
                    self.component.on_configure()
                case Transition.ACTIVATE:
                    self._ports.subscribe()
                    self.component.on_activate()
                    self._start_timers()
                    unreached = self._bus.settle(SETTLE_LIMIT_S)
                    if unreached:
                        self.log.warning("no link yet to %s", ", ".join(unreached))
                case Transition.DEACTIVATE:
                    self._deactivate()
                case Transition.CLEANUP:
                    self._ports.forget()
                    self.component.on_cleanup()
                case Transition.SHUTDOWN:
                    if self._state is State.ACTIVE:
                        self._deactivate()
                    if self._state is not State.UNCONFIGURED:
                        self.component.on_cleanup()
                    self.component.on_shutdown()
        finally:
            self._busy = None

    def _deactivate(self) -> None:
        self._ports.drain()
        self.component.on_deactivate()
        self._ports.unsubscribe()
        self._timers.clear()

    def _busy_with(self, transition: Transition) -> bool:
        return self._busy is not None and self._busy[0] == f"on_{transition}"

    def _start_timers(self) -> None:
        now = self.clock.now()
        for name, period, call in self._ports.timers():
            self._timers.every(now + period, period, self.clock.now, partial(self.run, name, call))
        self._arm()

    def _run_due(self) -> None:
        now = self.clock.now()
        while (call := self._timers.pop_due(now)) is not None:
            call()
        self._arm()

    def _arm(self) -> None:
        due = self._timers.next_due()
        if due is not None and self.clock is self._system_clock:
            self._scheduler.wake_at(due)

    def _fail(self, where: str, error: Exception, *, retry: bool) -> str:
        text = _text(error)
        self._reason = f"{where}: {text}"
        self.log.error("%s failed: %s", where, text, exc_info=error)
        self._ports.unsubscribe()
        self._timers.clear()
        recovered = False
        try:
            recovered = self.component.on_error(error)
        except Exception as second:
            self.log.exception("on_error failed as well: %s", _text(second))
        if recovered and self._may_recover():
            self._state = State.UNCONFIGURED
            if retry:
                self._scheduler.post(self._recover)
        else:
            self._state = State.FINALIZED
            self._ended(End(False, self._reason))
        return text

    def _may_recover(self) -> bool:
        now = time.monotonic()
        often = len(self._recoveries) == RECOVERIES
        if often and now - self._recoveries[0] < RECOVERY_WINDOW_S:
            self.log.error("%d recoveries within %g s: ends", RECOVERIES, RECOVERY_WINDOW_S)
            return False
        self._recoveries.append(now)
        return True

    def _recover(self) -> None:
        for transition in (Transition.CONFIGURE, Transition.ACTIVATE):
            try:
                self.transition(transition)
            except CairnError as error:
                self.log.error("recovery failed: %s", error)
                return
        self.log.info("recovered")

    def _ended(self, end: End) -> None:
        self._reason = end.reason
        self.heartbeat.publish()
        self.heartbeat.close()
        self.node.close()
        self._scheduler.stop()
        self._on_end(end)


def _config(component: type[Component], assignment: Assignment) -> Config:
    try:
        return component.config_class().model_validate(dict(assignment.parameters))
    except ValueError as error:
        raise CairnError(f"{assignment.name}: parameters refused: {error}") from error


def _text(error: Exception) -> str:
    return str(error) if isinstance(error, CairnError) else f"{type(error).__name__}: {error}"
