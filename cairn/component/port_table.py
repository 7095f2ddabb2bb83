"""The ports of one running component: advertised, subscribed, delivered and counted."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, Protocol

from cairn.bus.bus import Node, Publisher, Subscription, full_name
from cairn.component.component import Component
from cairn.component.handlers import PortHandler, TimerHandler, handlers_of
from cairn.component.loop import Scheduler
from cairn.component.ports import BoundIn, BoundOut, PortSpec, ports_of
from schemas.cairn_msgs import PortStatus
from schemas.message import InvalidMessage


class Owner(Protocol):
    """What the ports need of the component's runtime."""

    log: Any

    @property
    def may_publish(self) -> bool:
        """Whether messages may leave now."""
        ...

    def run(self, where: str, call: Callable[..., None], *arguments: Any) -> None:
        """Make one call into the component."""
        ...


class PortTable:
    """Binds the ports declared by a component's class to the bus."""

    def __init__(
        self,
        component: Component,
        owner: Owner,
        node: Node,
        scheduler: Scheduler,
        robot: str,
        topics: Mapping[str, str],
    ) -> None:
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
            topic = full_name(robot, topics.get(spec.name, spec.name))
            if spec.direction == "in":
                calls = [
                    (name, getattr(component, name))
                    for name, handler in handlers.items()
                    if isinstance(handler, PortHandler) and handler.port == spec.name
                ]
                port = _Input(spec, topic, owner, node, scheduler, calls)
                setattr(component, spec.name, port.bound)
                self._inputs.append(port)
            else:
                output = _Output(component.name, spec, topic, owner, node)
                setattr(component, spec.name, output.bound)
                self._outputs.append(output)

    def advertise(self) -> None:
        """Announce the outputs."""
        for output in self._outputs:
            output.open()

    def subscribe(self) -> None:
        """Begin to receive."""
        for port in self._inputs:
            port.open()

    def drain(self) -> None:
        """Handle what waits already."""
        for port in self._inputs:
            port.drain()

    def unsubscribe(self) -> None:
        """Cease to receive."""
        for port in self._inputs:
            port.close()

    def forget(self) -> None:
        """Withdraw the outputs and forget what was received."""
        for output in self._outputs:
            output.close()
        for port in self._inputs:
            port.bound.handled(None)

    def timers(self) -> Iterator[tuple[str, int, Callable[[], None]]]:
        """The periodic handlers: name, period [ns], method."""
        yield from self._timers

    def status(self) -> tuple[PortStatus, ...]:
        """The counters of every port."""
        return (
            *(port.status() for port in self._inputs),
            *(output.status() for output in self._outputs),
        )


class _Input:
    def __init__(
        self,
        spec: PortSpec,
        topic: str,
        owner: Owner,
        node: Node,
        scheduler: Scheduler,
        calls: list[tuple[str, Callable[..., None]]],
    ) -> None:
        self.bound: BoundIn[Any] = BoundIn(spec, topic)
        self._spec = spec
        self._topic = topic
        self._owner = owner
        self._node = node
        self._wake = partial(scheduler.deliver, self._woken)
        self._calls = [(f"{name} (port {spec.name})", call) for name, call in calls]
        self._subscription: Subscription | None = None
        self._past = [0, 0, 0]

    def open(self) -> None:
        if self._subscription is None:
            self._subscription = self._node.subscribe(
                self._topic, self._spec.message, self._spec.qos, self._wake
            )

    def drain(self) -> None:
        while self._deliver():
            pass

    def close(self) -> None:
        if self._subscription is not None:
            self._past = self._counts()
            self._subscription.close()
            self._subscription = None

    def status(self) -> PortStatus:
        received, dropped, invalid = self._counts()
        return PortStatus(
            port=self._spec.name,
            topic=self._topic,
            direction=PortStatus.IN,
            messages=received,
            dropped=dropped,
            invalid=invalid,
        )

    def _counts(self) -> list[int]:
        now = self._subscription
        if now is None:
            return self._past
        return [
            past + new
            for past, new in zip(self._past, (now.received, now.dropped, now.invalid), strict=True)
        ]

    def _woken(self) -> None:
        self._deliver()

    def _deliver(self) -> bool:
        if self._subscription is None:
            return False
        try:
            message = self._subscription.take()
        except InvalidMessage as error:
            self._complain(error)
            return True
        if message is None:
            return False
        self.bound.handled(message)
        for where, call in self._calls:
            self._owner.run(where, call, message)
        return True

    def _complain(self, error: InvalidMessage) -> None:
        count = self._counts()[2]
        if count & (count - 1) == 0:  # the 1st, 2nd, 4th, 8th ...: told, never flooding the log
            self._owner.log.error(
                "port %s: message on %s refused (%d so far): %s",
                self._spec.name, self._topic, count, error,
            )  # fmt: skip


class _Output:
    def __init__(
        self, component: str, spec: PortSpec, topic: str, owner: Owner, node: Node
    ) -> None:
        self.bound: BoundOut[Any] = BoundOut(component, spec, topic, self._send)
        self._spec = spec
        self._topic = topic
        self._owner = owner
        self._node = node
        self._publisher: Publisher | None = None
        self._past = 0

    def open(self) -> None:
        if self._publisher is None:
            self._publisher = self._node.advertise(self._topic, self._spec.message, self._spec.qos)

    def close(self) -> None:
        if self._publisher is not None:
            self._past += self._publisher.published
            self._publisher.close()
            self._publisher = None

    def status(self) -> PortStatus:
        sent = self._past + (self._publisher.published if self._publisher is not None else 0)
        return PortStatus(
            port=self._spec.name,
            topic=self._topic,
            direction=PortStatus.OUT,
            messages=sent,
            dropped=0,
            invalid=0,
        )

    def _send(self, message: Any) -> None:
        if self._publisher is not None and self._owner.may_publish:
            self._publisher.publish(message)
