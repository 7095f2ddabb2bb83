"""The inputs and outputs of components: they deliver and publish messages, and count them."""

from collections.abc import Callable
from dataclasses import fields
from functools import partial
from typing import Any, ClassVar, Generic, Literal, NamedTuple, TypeVar

from cairn.bus.bus import Publisher, Subscription
from cairn.bus.exclusive import Exclusive
from cairn.bus.qos import RELIABLE, Qos
from cairn.errors import CairnError
from cairn.runtime.call_records import RecordKind
from cairn.runtime.component import ComponentContext
from cairn.runtime.port import Port, check_max_bytes, type_of
from cairn.schemas.cairn_msgs import PortStatus
from cairn.schemas.message import InvalidMessage, type_name

T = TypeVar("T")

_LONGEST_AGE_S = 3600.0


class _InputCounts(NamedTuple):
    """Numbers of messages of one input."""

    received: int = 0
    dropped: int = 0
    invalid: int = 0
    refused: int = 0


def has_stamp(message: type[Any]) -> bool:
    """Return whether messages of a class carry the time of what they describe."""
    return any(one.name == "header" for one in fields(message))


class In(Port, Generic[T]):
    """An input port, declared in the body of a component: `odom: In[Odometry] = In(qos=SENSOR)`.

    A bare annotation `odom: In[Odometry]` means `In()`. With `optional=True` the component works
    without a publisher, and the check of a deployment does not require one. With `exclusive=True`
    the port accepts only the messages of the one component whose output has its topic in the
    deployment; it refuses, counts and reports those of any other publisher. A message longer than
    `max_bytes` is rejected, counted and reported before it is decoded; by default the limit follows
    from the message type: 4 KiB for one of fixed length, 64 KiB with texts, 1 MiB with sequences,
    32 MiB with bytes, such as images and maps. An input without a message younger than `max_age_s`
    [s] is stale: the component logs and shows it, and `Component.on_stale` is called.
    """

    direction: ClassVar[Literal["in"]] = "in"

    def __init__(
        self,
        qos: Qos = RELIABLE,
        *,
        optional: bool = False,
        exclusive: bool = False,
        max_bytes: int | None = None,
        max_age_s: float | None = None,
    ) -> None:
        check_max_bytes("In", max_bytes)
        if max_age_s is not None and (qos.latched or not 0 < max_age_s <= _LONGEST_AGE_S):
            raise CairnError(
                f"In(max_age_s={max_age_s}): an age is above 0 and at most {_LONGEST_AGE_S:g} s, "
                "and not for a latched input, whose last message stays valid"
            )
        self.max_age_s = max_age_s
        self.qos = qos
        self.optional = optional
        self.exclusive = exclusive
        self.max_bytes = max_bytes
        self._latest: T | None = None
        self._refused = 0  # because of the clock of their publisher's machine
        self._subscription: Subscription | None = None
        # The subscription to count, and the counts before it; one tuple, read by other threads.
        self._counted: tuple[Subscription | None, _InputCounts] = (None, _InputCounts())

    @property
    def topic(self) -> str:
        """The topic that the port reads in this deployment; `CairnError` on a declaration."""
        return self._bound_name()

    @property
    def latest(self) -> T | None:
        """The last message handled, None before the first; `CairnError` on a declaration."""
        if (latest := self._latest) is None:
            self._bound_name()
        return latest

    def bind(
        self,
        context: ComponentContext,
        topic: str,
        calls: list[tuple[str, Callable[..., None]]],
        writer: Exclusive | None = None,
        clock_problem: Callable[[], str] | None = None,
    ) -> None:
        """Bind the port to a topic (full name), for the handlers `calls`: names and methods.

        Only messages of the `writer` are accepted, if there is one. `clock_problem` returns why
        messages with a stamp are refused now, "" if they are not.
        """
        self._bind(context, topic)
        self._calls = [(f"{name} (port {self.name})", call) for name, call in calls]
        self._writer = writer
        self._clock_problem = clock_problem if has_stamp(self.interface) else None
        self._wake = partial(context.scheduler.deliver, self._on_wake_up)

    def open(self) -> None:
        """Receive from now on."""
        if self._subscription is None:
            self._subscription = self._context.node.subscribe(
                self._full_name, self.interface, self.qos, self._wake, self._writer, self.max_bytes
            )
            self._counted = (self._subscription, self._counted[1])

    def drain(self) -> None:
        """Handle the messages that are pending."""
        # Not more than the port's depth: a publisher faster than the handlers must not keep the
        # component from deactivating.
        for _ in range(self.qos.depth):
            if not self._deliver():
                return

    def close(self) -> None:
        """Receive nothing more."""
        if self._subscription is not None:
            self._subscription.close()
            self._subscription = None
            self._counted = (None, self._counts())

    def forget(self) -> None:
        """Forget the latest message."""
        self._latest = None

    def status(self) -> PortStatus:
        """Return the counters."""
        counts = self._counts()
        return self._status(
            PortStatus.IN,
            counts.received,
            dropped=counts.dropped,
            invalid=counts.invalid,
            refused=counts.refused + self._refused,
        )

    def _counts(self) -> _InputCounts:
        now, before = self._counted
        if now is None:
            return before
        return _InputCounts(
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
            self._call_log.took(self.name, self._subscription.taken)
        self._latest = message
        for where, call in self._calls:
            self._context.run(where, call, message)
        return True

    def _refuse(self, problem: str) -> None:
        self._refused += 1
        if self._refused & (self._refused - 1) == 0:  # the 1st, 2nd, 4th, 8th ...
            self._context.log.error(
                "port %s: refused message on %s (%d so far): %s",
                self.name, self._full_name, self._refused, problem,
            )  # fmt: skip

    def _log_invalid(self, error: InvalidMessage) -> None:
        count = self._counts().invalid
        if count & (count - 1) == 0:  # the 1st, 2nd, 4th, 8th ... do not flood the log
            self._context.log.error(
                "port %s: rejected invalid message on %s (%d so far): %s",
                self.name, self._full_name, count, error,
            )  # fmt: skip


class Out(Port, Generic[T]):
    """An output port, declared in the body of a component: `pose: Out[PoseStamped]`.

    Its quality of service is given as a default: `map: Out[OccupancyGrid] = Out(qos=LATCHED)`. With
    `exclusive=True` the check of a deployment rejects any other component that publishes on its
    topic, also if what reads there is not part of the deployment.
    """

    direction: ClassVar[Literal["out"]] = "out"

    def __init__(self, qos: Qos = RELIABLE, *, exclusive: bool = False) -> None:
        self.qos = qos
        self.exclusive = exclusive
        self._publisher: Publisher | None = None
        # The publisher to count, and the count before it; one tuple, read by other threads.
        self._counted: tuple[Publisher | None, int] = (None, 0)

    @property
    def topic(self) -> str:
        """The topic that the port publishes on in this deployment; `CairnError` if declared."""
        return self._bound_name()

    @property
    def has_subscribers(self) -> bool:
        """Whether a message published now would be received; always True on a latched port.

        For messages that are costly to compute; just publish all others. Raises `CairnError` on a
        declaration.
        """
        publisher = self._publisher
        if publisher is None:
            self._bound_name()
            return False
        if not self._context.may_publish:
            return False
        subscribed = publisher.has_subscribers
        self._log_presence(subscribed)
        return subscribed

    def publish(self, message: T) -> None:
        """Send a message; an inactive component sends nothing.

        Raises `CairnError` if the message is of another type than the port's, or on a declaration.
        """
        if not isinstance(message, self.interface):
            raise CairnError(
                f"{self._context.name}: port {self.name} publishes {type_name(self.interface)}, "
                f"not {type_of(message)}"
            )
        publisher = self._publisher
        if publisher is None:
            self._bound_name()
            return
        if not self._context.may_publish:
            return
        sequence = publisher.publish(message)
        if self._call_log is None:
            return
        if sequence:
            self._call_log.add(RecordKind.SENT, self.name, sequence)
        else:
            self._call_log.add(RecordKind.NOT_SENT, self.name)

    def bind(self, context: ComponentContext, topic: str, writer: Exclusive | None = None) -> None:
        """Bind the port to a topic (full name); with `writer` it proves to be that one."""
        self._bind(context, topic)
        self._writer = writer

    def open(self) -> None:
        """Publish from now on."""
        if self._publisher is None:
            self._publisher = self._context.node.advertise(
                self._full_name, self.interface, self.qos, self._writer
            )
            self._counted = (self._publisher, self._counted[1])
            if self._call_log is not None:
                self._call_log.add(RecordKind.OPENED, self.name, self._publisher.gid)

    def close(self) -> None:
        """Publish nothing more."""
        if self._publisher is not None:
            self._publisher.close()
            self._publisher = None
            self._counted = (None, self._sent())

    def status(self) -> PortStatus:
        """Return the counters."""
        return self._status(PortStatus.OUT, self._sent())

    def _sent(self) -> int:
        now, before = self._counted
        return before if now is None else before + now.published
