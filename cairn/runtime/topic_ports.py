"""The inputs and outputs of one running component: they deliver and publish, and count."""

from collections.abc import Callable
from dataclasses import fields
from functools import partial
from typing import Any, NamedTuple

from cairn.bus.bus import Node, Publisher, Subscription
from cairn.bus.exclusive import Exclusive
from cairn.runtime.call_log import CallLog
from cairn.runtime.call_records import RecordKind
from cairn.runtime.loop import Scheduler
from cairn.runtime.port_owner import PortOwner
from cairn.runtime.ports import BoundIn, BoundOut, PortSpec
from cairn.schemas.cairn_msgs import PortStatus
from cairn.schemas.message import InvalidMessage


class _Counts(NamedTuple):
    """Numbers of messages of one input port."""

    received: int = 0
    dropped: int = 0
    invalid: int = 0
    refused: int = 0


def has_stamp(message: type[Any]) -> bool:
    """Return whether messages of a class carry the time of what they describe."""
    return any(one.name == "header" for one in fields(message))


class InputPort:
    """An input of the component."""

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
        clock_problem: Callable[[], str] | None = None,
    ) -> None:
        """`clock_problem` returns why messages with a stamp are refused now, "" if they are not."""
        self.bound: BoundIn[Any] = BoundIn(spec, topic)
        self._spec = spec
        self._topic = topic
        self._owner = owner
        self._node = node
        self._exclusive = exclusive
        self._call_log = call_log
        self._clock_problem = clock_problem if has_stamp(spec.message) else None
        self._refused = 0  # because of the clock of their publisher's machine
        self._wake = partial(scheduler.deliver, self._on_wake_up)
        self._calls = [(f"{name} (port {spec.name})", call) for name, call in calls]
        self._subscription: Subscription | None = None
        # The subscription to count, and the counts before it; one tuple, read by other threads.
        self._counted: tuple[Subscription | None, _Counts] = (None, _Counts())

    def open(self) -> None:
        """Receive from now on."""
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
        """Handle the messages that are pending."""
        # Not more than the port's depth: a publisher faster than the handlers must not keep the
        # component from deactivating.
        for _ in range(self._spec.qos.depth):
            if not self._deliver():
                return

    def close(self) -> None:
        """Receive nothing more."""
        if self._subscription is not None:
            self._subscription.close()
            self._subscription = None
            self._counted = (None, self._counts())

    def status(self) -> PortStatus:
        """Return the counters."""
        counts = self._counts()
        return PortStatus(
            port=self._spec.name,
            topic=self._topic,
            direction=PortStatus.IN,
            messages=counts.received,
            dropped=counts.dropped,
            invalid=counts.invalid,
            refused=counts.refused + self._refused,
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
        if self._clock_problem is not None and (problem := self._clock_problem()):
            self._refuse(problem)
            return True
        if self._call_log is not None:
            self._call_log.took(self._spec.name, self._subscription.taken)
        self.bound.set_latest(message)
        for where, call in self._calls:
            self._owner.run(where, call, message)
        return True

    def _refuse(self, problem: str) -> None:
        self._refused += 1
        if self._refused & (self._refused - 1) == 0:  # the 1st, 2nd, 4th, 8th ...
            self._owner.log.error(
                "port %s: refused message on %s (%d so far): %s",
                self._spec.name, self._topic, self._refused, problem,
            )  # fmt: skip

    def _log_invalid(self, error: InvalidMessage) -> None:
        count = self._counts().invalid
        if count & (count - 1) == 0:  # the 1st, 2nd, 4th, 8th ... do not flood the log
            self._owner.log.error(
                "port %s: rejected invalid message on %s (%d so far): %s",
                self._spec.name, self._topic, count, error,
            )  # fmt: skip


class OutputPort:
    """An output of the component."""

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
        """Publish from now on."""
        if self._publisher is None:
            self._publisher = self._node.advertise(
                self._topic, self.spec.message, self.spec.qos, self._exclusive
            )
            self._counted = (self._publisher, self._counted[1])
            if self._call_log is not None:
                self._call_log.add(RecordKind.OPENED, self.spec.name, self._publisher.gid)

    def close(self) -> None:
        """Publish nothing more."""
        if self._publisher is not None:
            self._publisher.close()
            self._publisher = None
            self._counted = (None, self._sent())

    def status(self) -> PortStatus:
        """Return the counters."""
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
