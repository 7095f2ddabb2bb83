"""The ports of one running component: publishes, subscribes, delivers messages, counts them."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple, Protocol

from cairn.bus.bus import Node, Publisher, Subscription, full_name
from cairn.bus.exclusive import Exclusive
from cairn.runtime.call_log import CallLog
from cairn.runtime.call_records import RecordKind
from cairn.runtime.component import Component
from cairn.runtime.launch_request import LaunchRequest
from cairn.runtime.loop import Scheduler
from cairn.runtime.ports import (
    BoundIn,
    BoundOut,
    PortHandler,
    PortSpec,
    TimerHandler,
    handlers_of,
    ports_of,
)
from cairn.schemas.cairn_msgs import PortStatus
from cairn.schemas.message import InvalidMessage, fields_of, type_name


class _Counts(NamedTuple):
    """Numbers of messages of one input port."""

    received: int = 0
    dropped: int = 0
    invalid: int = 0
    refused: int = 0


class PortOwner(Protocol):
    """What the ports need of the component's runtime."""

    log: Any

    @property
    def may_publish(self) -> bool:
        """Whether messages may be sent now."""
        ...

    def run(self, where: str, call: Callable[..., None], *arguments: Any) -> None:
        """Make one call into the component."""
        ...


class PortTable:
    """Binds the ports declared by a component's class to the bus."""

    def __init__(
        self,
        component: Component,
        owner: PortOwner,
        node: Node,
        scheduler: Scheduler,
        launch: LaunchRequest,
        call_log: CallLog | None = None,
    ) -> None:
        """Bind the ports; `launch` gives their topics, and the writers of exclusive ones."""
        self._component = component
        handlers = handlers_of(type(component))
        self._timers = [
            (name, handler.period_ns, getattr(component, name))
            for name, handler in handlers.items()
            if isinstance(handler, TimerHandler)
        ]
        self._inputs: list[_Input] = []
        self._outputs: list[_Output] = []
        for spec in ports_of(type(component)).values():
            name = launch.spec.topics.get(spec.name, spec.name)
            topic = full_name(launch.context.robot, name)
            exclusive = launch.exclusive(topic)
            if spec.direction == "in":
                calls = [
                    (name, getattr(component, name))
                    for name, handler in handlers.items()
                    if isinstance(handler, PortHandler) and handler.port == spec.name
                ]
                if not spec.exclusive:
                    exclusive = None
                elif exclusive is None and launch.context.exclusive_topics is not None:
                    owner.log.warning(
                        "port %s: accepts every publisher on %s, although it is exclusive: the "
                        "topic is listed under external_topics, and no component publishes it",
                        spec.name, topic,
                    )  # fmt: skip
                port = _Input(spec, topic, owner, node, scheduler, calls, exclusive, call_log)
                setattr(component, spec.name, port.bound)
                self._inputs.append(port)
            else:
                output = _Output(component.name, spec, topic, owner, node, exclusive, call_log)
                setattr(component, spec.name, output.bound)
                self._outputs.append(output)

    def advertise(self) -> None:
        """Open the publishers of the outputs."""
        for output in self._outputs:
            output.open()

    def subscribe(self) -> None:
        """Open the subscriptions of the inputs."""
        for port in self._inputs:
            port.open()

    def drain(self) -> None:
        """Handle the messages that are pending."""
        for port in self._inputs:
            port.drain()

    def unsubscribe(self) -> None:
        """Close the subscriptions."""
        for port in self._inputs:
            port.close()

    def reset(self) -> None:
        """Close the publishers and clear the latest messages."""
        for output in self._outputs:
            output.close()
        for port in self._inputs:
            port.bound.set_latest(None)

    def timers(self) -> Iterator[tuple[str, int, Callable[[], None]]]:
        """Yield the periodic handlers: name, period [ns], method."""
        yield from self._timers

    def outputs_with(self, message: str) -> list[str]:
        """Return the outputs whose messages have the type of that name, or a field of it."""
        return [
            output.spec.name for output in self._outputs if _contains(output.spec.message, message)
        ]

    def status(self) -> tuple[PortStatus, ...]:
        """Return the counters of every port."""
        return (
            *(port.status() for port in self._inputs),
            *(output.status() for output in self._outputs),
        )


class _Input:
    def __init__(
        self,
        spec: PortSpec,
        topic: str,
        owner: PortOwner,
        node: Node,
        scheduler: Scheduler,
        calls: list[tuple[str, Callable[..., None]]],
        exclusive: Exclusive | None,
        call_log: CallLog | None,
    ) -> None:
        self.bound: BoundIn[Any] = BoundIn(spec, topic)
        self._spec = spec
        self._topic = topic
        self._owner = owner
        self._node = node
        self._exclusive = exclusive
        self._call_log = call_log
        self._wake = partial(scheduler.deliver, self._on_wake_up)
        self._calls = [(f"{name} (port {spec.name})", call) for name, call in calls]
        self._subscription: Subscription | None = None
        # The subscription to count, and the counts before it; one tuple, read by other threads.
        self._counted: tuple[Subscription | None, _Counts] = (None, _Counts())

    def open(self) -> None:
        if self._subscription is None:
            self._subscription = self._node.subscribe(
                self._topic,
                self._spec.message,
                self._spec.qos,
                self._wake,
                self._exclusive,
                self._spec.max_bytes,
            )
            self._counted = (self._subscription, self._counted[1])

    def drain(self) -> None:
        # Not more than the port's depth: a publisher faster than the handlers must not keep the
        # component from deactivating.
        for _ in range(self._spec.qos.depth):
            if not self._deliver():
                return

    def close(self) -> None:
        if self._subscription is not None:
            self._subscription.close()
            self._subscription = None
            self._counted = (None, self._counts())

    def status(self) -> PortStatus:
        counts = self._counts()
        return PortStatus(
            port=self._spec.name,
            topic=self._topic,
            direction=PortStatus.IN,
            messages=counts.received,
            dropped=counts.dropped,
            invalid=counts.invalid,
            refused=counts.refused,
        )

    def _counts(self) -> _Counts:
        now, before = self._counted
        if now is None:
            return before
        return _Counts(
            before.received + now.received,
            before.dropped + now.dropped,
            before.invalid + now.invalid,
            before.refused + now.refused,
        )

    def _on_wake_up(self) -> None:
        self._deliver()

    def _deliver(self) -> bool:
        """Hand the oldest pending message to the handlers; return whether there was one."""
        if self._subscription is None:
            return False
        try:
            message = self._subscription.take()
        except InvalidMessage as error:
            self._log_invalid(error)
            return True
        if message is None:
            return False
        if self._call_log is not None:
            self._call_log.took(self._spec.name, self._subscription.taken)
        self.bound.set_latest(message)
        for where, call in self._calls:
            self._owner.run(where, call, message)
        return True

    def _log_invalid(self, error: InvalidMessage) -> None:
        count = self._counts().invalid
        if count & (count - 1) == 0:  # the 1st, 2nd, 4th, 8th ... do not flood the log
            self._owner.log.error(
                "port %s: rejected invalid message on %s (%d so far): %s",
                self._spec.name, self._topic, count, error,
            )  # fmt: skip


class _Output:
    def __init__(
        self,
        component: str,
        spec: PortSpec,
        topic: str,
        owner: PortOwner,
        node: Node,
        exclusive: Exclusive | None,
        call_log: CallLog | None,
    ) -> None:
        self.bound: BoundOut[Any] = BoundOut(
            component, spec, topic, self._send, self._has_subscribers
        )
        self.spec = spec
        self._topic = topic
        self._owner = owner
        self._node = node
        self._exclusive = exclusive
        self._call_log = call_log
        self._publisher: Publisher | None = None
        self._counted: tuple[Publisher | None, int] = (None, 0)

    def open(self) -> None:
        if self._publisher is None:
            self._publisher = self._node.advertise(
                self._topic, self.spec.message, self.spec.qos, self._exclusive
            )
            self._counted = (self._publisher, self._counted[1])
            if self._call_log is not None:
                self._call_log.add(RecordKind.OPENED, self.spec.name, self._publisher.gid)

    def close(self) -> None:
        if self._publisher is not None:
            self._publisher.close()
            self._publisher = None
            self._counted = (None, self._sent())

    def status(self) -> PortStatus:
        return PortStatus(
            port=self.spec.name,
            topic=self._topic,
            direction=PortStatus.OUT,
            messages=self._sent(),
        )

    def _sent(self) -> int:
        now, before = self._counted
        return before if now is None else before + now.published

    def _has_subscribers(self) -> bool:
        publisher = self._publisher
        if publisher is None or not self._owner.may_publish:
            return False
        subscribed = publisher.has_subscribers
        if self._call_log is not None:
            kind = RecordKind.HAS_SUBSCRIBERS if subscribed else RecordKind.NO_SUBSCRIBERS
            self._call_log.add(kind, self.spec.name)
        return subscribed

    def _send(self, message: Any) -> None:
        if self._publisher is None or not self._owner.may_publish:
            return
        sequence = self._publisher.publish(message)
        if self._call_log is None:
            return
        if sequence:
            self._call_log.add(RecordKind.SENT, self.spec.name, sequence)
        else:
            self._call_log.add(RecordKind.NOT_SENT, self.spec.name)


def _contains(message: type[Any], name: str) -> bool:
    return type_name(message) == name or any(
        isinstance(field.element, type) and _contains(field.element, name)
        for field in fields_of(message)
    )
