"""Runtime of one component: its life cycle, errors, requests and status, on a bus and a loop."""

import json
import logging
import os
import threading
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, cast

import numpy as np

from cairn.bus.bus import Bus, Node, full_name
from cairn.bus.qos import LATCHED, RELIABLE
from cairn.errors import CairnError, Escalate, LoggedFailure
from cairn.runtime.call_log import (
    CallLog,
    LoggedClock,
    LoggedScheduler,
    call_log_topic,
    request_record,
)
from cairn.runtime.call_records import Record, RecordKind, StartInfo
from cairn.runtime.component import Component
from cairn.runtime.input_files import input_files, path_parameters
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.lifecycle import (
    LifecycleState,
    RecoveryLimit,
    Transition,
    target_state,
    transition_event,
)
from cairn.runtime.loop import Scheduler
from cairn.runtime.node_services import (
    NodeService,
    ParameterServices,
    describe_type,
    serve_node,
)
from cairn.runtime.parameters import (
    COMMON_PARAMETERS,
    LOG_LEVEL,
    SERVICE_INTROSPECTION,
    Config,
    ParameterDescription,
    ParameterRejected,
    ReadPathMark,
    ServiceIntrospection,
    checked_common,
    describe_common,
    describe_parameters,
    marked_parameters,
    with_changes,
)
from cairn.runtime.port_table import PortTable
from cairn.runtime.process_exit import ExitReport
from cairn.runtime.rosout import wire_safe_text
from cairn.runtime.timers import CLOCK_TOPIC, ClockInput, ComponentTimers
from cairn.schemas.builtin_interfaces import from_ns
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.lifecycle_msgs.msg import TransitionEvent
from cairn.schemas.message import InvalidMessage
from cairn.schemas.std_msgs import Header
from cairn.schemas.type_description_interfaces.srv import GetTypeDescription
from cairn.system.clock import Clock, SimulatedClock, SystemClock

DISCOVERY_TIMEOUT_S = 2.0
"""Limit for the discovery barrier at activation; processes not reached are logged then."""


class Runtime:
    """Runs one component; only `status` and `post` may be called from any thread."""

    def __init__(
        self,
        component: type[Component],
        launch: LaunchRequest,
        bus: Bus,
        scheduler: Scheduler,
        system_clock: Clock,
        on_end: Callable[[ExitReport], None],
        handler_clock: Callable[[], float] = time.monotonic,
        clock_problem: Callable[[str], str] = lambda _: "",
    ) -> None:
        """Construct the component.

        Args:
            component: class of the component.
            launch: its part of the deployment, and which start this is.
            bus: the bus of its process.
            scheduler: makes its calls.
            system_clock: the system's clock, or lockstep time.
            on_end: called once, when the component has ended.
            handler_clock: time [s] in which the duration of handlers is measured, without pauses
                of the machine (`cairn.processes`).
            clock_problem: why stamps of the robot's machine of that name cannot be used, "" if they
                can.

        Raises `CairnError`, with component, plugin and cause, if it cannot be constructed.
        """
        self.launch = launch
        self.name = launch.name
        self.restarts = launch.restarts
        self.log = logging.getLogger(f"cairn.{launch.context.robot}.{launch.name}")
        self.config = _config(component, launch)
        self._common = {
            LOG_LEVEL: launch.spec.log_level or launch.context.log_level,
            SERVICE_INTROSPECTION: "off",
        }
        self.log.setLevel(self._common[LOG_LEVEL].upper())
        self.random = np.random.default_rng([launch.context.seed, zlib.crc32(launch.name.encode())])
        self.bus = bus
        self.scheduler = scheduler
        self._system_clock = system_clock
        self._on_end = on_end
        self._handler_clock = handler_clock
        self._clock_problem = clock_problem
        self._state = LifecycleState.UNCONFIGURED
        self._in_transition: Transition | None = None
        self._current_call: tuple[str, float] | None = None
        self._calling_thread = 0
        self._finishing: ExitReport | None = None
        self._reason = f"restarted: {launch.previous_exit}" if launch.previous_exit else ""
        self._problems: dict[str, str] = {}  # by subject; replaced, as other threads read it
        self._recovery_limit = RecoveryLimit()
        if component.clock_source == "device" and (
            launch.context.simulated_time or not isinstance(system_clock, SystemClock)
        ):
            raise CairnError(
                f"{self.name}: plugin {launch.spec.plugin} drives a device, which cannot follow "
                "simulated time; start the deployment without --lockstep and with `clock: system`, "
                "or put a simulated driver in its place"
            )
        simulated = launch.context.simulated_time and component.clock_source == "deployment"
        simulated_clock = SimulatedClock() if simulated else None
        self.clock: Clock = system_clock if simulated_clock is None else simulated_clock
        self.unlogged_clock = self.clock
        self.node = bus.node(
            full_name(launch.context.robot, launch.name), self.log.error, self.log.warning
        )
        self.call_log: CallLog | None = None
        start: Record = ()
        if launch.context.call_log and component.clock_source != "device":
            self.call_log = self._open_call_log()
            start = _start_record(launch, self.config)
            self.scheduler = LoggedScheduler(scheduler, self.call_log)
            if simulated_clock is None:  # otherwise the clock messages are logged
                self.clock = LoggedClock(system_clock, self.call_log)
        self._parameter_services: ParameterServices | None = None
        self._unlogged_scheduler = scheduler
        try:
            self._logged(start, self._construct, component, simulated_clock)
        except (Exception, SystemExit) as error:
            self.node.close()
            raise CairnError(
                f"{self.name}: plugin {launch.spec.plugin} cannot be constructed: {_text(error)}"
            ) from error
        self._open_node_services()

    @property
    def state(self) -> LifecycleState:
        """The primary state of the life cycle."""
        return self._state

    def schedule(self, at: int, call: Callable[[], None]) -> None:
        """Make the component's `call` at `at` [ns] of its clock."""
        name = getattr(call, "__name__", "scheduled call")
        self._timers.at(at, partial(self.run, name, call))

    def post(self, call: Callable[[], None]) -> None:
        """Make the component's `call` among its handlers; from any thread."""
        name = getattr(call, "__name__", "posted call")
        self.scheduler.post(partial(self.run, name, call))

    def finish(self, reason: str, *, success: bool = True) -> None:
        """End normally once the current handler returns."""
        self._finishing = ExitReport(True, reason or "finished", success)

    def report_problem(self, subject: str, problem: str | None) -> None:
        """Add a problem to the component's status; None: it is solved."""
        others = {one: text for one, text in self._problems.items() if one != subject}
        self._problems = others if problem is None else {**others, subject: problem}

    def transition(self, transition: Transition) -> None:
        """Make one transition of the life cycle.

        Raises `CairnError` with the component's own error if it fails; the component is then
        either unconfigured again (its `on_error` recovered) or has ended.
        """
        self._logged((RecordKind.TRANSITION, transition.value), self._make_transition, transition)

    def _make_transition(self, transition: Transition) -> None:
        start, target = self._state, target_state(self._state, transition)
        self._in_transition = transition
        try:
            self._call(f"on_{transition}", self._step, transition)
        except _Failure as failure:
            self._in_transition = None
            self._fail(failure, last=transition is Transition.SHUTDOWN)
            why = self._reason.removeprefix(f"on_{transition}: ")
            raise CairnError(f"{self.name}: {transition} failed: {why}") from failure.error
        finally:
            self._in_transition = None
        self._state = target
        if self._transitions.has_subscribers:
            event = transition_event(self._system_clock.now(), transition, start, target)
            self._transitions.publish(event)
        if transition is Transition.SHUTDOWN:
            self._ended(self._finishing or ExitReport(True, "shut down"))
        else:
            self.heartbeat.publish()
            self._finish_if_requested()

    def set_parameters(self, changes: Mapping[str, Any]) -> None:
        """Change live parameters, all or none; `ParameterRejected` names the one and the reason."""
        own = {name: value for name, value in changes.items() if name not in COMMON_PARAMETERS}
        common = {
            name: checked_common(name, changes.get(name, value))
            for name, value in self._common.items()
        }
        new = with_changes(self.config, own)
        if own:
            self._check_live(new)
            self.component.on_parameters(new)
            self.config = new
            self.component.config = new
        self._common = common
        self.log.setLevel(common[LOG_LEVEL].upper())
        self._ports.introspect(cast("ServiceIntrospection", common[SERVICE_INTROSPECTION]))
        self.log.info("parameters changed: %s", dict(changes))
        if self._parameter_services is not None:
            self._parameter_services.publish_change(list(changes))

    def _check_live(self, new: Config) -> None:
        live = self.component.live_parameters
        if live is None:
            return
        fixed = [
            name
            for name in type(new).model_fields
            if name not in live and getattr(new, name) != getattr(self.config, name)
        ]
        if fixed:
            only = f", or change only {', '.join(sorted(live))}" if live else ""
            raise ParameterRejected(
                f"{self.name}: {', '.join(fixed)} cannot change while it runs; change the "
                f"deployment, and restart it{only}"
            )

    def request(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        """Return the reply to a control request; raises `CairnError` if it is rejected or fails."""
        if verb in set(Transition):
            self.transition(Transition(verb))
            return self._state.value
        if verb == "parameters":
            described = self._described_parameters()
            return [
                {name: value for name, value in vars(parameter).items() if name != "range"}
                for parameter in described
            ]
        if self.call_log is None:
            return self._answer(verb, arguments)
        return self._logged(request_record(verb, arguments), self._answer, verb, arguments)

    def _described_parameters(self) -> list[ParameterDescription]:
        return [*describe_parameters(self.config), *describe_common(self._common)]

    def _answer(self, verb: str, arguments: Mapping[str, Any]) -> Any:
        try:
            if verb == "set_parameters":
                return self._call("on_parameters", self.set_parameters, arguments)
            return self._call(f"on_request {verb}", self.component.on_request, verb, arguments)
        except _Failure as failure:
            if isinstance(failure.error, CairnError):
                raise failure.error from failure.error.__cause__
            self.log.error("request %s failed", verb, exc_info=failure.error)
            raise CairnError(f"{self.name}: {verb} failed: {_text(failure.error)}") from failure
        finally:
            self._finish_if_requested()

    def run(self, where: str, call: Callable[..., None], *arguments: Any) -> None:
        """Make one call into the component if it is active; an exception fails the component."""
        if self.call_log is not None and not self.call_log.in_call:
            record = (RecordKind.HOST, getattr(call, "__name__", ""))
            self.call_log.call(record, self.run, where, call, *arguments)
            return
        if self._state is not LifecycleState.ACTIVE:
            return
        if self._in_transition is not None:  # while it deactivates, it handles the pending messages
            self._call(where, call, *arguments)
            return
        try:
            self._call(where, call, *arguments)
        except _Failure as failure:
            if self._fail(failure):
                self.scheduler.post(self._recover)
        self._finish_if_requested()

    def publish_heartbeat(self) -> None:
        """Publish the status and, every second time, the logged calls; from any thread."""
        self.heartbeat.publish()
        self._heartbeats += 1
        if self.call_log is not None and self._heartbeats % 2 == 0:
            self.call_log.flush()

    def progress(self, what: str) -> None:
        """Report progress of a long call, so that it does not count as hung.

        No effect on another thread than that of the call.
        """
        if self._current_call is not None and self._calling_thread == threading.get_ident():
            self._current_call = (what, self._handler_clock())

    def status(self) -> ComponentStatus:
        """Return the component's current status; from any thread."""
        call = self._current_call
        return ComponentStatus(
            header=Header(stamp=from_ns(self._system_clock.now()), frame_id=""),
            component=self.name,
            machine=self.launch.context.machine,
            plugin=self.launch.spec.plugin,
            parent=self.launch.parent,
            placement=self.launch.placement,
            state=self._state.value,
            pid=os.getpid(),
            handler=call[0] if call else "",
            handler_s=self._handler_clock() - call[1] if call else 0.0,
            restarts=self.restarts,
            reason=wire_safe_text(
                "; ".join([*filter(None, [self._reason]), *self._problems.values()])
            ),
            children=tuple(self.launch.spec.children),
            ports=self._ports.status(),
        )

    @property
    def may_publish(self) -> bool:
        """Whether messages may be sent: an inactive component publishes nothing."""
        return self._state is LifecycleState.ACTIVE or self._in_transition is Transition.ACTIVATE

    def _construct(
        self, component: type[Component], simulated_clock: SimulatedClock | None
    ) -> None:
        simulated = simulated_clock is not None
        self._timers = ComponentTimers(self.clock, self.scheduler, self.log, simulated=simulated)
        self.component = component(self)
        self.component.config = self.config
        robot, topics = self.launch.context.robot, self.launch.spec.topics
        self._ports = PortTable(self.component, self, self._clock_problem)
        self._clock_input: ClockInput | None = None
        if simulated_clock is not None:
            topic = full_name(robot, topics.get(CLOCK_TOPIC, CLOCK_TOPIC))
            self._clock_input = ClockInput(
                simulated_clock,
                self.node,
                topic,
                self.scheduler,
                self._on_clock_set,
                self.log.error,
            )
        self.heartbeat = StatusPublisher(self.node, robot, self.status)
        self._heartbeats = 0

    def _step(self, transition: Transition) -> None:
        match transition:
            case Transition.CONFIGURE:
                self._ports.advertise()
                if self._clock_input is not None:
                    self._clock_input.open()
                self.component.on_configure()
            case Transition.ACTIVATE:
                self._ports.subscribe()
                unreached = self.bus.wait_for_peers(DISCOVERY_TIMEOUT_S)
                if unreached:
                    self.log.warning(
                        "activated without having discovered all processes, whose messages may "
                        "be missing: no answer from %s; `ps PID` on its computer shows its "
                        "component, which must be restarted if it hangs",
                        ", ".join(unreached),
                    )
                if self.call_log is not None:
                    self.call_log.connected()
                self.component.on_activate()
                self._ports.watch_ages()
                self._timers.start(
                    (period, partial(self.run, name, call))
                    for name, period, call in self._ports.timers()
                )
            case Transition.DEACTIVATE:
                self._deactivate()
            case Transition.CLEANUP:
                self._ports.reset()
                self.component.on_cleanup()
            case Transition.SHUTDOWN:
                if self._state is LifecycleState.ACTIVE:
                    self._deactivate()
                    self._state = LifecycleState.INACTIVE
                if self._state is not LifecycleState.UNCONFIGURED:
                    self.component.on_cleanup()
                self.component.on_shutdown()

    def serve_node(self, name: str, services: Sequence[NodeService]) -> None:
        """Serve services below the node of that full name, in every state, until the end."""
        serve_node(self.node, name, self._unlogged_scheduler, services)

    def _open_node_services(self) -> None:
        """Open the services and topics that every node of ROS 2 has; they are not logged."""
        name = full_name(self.launch.context.robot, self.name)
        self._parameter_services = ParameterServices(
            self.node,
            name,
            self._system_clock,
            self._described_parameters,
            lambda changes: self.request("set_parameters", changes),
            simulated_time=self.launch.context.simulated_time,
        )
        services = [
            *self._parameter_services.services(),
            NodeService("get_type_description", GetTypeDescription, describe_type),
        ]
        self.serve_node(name, services)
        self._transitions = self.node.advertise(
            f"{name}/transition_event", TransitionEvent, RELIABLE, shared=True
        )

    def _on_clock_set(self) -> None:
        if self.call_log is not None:
            self.call_log.clock_set(self.clock.now())
        self._timers.on_clock_set()

    def _deactivate(self) -> None:
        self._ports.drain()
        self.component.on_deactivate()
        self._ports.unsubscribe()
        self._timers.stop()
        self._problems = {}

    def _logged(self, record: Record, call: Callable[..., Any], *arguments: Any) -> Any:
        """Make one call, and log it."""
        if self.call_log is None:
            return call(*arguments)
        return self.call_log.call(record, call, *arguments)

    def _open_call_log(self) -> CallLog:
        topic = full_name(self.launch.context.robot, call_log_topic(self.name))
        return CallLog(self.node, topic, self.name, self.launch.incarnation, self._system_clock)

    def _call(self, where: str, call: Callable[..., Any], *arguments: Any) -> Any:
        """Make one call, shown in the status; an exception in it becomes a `_Failure`."""
        self._calling_thread = threading.get_ident()
        outer, self._current_call = self._current_call, (where, self._handler_clock())
        try:
            return call(*arguments)
        except _Failure:  # of a handler called within
            raise
        except Exception as error:
            raise _Failure(where, error) from error
        except SystemExit as error:
            exit_error = CairnError(f"it called sys.exit({error.code}); use self.finish(reason)")
            raise _Failure(where, exit_error) from error
        finally:
            self._current_call = outer

    def _finish_if_requested(self) -> None:
        if (
            self._finishing is not None
            and self._in_transition is None
            and self._state is not LifecycleState.FINALIZED
        ):
            with suppress(CairnError):  # `_fail` has logged the error, and ended
                self.transition(Transition.SHUTDOWN)

    def _fail(self, failure: "_Failure", *, last: bool = False) -> bool:
        # The cause of an escalation is a child, not the handler that noticed it.
        where = "" if isinstance(failure.error, Escalate) else f"{failure.where}: "
        self._reason = f"{where}{self._describe_error(failure.error)}"
        level = logging.WARNING if isinstance(failure.error, LoggedFailure) else logging.ERROR
        self.log.log(level, "%s", self._reason, exc_info=failure.error)
        self._finishing = None
        self._ports.unsubscribe()
        self._timers.stop()
        recovered = False
        try:
            recovered = self._call("on_error", self.component.on_error, failure.error)
        except _Failure as second:
            self.log.error("on_error failed: %s", _text(second.error), exc_info=second.error)
        if recovered and not last and self._recovery_limit.allow(self._recovery_time(), self.log):
            self._state = LifecycleState.UNCONFIGURED
            self._ports.reset()
            self.heartbeat.publish()
            return True
        self._state = LifecycleState.FINALIZED
        self._ended(ExitReport(False, self._reason))
        return False

    def _recovery_time(self) -> int:
        time = self._system_clock.now()
        if self.call_log is not None:
            self.call_log.add(RecordKind.TIME, time)
        return time

    def _describe_error(self, error: Exception) -> str:
        if isinstance(error, MemoryError):
            limit_mib = self.launch.spec.memory_max_mib
            words = _text(error).removesuffix(": ")
            return f"{words}; its process has reached its limit (memory_max_mib: {limit_mib})"
        ports = (
            self._ports.outputs_with(error.type_name) if isinstance(error, InvalidMessage) else []
        )
        for_port = f" (for port {' or '.join(ports)})" if ports else ""
        return f"{_text(error)}{for_port}"

    def _recover(self) -> None:
        if self._state is not LifecycleState.UNCONFIGURED:
            return  # another transition was requested meanwhile
        try:
            self.transition(Transition.CONFIGURE)
            if self.state is not LifecycleState.FINALIZED:
                self.transition(Transition.ACTIVATE)
        except CairnError as error:
            self.log.error("recovery failed: %s", error)
            self.scheduler.post(self._recover)  # until `RecoveryLimit` is reached
        else:
            self.log.info("recovered")

    def _ended(self, end: ExitReport) -> None:
        self._reason = end.reason
        try:
            self.heartbeat.publish()
            self.heartbeat.close()
            if self.call_log is not None:
                report = {"normal": end.normal, "reason": end.reason}
                self.call_log.add(RecordKind.ENDED, json.dumps(report))
                self.call_log.flush(last=True)
            self.node.close()
        finally:
            self.scheduler.stop()
            self._on_end(end)


class _Failure(Exception):
    def __init__(self, where: str, error: Exception) -> None:
        super().__init__(where)
        self.where = where
        self.error = error


def _config(component: type[Component], launch: LaunchRequest) -> Config:
    try:
        return component.config_class().model_validate(dict(launch.spec.parameters))
    except ValueError as error:
        raise CairnError(f"{launch.name}: invalid parameters: {error}") from error


def _start_record(launch: LaunchRequest, config: Config) -> Record:
    """Return the record with what is needed to construct a component again as it was launched."""
    context, spec = launch.context, launch.spec
    info = StartInfo(
        name=launch.name,
        plugin=spec.plugin,
        parameters=spec.parameters,
        topics=spec.topics,
        max_age_s=spec.max_age_s,
        children=tuple(spec.children),
        incarnation=launch.incarnation,
        robot=context.robot,
        seed=context.seed,
        simulated_time=context.simulated_time,
        lockstep=context.lockstep,
        paths={name: str(path) for name, path in path_parameters(config).items()},
        read_paths=tuple(read.name for read in marked_parameters(config, ReadPathMark)),
        files=tuple(input_files(config)),
    )
    return (RecordKind.START, json.dumps(info.model_dump(), default=str))


def _text(error: BaseException) -> str:
    return str(error) if isinstance(error, CairnError) else f"{type(error).__name__}: {error}"


STATUS_TOPIC = "component_status"


class StatusPublisher:
    """Publishes a component's status, latched; from the component's thread and its host's."""

    def __init__(self, node: Node, robot: str, status: Callable[[], ComponentStatus]) -> None:
        topic = full_name(robot, STATUS_TOPIC)
        self._publisher = node.advertise(topic, ComponentStatus, LATCHED, shared=True)
        self._status = status
        self._lock = threading.Lock()
        self._open = True

    def publish(self) -> None:
        """Publish the current status."""
        with self._lock:
            if self._open:
                self._publisher.publish(self._status())

    def close(self) -> None:
        """Stop publishing."""
        with self._lock:
            self._open = False
