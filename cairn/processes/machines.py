"""The machines of a robot: what each root reports of itself, and which of them are lost.

The root of each machine publishes a `MachineStatus` four times a second, whatever its components
do. A machine that is silent counts as lost here, until it is heard again.
"""

import logging
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from cairn.bus import control
from cairn.bus.bus import Node, Subscription, full_name
from cairn.bus.qos import LATCHED, RELIABLE
from cairn.bus.zenoh_bus import ZenohBus
from cairn.deployment.machines import (
    RemoteInput,
    components_by_machine,
    machine_status_topic,
)
from cairn.deployment.model import Deployment, root_name
from cairn.errors import CairnError
from cairn.processes.child import ChildUnavailable
from cairn.processes.machine_clocks import ClockOffset, ClockOffsetFilter
from cairn.processes.supervisor import ChildGroup, Supervisor
from cairn.runtime.launch_request import RunContext
from cairn.schemas.builtin_interfaces import from_ns, to_ns
from cairn.schemas.cairn_msgs import MachineChild, MachineLink, MachineStatus
from cairn.schemas.message import InvalidMessage
from cairn.schemas.std_msgs import Header

if TYPE_CHECKING:
    from cairn.processes.component_process import ComponentHost

LOST_AFTER_S: Final = 1.25
"""A machine counts as lost when nothing of it has arrived for so long: five of its messages."""

_PERIOD_S = 0.2  # the main loop turns four times a second, or more often
_MOST_NAMED = 20  # inputs in one line of the log
_LONGEST_REASON = 1000


class RobotMachines:
    """What the roots of a robot's other machines report; from any thread."""

    def __init__(
        self, bus: ZenohBus, node: Node, context: RunContext, now: Callable[[], float]
    ) -> None:
        """Listen as `node`; `now` is the time [s] in which this process could run."""
        self._bus = bus
        self._context = context
        self._now = now
        self._began = now()
        self._news = threading.Condition()
        self._heard: dict[str, tuple[float, int, MachineStatus]] = {}
        self._clocks: dict[str, ClockOffsetFilter] = {}
        self._subscriptions: dict[str, Subscription] = {}
        for machine in context.machines:
            if machine != context.machine:
                topic = machine_status_topic(context.robot, machine, context.machines[0])
                self._subscriptions[machine] = node.subscribe(
                    topic, MachineStatus, RELIABLE, partial(self._receive, machine)
                )

    def silent_s(self, machine: str) -> float:
        """Return for how long nothing of a machine has arrived [s]."""
        heard = self._heard.get(machine)
        return self._now() - (self._began if heard is None else heard[0])

    def was_heard(self, machine: str) -> bool:
        """Return whether anything of a machine has ever arrived."""
        return machine in self._heard

    def is_up(self, machine: str) -> bool:
        """Return whether a machine is heard."""
        return machine in self._heard and self.silent_s(machine) < LOST_AFTER_S

    def silence(self, machine: str) -> str:
        """Return why a machine counts as lost, "" if it is up."""
        if self.is_up(machine):
            return ""
        if machine not in self._heard:
            return f"machine {machine} cannot be reached"
        return f"machine {machine} has been silent for {self.silent_s(machine):.1f} s"

    def child(self, machine: str, name: str) -> MachineChild | None:
        """Return what the root of a machine has last reported of its child of that name."""
        heard = self._heard.get(machine)
        children = () if heard is None else heard[2].children
        return next((one for one in children if one.name == name), None)

    def last_status(self, machine: str) -> tuple[int, int] | None:
        """Return when a machine has sent its last status [ns, its clock], and its receipt here."""
        heard = self._heard.get(machine)
        return None if heard is None else (to_ns(heard[2].header.stamp), heard[1])

    def clock_offset(self, machine: str) -> ClockOffset | None:
        """Return how far a machine's clock is ahead of the one here; None if it is not known."""
        clock = self._clocks.get(machine)
        return None if clock is None else clock.estimate(time.monotonic())

    def round_trip_s(self, machine: str) -> float | None:
        """Return how long the last exchange with a machine took [s]; None before the first."""
        clock = self._clocks.get(machine)
        return None if clock is None else clock.round_trip_s

    def request(
        self, machine: str, verb: str, arguments: Mapping[str, Any], timeout_s: float
    ) -> "Future[Any]":
        """Make a request of the root of a machine; see `Machines` of `remote_child`."""
        context = self._context
        component = full_name(context.robot, root_name(machine, context.machines[0]))
        answer: Future[Any] = Future()

        def call() -> None:
            try:
                reply = control.request(
                    self._bus.session, context.domain, component, verb, arguments,
                    timeout_s=timeout_s,
                )  # fmt: skip
            except control.NoReplyError as error:
                answer.set_exception(ChildUnavailable(str(error)))
            except CairnError as error:
                answer.set_exception(error)
            else:
                answer.set_result(reply)
            with self._news:
                self._news.notify_all()

        threading.Thread(target=call, name=f"cairn {verb} {machine}", daemon=True).start()
        return answer

    def wait_for_news(self, timeout_s: float) -> None:
        """Wait until a root reports something, or answers, at most `timeout_s` [s]."""
        with self._news:
            self._news.wait(timeout_s)

    def _receive(self, machine: str) -> None:
        # It may be called before the subscription has been returned: the next one follows soon.
        subscription = self._subscriptions.get(machine)
        while subscription is not None:
            try:
                status = subscription.take()
            except InvalidMessage:
                continue  # of a foreign publisher
            if status is None:
                return
            received_ns = time.time_ns()
            self._measure_clock(machine, status, received_ns)
            with self._news:
                self._heard[machine] = (self._now(), received_ns, status)
                self._news.notify_all()

    def _measure_clock(self, machine: str, status: MachineStatus, received_ns: int) -> None:
        own = next((one for one in status.links if one.machine == self._context.machine), None)
        if own is None or not (t1_ns := to_ns(own.last_sent)):
            return
        t2_ns, t3_ns = to_ns(own.last_received), to_ns(status.header.stamp)
        clock = self._clocks.setdefault(machine, ClockOffsetFilter())
        clock.add(t1_ns, t2_ns, t3_ns, received_ns, time.monotonic())


class MachineMonitor:
    """A root's view of the other machines: publishes its status, and logs which are lost."""

    def __init__(
        self, root: "ComponentHost", deployment: Deployment, inputs: Sequence[RemoteInput]
    ) -> None:
        """`inputs` are all that cross between the machines."""
        runtime, context = root.runtime, root.runtime.launch.context
        assert isinstance(runtime.component, Supervisor)
        self._children = runtime.component.children
        self._machine = context.machine
        self._machines = root.machines()
        self._lost = {one: False for one in deployment.machines if one != context.machine}
        self._components = components_by_machine(deployment)
        self._tolerance_s = deployment.clock_tolerance_s
        self._clocks_off: set[str] = set()
        self._published_at = -math.inf
        self._inputs = [one for one in inputs if one.reader_machine == context.machine]
        self._log = runtime.log
        topic = machine_status_topic(context.robot, context.machine, context.machines[0])
        self._publisher = runtime.node.advertise(topic, MachineStatus, LATCHED)

    def check(self) -> None:
        """Log the machines that are lost or found since the last call, and publish the status."""
        for machine, was_lost in self._lost.items():
            # One that was never heard counts as lost only then: it may just be starting.
            is_lost = self._machines.silent_s(machine) >= LOST_AFTER_S
            self._lost[machine] = is_lost
            if is_lost and not was_lost:
                level = logging.WARNING if self._machines.was_heard(machine) else logging.INFO
                self._log.log(level, "%s", self._described(machine))
            elif was_lost and not is_lost:
                self._log.info("machine found: %s", machine)
            self._check_clock(machine)
        now = time.monotonic()
        if now - self._published_at >= _PERIOD_S:
            self._published_at = now
            self._publish()

    def _check_clock(self, machine: str) -> None:
        clock = self._machines.clock_offset(machine)
        is_off = clock is not None and clock.exceeds(self._tolerance_s)
        if is_off and machine not in self._clocks_off:
            assert clock is not None
            self._log.error(
                "clock differs: %s: %s, more than clock_tolerance_s, %g s: what it publishes with "
                "a stamp is refused here; synchronize the clocks, see `cairn doctor`",
                machine, clock, self._tolerance_s,
            )  # fmt: skip
            self._clocks_off.add(machine)
        elif not is_off and clock is not None and machine in self._clocks_off:
            self._log.info("clock agrees: %s: %s", machine, clock)
            self._clocks_off.remove(machine)

    def _described(self, machine: str) -> str:
        missing = self._missing(machine)
        named = "; ".join(missing[:_MOST_NAMED]) or "nothing"
        more = f"; {len(missing) - _MOST_NAMED} more" if len(missing) > _MOST_NAMED else ""
        event = "machine lost" if self._machines.was_heard(machine) else "waiting for machine"
        silence = self._machines.silence(machine)
        return f"{event}: {machine}: {silence}; missing here: {named}{more}"

    def _publish(self) -> None:
        self._publisher.publish(
            MachineStatus(
                header=Header(stamp=from_ns(time.time_ns())),
                machine=self._machine,
                children=tuple(
                    MachineChild(one.name, one.state, one.incarnation, one.reason[:_LONGEST_REASON])
                    for one in ChildGroup.status(self._children)  # which is not a call of the root
                ),
                links=tuple(self._link(machine, lost) for machine, lost in self._lost.items()),
            )
        )

    def _link(self, machine: str, is_lost: bool) -> MachineLink:
        sent_ns, received_ns = self._machines.last_status(machine) or (0, 0)
        clock = self._machines.clock_offset(machine)
        return MachineLink(
            machine=machine,
            is_up=not is_lost,
            silent_s=max(0.0, self._machines.silent_s(machine)),
            last_sent=from_ns(sent_ns),
            last_received=from_ns(received_ns),
            clock_offset=math.nan if clock is None else clock.offset_s,
            clock_error=math.nan if clock is None else clock.error_s,
            components=self._components[machine] if is_lost else (),
            inputs=tuple(self._missing(machine)) if is_lost else (),
        )

    def _missing(self, machine: str) -> list[str]:
        return [str(one) for one in self._inputs if one.writer_machine == machine]
