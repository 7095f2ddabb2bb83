"""A running deployment in the hands of a test: reads and writes its topics, asks, and does harm."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar

import zenoh

from cairn.bus import keys
from cairn.bus.bus import full_name
from cairn.bus.control import request
from cairn.bus.qos import RELIABLE, Qos
from cairn.bus.session import open_peer
from cairn.bus.zenoh_bus import ZenohBus
from cairn.clock import to_ns
from cairn.schemas.cairn_msgs import ComponentStatus
from cairn.schemas.message import type_name
from cairn.schemas.rosgraph_msgs import Clock
from cairn.testing.launching import LIMIT_S, Run
from cairn.testing.reading import MANY, RETAINED, Reading

M = TypeVar("M")

START_LIMIT_S = 120.0
"""The first start after an installation may compile kernels, which takes about a minute."""

_STATUS = "component_status"
_REQUEST_S = 15.0
_SETTLE_S = 20.0


class Robot:
    """A run of `cairn up` whose components are all active, joined over the bus.

    Names of topics and components are below the robot's namespace unless they begin with `/`.
    """

    def __init__(self, run: Run, name: str = "robot", limit_s: float = START_LIMIT_S) -> None:
        """Wait until all components that are loaded at the start are active.

        Raises `AssertionError` with all that `cairn up` said if that is not so within the limit.
        """
        run.await_line(" active$", limit_s=limit_s)  # of the first: the router answers by now
        self.run = run
        self.name = name
        self._bus = ZenohBus(open_peer([run.endpoint]))
        self._node = self._bus.node("/conformance", self._complain)
        self._publishers: dict[str, Any] = {}
        self._now: Callable[[int], int] = _system
        self._changed = threading.Condition()
        self._statuses: dict[str, ComponentStatus] = {}
        with self._changed:
            topic = full_name(name, _STATUS)
            many = RETAINED.with_depth(1000)
            self._heartbeats = self._node.subscribe(topic, ComponentStatus, many, self._hear)
        self.settle()
        # The root is active when all its children are, and they when theirs are.
        self.await_state("root", "active", limit_s)
        clock = full_name(name, "clock")
        if clock in self.topics(Clock):
            self._now = _Told(self.read("clock", Clock))

    def settle(self) -> None:
        """Wait until every process of the deployment and this one know of each other's ports."""
        unreached = self._bus.wait_for_peers(_SETTLE_S)
        assert not unreached, f"not reached within {_SETTLE_S:g} s: {unreached}; {self.run}"

    def close(self) -> None:
        """Leave the bus; the deployment runs on."""
        self._bus.close()

    def topics(self, message: type[Any]) -> set[str]:
        """The topics (full names) that somebody writes with this type of message."""
        wanted = type_name(message)
        return {end.topic for end in self._writers() if end.type_name == wanted}

    def writers(self, topic: str) -> set[str]:
        """The components (full names) that write a topic now."""
        full = full_name(self.name, topic)
        return {end.node.name for end in self._writers() if end.topic == full}

    def read(
        self, topic: str, message: type[M], keep: Callable[[M], M] = lambda message: message
    ) -> Reading[M]:
        """Follow a topic; if it is latched, with what was sent before.

        `keep` makes messages smaller that are not needed whole, such as images.
        """
        full = full_name(self.name, topic)
        kinds = {end.qos.durability for end in self._writers() if end.topic == full}
        qos = RETAINED if "transient_local" in kinds else MANY
        reading = Reading(self._node, full, message, qos, lambda at: self._now(at), keep)
        self.settle()
        return reading

    @contextmanager
    def order(self, topics: Mapping[str, type[Any]]) -> Iterator[list[tuple[str, Any]]]:
        """The messages of several topics, in the order in which they come; whole at the end.

        Readings of different topics may overtake one another: each has a thread of its own.
        """
        session, codec = self._bus.session, self._bus.codec
        came: list[tuple[str, bytes]] = []
        found: list[tuple[str, Any]] = []

        def following(topic: str) -> Any:
            return lambda sample: came.append((topic, sample.payload.to_bytes()))

        subscribers = [
            session.declare_subscriber(
                self._key(topic, message),
                zenoh.handlers.Callback(following(topic), indirect=False),
            )
            for topic, message in topics.items()
        ]
        try:
            yield found
        finally:
            for subscriber in subscribers:
                subscriber.undeclare()
        found += [(topic, codec.decode(topics[topic], data)) for topic, data in came]

    def send(self, topic: str, message: Any, qos: Qos = RELIABLE) -> None:
        """Publish a message; whoever reads the topic now gets it."""
        full = full_name(self.name, topic)
        if full not in self._publishers:
            self._publishers[full] = self._node.advertise(full, type(message), qos)
            self.settle()
        self._publishers[full].publish(message)

    @contextmanager
    def sending(self, topic: str, message: Any, hz: float = 20.0) -> Iterator[None]:
        """Publish a message at once and then again and again, as long as the context lasts."""
        self.send(topic, message)
        over = threading.Event()

        def repeat() -> None:
            while not over.wait(1.0 / hz):
                self.send(topic, message)

        thread = threading.Thread(target=repeat, name=f"sends {topic}", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            thread.join(LIMIT_S)

    def send_bytes(self, topic: str, message: type[Any], data: bytes) -> None:
        """Put bytes on the topic of a message type, such as no port would send."""
        attachment = keys.Attachment(1, time.time_ns(), os.urandom(16))
        self._bus.session.put(self._key(topic, message), data, attachment=attachment.encode())

    def encoded(self, message: Any) -> bytes:
        """A message as it travels: CDR, little endian, with its header of 4 bytes."""
        return bytes(self._bus.codec.encode(message))

    def status(self, component: str) -> ComponentStatus:
        """What the component told of itself last, at most a quarter of a second ago.

        Raises `AssertionError` if there is no such component.
        """
        return self.await_status(component, lambda _: True, "there")

    def await_status(
        self,
        component: str,
        so: Callable[[ComponentStatus], bool],
        what: str,
        limit_s: float = LIMIT_S,
    ) -> ComponentStatus:
        """Wait until a component tells what is wanted of it."""

        def found() -> bool:
            return component in self._statuses and so(self._statuses[component])

        with self._changed:
            there = self._changed.wait_for(found, limit_s)
            last = self._statuses.get(component)
        assert there, f"{component} is not {what} within {limit_s:g} s, but {last}; {self.run}"
        assert last is not None
        return last

    def await_state(self, component: str, state: str, limit_s: float = LIMIT_S) -> None:
        """Wait until a component tells that it is in a state of the life cycle."""
        self.await_status(component, lambda status: status.state == state, state, limit_s)

    def request(
        self, component: str, verb: str, limit_s: float = _REQUEST_S, **arguments: Any
    ) -> Any:
        """What a component answers to a request (life cycle, parameters, its own).

        Raises `ControlError` with the component's error if it rejects the request; `NoReplyError`
        if no reply arrives.
        """
        return request(
            self._bus.session,
            self._bus.domain,
            full_name(self.name, component),
            verb,
            arguments,
            timeout_s=limit_s,
        )

    def parameters(self, component: str) -> dict[str, dict[str, Any]]:
        """A component's parameters by name: value, type, bounds, description."""
        return {entry["name"]: entry for entry in self.request(component, "parameters")}

    def set_parameters(self, component: str, changes: Mapping[str, Any]) -> None:
        """Change parameters, all or none; raises `ControlError` with the words of a refusal."""
        self.request(component, "set_parameters", **changes)

    def restart(self, component: str, limit_s: float = LIMIT_S) -> None:
        """Have a component stopped and started anew by its supervisor; it is active then."""
        self._order("restart", component, limit_s)

    def unload(self, component: str, limit_s: float = LIMIT_S) -> None:
        """Have a component stopped by its supervisor, and left so."""
        self._order("unload", component, limit_s)

    def load(self, component: str, limit_s: float = LIMIT_S) -> None:
        """Have a component that is not loaded started by its supervisor; it is active then."""
        self._order("load", component, limit_s)

    def kill(self, component: str, number: signal.Signals = signal.SIGKILL) -> None:
        """Send a signal to a component's process."""
        os.kill(self.run.pid_of(component), number)

    @contextmanager
    def hanging(self, component: str) -> Iterator[None]:
        """Have a component's process do nothing any more (SIGSTOP), until the context ends."""
        pid = self.run.pid_of(component)
        os.kill(pid, signal.SIGSTOP)
        try:
            yield
        finally:
            if pid in self.run.pids():  # else its supervisor has killed it meanwhile
                os.kill(pid, signal.SIGCONT)

    def _order(self, verb: str, component: str, limit_s: float) -> None:
        supervisor = self.status(component).parent
        self.request(supervisor, verb, limit_s, name=component)

    def _key(self, topic: str, message: type[Any]) -> str:
        full = full_name(self.name, topic)
        return keys.message_key(self._bus.domain, full, message, self._bus.codec)

    def _writers(self) -> list[keys.EndpointEntity]:
        found: list[keys.EndpointEntity] = []
        end = self._bus.graph.watch(found.append)
        end()
        return [endpoint for endpoint in found if endpoint.kind == "MP"]

    def _hear(self) -> None:
        with self._changed:
            status = self._heartbeats.take()
            if status is not None:
                self._statuses[status.component] = status
                self._changed.notify_all()

    def _complain(self, complaint: str) -> None:
        raise AssertionError(complaint)


class _Told:
    """The deployment's time where it is simulated: the last that topic `clock` told."""

    def __init__(self, reading: Reading[Clock]) -> None:
        self._reading = reading
        reading.await_count(1)

    def __call__(self, _: int) -> int:
        return to_ns(self._reading.arrivals[-1].message.clock)


def _system(at_ns: int) -> int:
    return at_ns
