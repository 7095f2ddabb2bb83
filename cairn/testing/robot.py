"""A running deployment in a test: reads and publishes topics, sends requests, injects failures."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import zenoh

from cairn.bus import keys
from cairn.bus.bus import Node, Subscription, full_name
from cairn.bus.control import ControlError, request
from cairn.bus.graph import read_graph
from cairn.bus.qos import LATCHED, RELIABLE, Qos
from cairn.bus.session import open_client, open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.runtime.lifecycle import STATE_AFTER
from cairn.schemas.builtin_interfaces import to_ns
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.message import InvalidMessage, type_name
from cairn.schemas.rosgraph_msgs import Clock
from cairn.system.closing import Closing
from cairn.testing.launching import LIMIT_S, Run, launching, names_of

M = TypeVar("M")

START_LIMIT_S = 120.0
"""The first start after an installation may compile kernels, which takes about a minute."""

MESSAGE_LIMIT_S = 60.0
"""How long a message is awaited by default [s]: far longer than it takes."""

MANY = Qos("best_effort", "volatile", 1000)
"""A queue deep enough that no message is dropped while the test is busy."""

RETAINED = LATCHED.with_depth(100)
"""For latched topics: includes messages published before."""

_STATUS = "component_status"
_REQUEST_S = 15.0
_PEERS_S = 20.0
_STEPS = {"unconfigured": ("configure", "activate"), "inactive": ("activate",), "active": ()}


class RunningDeployment:
    """A run of `cairn up` whose components are all active, joined over the bus.

    Names of topics and components are below the robot's namespace unless they begin with `/`.
    """

    def __init__(self, run: Run, limit_s: float = START_LIMIT_S) -> None:
        """Wait until all components that are loaded at the start are active.

        Raises `AssertionError` with all output of `cairn up` if they are not active within
        `limit_s` [s].
        """
        run.await_line("child active: ", limit_s=limit_s)  # of the first: the router replies by now
        names = names_of(Path(run.arguments[0]), run.arguments[1:])
        self.run = run
        self.name = names.robot
        """The robot's name in the deployment."""
        self._bus = ZenohBus(open_peer([run.endpoint]), names.domain)
        self._node = self._bus.node("/conformance", _raise)
        self._publishers: dict[str, Any] = {}
        self._clock: Reading[Clock] | None = None  # where the time is simulated
        self._changed = threading.Condition()
        self._statuses: dict[str, ComponentStatus] = {}
        try:
            self._join(limit_s)
        except BaseException:  # an open session at the interpreter's exit aborts the process
            self.close()
            raise

    def _join(self, limit_s: float) -> None:
        with self._changed:
            topic = full_name(self.name, _STATUS)
            many = RETAINED.with_depth(1000)
            self._heartbeats = self._node.subscribe(topic, ComponentStatus, many, self._on_status)
        self.wait_for_peers()
        # The root is active when all its children are, and they when theirs are.
        self.await_state("root", "active", limit_s)
        clock = full_name(self.name, "clock")
        if clock in self.topics(Clock):
            reading = self.read("clock", Clock)
            reading.await_count(1)
            self._clock = reading

    def wait_for_peers(self) -> None:
        """Wait until the deployment's processes and this one have discovered each other."""
        unreached = self._bus.wait_for_peers(_PEERS_S)
        assert not unreached, f"not reached within {_PEERS_S:g} s: {unreached}; {self.run}"

    def close(self) -> None:
        """Leave the bus; the deployment continues."""
        self._node.close()  # first: no handler is called while the session closes
        self._bus.close()

    def topics(self, message: type[Any]) -> set[str]:
        """Return the topics (full names) that are published with this type of message."""
        wanted = type_name(message)
        return {end.topic for end in self._endpoints() if end.type_name == wanted}

    def writers(self, topic: str) -> set[str]:
        """Return the components (full names) that publish a topic now."""
        full = full_name(self.name, topic)
        return {end.node.name for end in self._endpoints() if end.topic == full}

    def read(
        self, topic: str, message: type[M], keep: Callable[[M], M] = lambda message: message
    ) -> Reading[M]:
        """Subscribe to a topic; a latched one includes what was published before.

        `keep` reduces messages that are not needed whole, such as images.
        """
        full = full_name(self.name, topic)
        kinds = {end.qos.durability for end in self._endpoints() if end.topic == full}
        qos = RETAINED if "transient_local" in kinds else MANY
        reading = Reading(self._node, full, message, qos, self._now, keep)
        self.wait_for_peers()
        return reading

    @contextmanager
    def read_in_order(self, topics: Mapping[str, type[Any]]) -> Iterator[list[tuple[str, Any]]]:
        """Read several topics within the context; the list is complete after it.

        It has the messages in their order of arrival across topics. Separate readings would not:
        each has a thread of its own.
        """
        session, codec = self._bus.session, self._bus.codec
        received: list[tuple[str, bytes]] = []
        messages: list[tuple[str, Any]] = []

        def receiver(topic: str) -> Any:
            return lambda sample: received.append((topic, sample.payload.to_bytes()))

        subscribers = [
            session.declare_subscriber(
                self._key(topic, message),
                zenoh.handlers.Callback(receiver(topic), indirect=False),
            )
            for topic, message in topics.items()
        ]
        try:
            yield messages
        finally:
            for subscriber in subscribers:
                subscriber.undeclare()
        messages += [(topic, codec.decode(topics[topic], data)) for topic, data in received]

    def publish(self, topic: str, message: Any, qos: Qos = RELIABLE) -> None:
        """Publish a message; every present subscriber receives it."""
        full = full_name(self.name, topic)
        if full not in self._publishers:
            self._publishers[full] = self._node.advertise(full, type(message), qos)
            self.wait_for_peers()
        self._publishers[full].publish(message)

    @contextmanager
    def publishing(self, topic: str, message: Any, hz: float = 20.0) -> Iterator[None]:
        """Publish a message at once and then repeatedly, as long as the context lasts."""
        self.publish(topic, message)
        is_over = threading.Event()

        def repeat() -> None:
            while not is_over.wait(1.0 / hz):
                self.publish(topic, message)

        thread = threading.Thread(target=repeat, name=f"publishes {topic}", daemon=True)
        thread.start()
        try:
            yield
        finally:
            is_over.set()
            thread.join(LIMIT_S)

    def publish_bytes(self, topic: str, message: type[Any], data: bytes) -> None:
        """Publish bytes on the topic of a message type, also ones that no port would publish."""
        attachment = keys.Attachment(1, time.time_ns(), os.urandom(16))
        self._bus.session.put(self._key(topic, message), data, attachment=attachment.encode())

    def encoded(self, message: Any) -> bytes:
        """Return a message as it is sent: CDR, little endian, with its header of 4 bytes."""
        return bytes(self._bus.codec.encode(message))

    def status(self, component: str) -> ComponentStatus:
        """Return the last status of a component, at most a quarter of a second old.

        Raises `AssertionError` if there is no such component.
        """
        return self.await_status(component, lambda _: True, "present")

    def await_status(
        self,
        component: str,
        condition: Callable[[ComponentStatus], bool],
        what: str,
        limit_s: float = LIMIT_S,
    ) -> ComponentStatus:
        """Wait until `condition` holds of a component's status; return the status.

        Raises `AssertionError` that the component is not `what` within `limit_s` [s].
        """

        def holds() -> bool:
            return component in self._statuses and condition(self._statuses[component])

        with self._changed:
            in_time = self._changed.wait_for(holds, limit_s)
            last = self._statuses.get(component)
        assert in_time, (
            f"{component} is not {what} after {limit_s:g} s; {_last_heard(last)}; {self.run}"
        )
        assert last is not None
        return last

    def await_state(self, component: str, state: str, limit_s: float = LIMIT_S) -> None:
        """Wait until a component reports this state of its life cycle."""
        self.await_status(component, lambda status: status.state == state, state, limit_s)

    def await_active(
        self, component: str, *, other_than: int = 0, limit_s: float = LIMIT_S
    ) -> ComponentStatus:
        """Wait until a component reports, from now on, that it is active; return its status.

        An earlier status does not count: it may be that of a process that has ended. With
        `other_than`, neither does a status of the process with that id.
        """
        called = time.time_ns()
        return self.await_status(
            component,
            lambda status: (
                status.state == "active"
                and status.pid != other_than
                and to_ns(status.header.stamp) > called
            ),
            "active" if not other_than else "active in another process",
            limit_s,
        )

    def request(
        self, component: str, verb: str, limit_s: float = _REQUEST_S, **arguments: Any
    ) -> Any:
        """Return a component's reply to a request (life cycle, parameters, its own).

        A transition of the life cycle is requested of its supervisor, which holds the component in
        the new state until another one is requested. After it `status` reports that state.

        Raises `ControlError` with the component's reason if it rejects the request, `NoReplyError`
        if no reply arrives in time.
        """
        to = component
        if verb in STATE_AFTER:
            to = self.status(component).parent
            arguments = {"name": component, "state": STATE_AFTER[verb].value}
        reply = request(
            self._bus.session,
            self._bus.domain,
            full_name(self.name, to),
            "hold" if verb in STATE_AFTER else verb,
            arguments,
            timeout_s=limit_s,
        )
        if verb in STATE_AFTER:
            # The status is another message than the reply, and may arrive later.
            replied = time.time_ns()
            self.await_status(
                component,
                lambda status: (
                    status.state in (reply, "finalized") or to_ns(status.header.stamp) > replied
                ),
                f"{reply}, as it replied to {verb}",
            )
        return reply

    def parameters(self, component: str) -> dict[str, dict[str, Any]]:
        """Return a component's parameters by name: value, type, bounds, description."""
        return {entry["name"]: entry for entry in self.request(component, "parameters")}

    def set_parameters(self, component: str, changes: Mapping[str, Any]) -> None:
        """Change parameters, all or none; raises `ControlError` with the reason of a rejection."""
        self.request(component, "set_parameters", **changes)

    def restart(self, component: str, limit_s: float = LIMIT_S) -> None:
        """Have the supervisor restart a component; it is active afterwards."""
        self._request_of_supervisor("restart", component, limit_s)

    def unload(self, component: str, limit_s: float = LIMIT_S) -> None:
        """Have the supervisor stop a component, and leave it stopped."""
        self._request_of_supervisor("unload", component, limit_s)

    def load(self, component: str, limit_s: float = LIMIT_S) -> None:
        """Have the supervisor start a component that is not loaded; it is active afterwards."""
        self._request_of_supervisor("load", component, limit_s)

    def kill(self, component: str, number: signal.Signals = signal.SIGKILL) -> int:
        """Send a signal to a component's process; return the id of the process."""
        pid = self.run.pid_of(component)
        os.kill(pid, number)
        return pid

    @contextmanager
    def suspended(self, component: str) -> Iterator[None]:
        """Suspend a component's process (SIGSTOP) within the context."""
        pid = self.run.pid_of(component)
        os.kill(pid, signal.SIGSTOP)
        try:
            yield
        finally:
            if pid in self.run.pids():
                with suppress(ProcessLookupError):  # its supervisor may kill it at any moment
                    os.kill(pid, signal.SIGCONT)

    def _request_of_supervisor(self, verb: str, component: str, limit_s: float) -> None:
        supervisor = self.status(component).parent
        self.request(supervisor, verb, limit_s, name=component)

    def _key(self, topic: str, message: type[Any]) -> str:
        full = full_name(self.name, topic)
        return keys.message_key(self._bus.domain, full, message)

    def _now(self, at_ns: int) -> int:
        """Return the deployment's time at a system time: where simulated, the last on `clock`."""
        return at_ns if self._clock is None else to_ns(self._clock.arrivals[-1].message.clock)

    def _endpoints(self) -> list[keys.EndpointEntity]:
        """Return the publishers of the deployment."""
        with open_client([self.run.endpoint]) as session:
            found = read_graph(session, keys.endpoints_pattern(self._bus.domain, kind="MP"))
        return [endpoint for endpoint in found if isinstance(endpoint, keys.EndpointEntity)]

    def _on_status(self) -> None:
        with self._changed:
            status = self._heartbeats.take()
            if status is not None:
                self._statuses[status.component] = status
                self._changed.notify_all()


def _last_heard(status: ComponentStatus | None) -> str:
    if status is None:
        return "nothing was received from it"
    reason = f", {status.reason}" if status.reason else ""
    handler = f", in its handler {status.handler}" if status.handler else ""
    return f"its last status: {status.state}, process {status.pid}{handler}{reason}"


class Bench:
    """A deployment that is launched when it is first needed; a context manager.

    At the end of the context it is stopped, and nothing of it may be left running.
    """

    def __init__(
        self,
        folder: Path,
        deployment: str | Path,
        arguments: Sequence[str] = (),
        *,
        connect: str | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """`deployment` is a file, or a text with its keys; `arguments` are those of `cairn up`.

        `connect` is the endpoint of a router to join; by default the deployment opens its own.
        """
        self._deployment = deployment
        self._arguments = arguments
        self._connect = connect
        self._environment = environment
        self._stack = ExitStack()
        self._launch = self._stack.enter_context(launching(folder))
        self._robot: RunningDeployment | None = None
        self._start_error = ""
        self._inactive: dict[str, str] = {}
        self._components: tuple[str, ...] = ()

    def robot(self, component: str) -> RunningDeployment:
        """Return the running deployment, with that component active.

        If a test has left the component inactive, it is activated; if that fails, or the deployment
        has ended, it is launched again. Raises `AssertionError` if it does not start.
        """
        self.check_component(component)
        known = self._start_error or self._inactive.get(component, "")
        assert not known, known  # the same for every test of the contract: do not wait again
        if self._robot is not None and not _brought_back(self._robot, component):
            self.drop()
        if self._robot is None:
            run = self._launch(
                self._deployment,
                *self._arguments,
                connect=self._connect,
                environment=self._environment,
            )
            try:
                self._robot = RunningDeployment(run)
            except AssertionError as error:
                self._start_error = str(error)
                raise
            try:
                self._robot.await_state(component, "active")
            except AssertionError as error:
                self._inactive[component] = str(error)
                raise
        return self._robot

    @property
    def runs(self) -> list[Run]:
        """The launches so far."""
        return self._launch.runs

    def check_component(self, component: str, setting: str = "component") -> None:
        """Raise `AssertionError` if the deployment has no such component; `setting` names it."""
        if not self._components:
            file = self._deployment
            if not isinstance(file, Path):
                file = self._launch.write(file)
            self._components = names_of(file, self._arguments).components
        assert component in self._components, (
            f"{setting} = {component!r}: the deployment has no such component; it has "
            f"{', '.join(self._components)}"
        )

    def drop(self) -> None:
        """Kill the running deployment; the next call of `robot` launches it again."""
        robot, self._robot = self._robot, None
        if robot is not None:
            robot.close()
            if robot.run.process.poll() is None:
                robot.run.process.kill()
            robot.run.await_nothing_left()

    def __enter__(self) -> Bench:
        """Launch nothing yet."""
        return self

    def __exit__(self, *error: Any) -> None:
        """Stop the deployment, and check that nothing of it is left."""
        if self._robot is not None:
            self._robot.close()
        self._stack.__exit__(*error)


def settings(values: Mapping[str, object]) -> list[str]:
    """Return the arguments that give `cairn up` these settings."""
    return [word for name, value in values.items() for word in ("--set", _assigned(name, value))]


def _assigned(name: str, value: object) -> str:
    return f"{name}={json.dumps(value)}"  # JSON is YAML


def _brought_back(robot: RunningDeployment, component: str) -> bool:
    if robot.run.process.poll() is not None:
        return False
    try:
        for verb in _STEPS.get(robot.status(component).state, ()):
            robot.request(component, verb)
        robot.await_state(component, "active")
    except (AssertionError, ControlError):
        return False
    return True


@dataclass(frozen=True)
class Arrival(Generic[M]):
    """A message, its arrival [ns since 1970], and the deployment's time at its arrival [ns]."""

    message: M
    at_ns: int
    clock_ns: int


class Reading(Closing, Generic[M]):
    """Collects what is published on a topic until it is closed; `arrivals` grows."""

    def __init__(
        self,
        node: Node,
        topic: str,
        message: type[M],
        qos: Qos,
        clock: Callable[[int], int],
        keep: Callable[[M], M],
    ) -> None:
        """Subscribe; a topic without a publisher is not an error.

        `clock` returns the deployment's time at a system time; `keep` returns the part of
        a message to keep.
        """
        self.topic = topic
        self.arrivals: list[Arrival[M]] = []
        self.invalid: list[str] = []
        self._clock = clock
        self._keep = keep
        self._changed = threading.Condition()
        with self._changed:  # the first message may arrive before the subscription is known here
            self._subscription: Subscription = node.subscribe(topic, message, qos, self._receive)

    @property
    def messages(self) -> list[M]:
        """The messages received so far."""
        return [arrival.message for arrival in self.arrivals]

    @property
    def count(self) -> int:
        """How many messages were received so far: a mark, for `after`."""
        return len(self.arrivals)

    def await_count(
        self, count: int, *, after: int = 0, limit_s: float = MESSAGE_LIMIT_S
    ) -> list[Arrival[M]]:
        """Wait for `count` messages after the first `after`; return these.

        Raises `AssertionError` with the number received if they do not arrive within the limit.
        """

        def enough(arrivals: Sequence[Arrival[M]]) -> bool:
            return len(arrivals) >= count

        self.await_that(enough, f"{count} messages", after=after, limit_s=limit_s)
        return self.arrivals[after : after + count]

    def await_that(
        self,
        condition: Callable[[Sequence[Arrival[M]]], bool],
        what: str,
        *,
        after: int = 0,
        limit_s: float = MESSAGE_LIMIT_S,
    ) -> None:
        """Wait until `condition` holds of the messages after the first `after`.

        Raises `AssertionError` with `what` was awaited if it does not hold within the limit.
        """
        with self._changed:
            holds = self._changed.wait_for(lambda: condition(self.arrivals[after:]), limit_s)
            count = len(self.arrivals) - after
        damaged = f"; invalid: {self.invalid[-1]}" if self.invalid else ""
        assert holds, (
            f"{self.topic}: expected {what} within {limit_s:g} s, received {count}{damaged}"
        )

    def stays_silent(self, seconds: float) -> bool:
        """Return whether no message arrives within this time [s]."""
        before = self.count
        with self._changed:
            return not self._changed.wait_for(lambda: len(self.arrivals) > before, seconds)

    def await_silence(self, seconds: float, limit_s: float = MESSAGE_LIMIT_S) -> None:
        """Wait for `seconds` without a message; raise `AssertionError` after `limit_s` [s]."""
        deadline = time.monotonic() + limit_s
        while not self.stays_silent(seconds):
            assert time.monotonic() < deadline, (
                f"{self.topic}: published after {limit_s:g} s; expected {seconds:g} s of silence"
            )

    def close(self) -> None:
        """Unsubscribe; what was received is kept."""
        self._subscription.close()

    def _receive(self) -> None:
        at_ns = time.time_ns()
        with self._changed:
            try:
                message: Any = self._subscription.take()
            except InvalidMessage as error:
                self.invalid.append(str(error))
            else:
                if message is not None:
                    kept = self._keep(message)
                    self.arrivals.append(Arrival(kept, at_ns, self._clock(at_ns)))
            self._changed.notify_all()


def _raise(problem: str) -> None:
    raise AssertionError(problem)
