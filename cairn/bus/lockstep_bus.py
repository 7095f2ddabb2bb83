"""The bus in memory: hands over messages as objects, in order, for lockstep runs and tests."""

from collections import deque
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from cairn.bus import keys
from cairn.bus.bus import (
    ClientOptions,
    MessageId,
    Node,
    PublisherOptions,
    Report,
    ServerOptions,
    SubscriptionOptions,
)
from cairn.bus.drop_oldest_queue import DropOldestQueue
from cairn.bus.exclusive import RefusalLog
from cairn.bus.lockstep_services import LockstepClient, LockstepServer, report_conflict
from cairn.bus.message_limits import (
    FIXED_BYTES,
    PENDING_BYTES,
    PublisherLog,
    has_fixed_size,
    length_of,
    too_long,
)

End = TypeVar("End", "LockstepPublisher", "LockstepSubscription")


class LockstepBus:
    """Connects nodes in one process and one thread; messages are immutable and not copied."""

    def __init__(self, after: Callable[[int, Callable[[], None]], None] | None = None) -> None:
        """`after` makes a call after some virtual time [ns]; without it no call times out."""
        self.after = after or _never
        self.servers: dict[str, list[LockstepServer]] = {}
        self.taps: list[Callable[[LockstepPublisher, Any], None]] = []
        """Called with every message and its publisher, before it is handed over."""
        self._topics: dict[str, _LockstepTopic] = {}

    def node(self, name: str, report: Report, warn: Report | None = None) -> "LockstepNode":
        """Join the bus under a full name; `report` receives errors about conflicting types."""
        return LockstepNode(self, name, report)

    def wait_for_peers(self, timeout_s: float) -> list[str]:
        """Return at once: in memory, all declarations are known to all nodes."""
        return []

    def latched(self) -> "Iterator[tuple[LockstepPublisher, Any, MessageId]]":
        """Yield the messages that latched publishers keep, with their publishers and numbers."""
        for topic in self._topics.values():
            for publisher in topic.publishers:
                for message, identity in publisher.latched:
                    yield publisher, message, identity

    def topic(self, name: str) -> "_LockstepTopic":
        """Return the topic of that name, created on first use."""
        return self._topics.setdefault(name, _LockstepTopic(name))


class LockstepNode(Node):
    """One component on the lockstep bus."""

    def __init__(self, bus: LockstepBus, name: str, report: Report) -> None:
        super().__init__()
        self.name = name
        self.report = report
        self.bus = bus

    def _open_publisher(self, options: PublisherOptions) -> "LockstepPublisher":
        return LockstepPublisher(self, options)

    def _open_subscription(self, options: SubscriptionOptions) -> "LockstepSubscription":
        return LockstepSubscription(self, options)

    def _open_server(self, options: ServerOptions) -> LockstepServer:
        return LockstepServer(self, options)

    def _open_client(self, options: ClientOptions) -> LockstepClient:
        return LockstepClient(self, options)


class LockstepPublisher:
    """Publishes on one topic in memory."""

    def __init__(self, node: LockstepNode, options: PublisherOptions) -> None:
        self.node = node
        self.topic = options.topic
        self.message = options.message
        self.qos = options.qos
        self.published = 0
        self.gid = keys.gid(f"{node.name} {self.topic}")
        self.sequence = 0  # of the last message
        self._taps = node.bus.taps
        self._closed = False
        kept = self.qos.depth if self.qos.latched else 0
        self.latched: deque[tuple[Any, MessageId]] = deque(maxlen=kept)
        self._topic = node.bus.topic(self.topic)
        self._topic.join(self, self._topic.publishers)

    @property
    def has_subscribers(self) -> bool:
        """Whether a message published now would be received; always True if latched."""
        return not self._closed and (
            bool(self.latched.maxlen) or bool(self._topic.subscriptions) or bool(self._taps)
        )

    def publish(self, message: Any) -> int:
        """Hand the message to every subscription of its type; return its number, 0 if closed."""
        if self._closed:
            return 0
        self.published += 1
        # A publisher that is opened again, as after a restart, continues to count.
        self.sequence = self._topic.sent[self.gid] = self._topic.sent.get(self.gid, 0) + 1
        identity = MessageId(self.gid, self.sequence)
        self.latched.append((message, identity))
        for tap in self._taps:
            tap(self, message)
        for subscription in tuple(self._topic.subscriptions):
            if subscription.message is self.message:
                subscription.put(message, self.node.name, identity)
        return self.sequence

    def close(self) -> None:
        """Stop publishing."""
        self._closed = True
        self._topic.leave(self, self._topic.publishers)


class LockstepSubscription:
    """Receives from one topic in memory."""

    def __init__(self, node: LockstepNode, options: SubscriptionOptions) -> None:
        name, message, qos, self._wake, exclusive, max_bytes = options
        self.node = node
        self.message = message
        self.received = 0
        self.invalid = 0
        self._topic = topic = node.bus.topic(name)
        self._max_bytes = max_bytes
        self._always_fits = has_fixed_size(message) and max_bytes >= FIXED_BYTES
        self._long_messages = PublisherLog(node.report)
        self.taken: MessageId | None = None
        self._pending: DropOldestQueue[tuple[Any, MessageId]] = DropOldestQueue(
            qos.depth, PENDING_BYTES
        )
        self._refusals = RefusalLog(topic.name, exclusive, node.report) if exclusive else None
        topic.join(self, topic.subscriptions)
        if qos.latched:
            for publisher in topic.publishers:
                if publisher.message is message:
                    for latched, identity in tuple(publisher.latched)[-qos.depth :]:
                        self.put(latched, publisher.node.name, identity)

    def put(self, message: Any, publisher: str, identity: MessageId) -> None:
        """Add a pending message, which may drop older ones, and wake the subscriber.

        A message that is too long is rejected, and one of a node that is not entitled to an
        exclusive topic is refused.
        """
        size = 0 if self._always_fits else self._topic.size(message)
        if size > self._max_bytes:
            self.invalid += 1
            self._long_messages.add(
                publisher,
                lambda named: too_long(self._topic.name, named, size, self._max_bytes),
            )
        elif self._refusals is not None and publisher != self._refusals.writer:
            self._refusals.refuse(publisher, "it is not the entitled writer")
        elif self._pending.put((message, identity), size):
            self._wake()

    @property
    def dropped(self) -> int:
        """Number of messages dropped in favor of newer ones."""
        return self._pending.dropped

    @property
    def refused(self) -> int:
        """Number of messages of nodes that are not entitled to an exclusive topic."""
        return self._refusals.refused if self._refusals is not None else 0

    def take(self) -> Any | None:
        """Remove and return the oldest pending message; None if there is none."""
        pending = self._pending.take()
        if pending is None:
            return None
        message, self.taken = pending
        self.received += 1
        return message

    def close(self) -> None:
        """Stop receiving and discard the pending messages."""
        self._pending.clear()
        self._topic.leave(self, self._topic.subscriptions)


def _never(delay_ns: int, call: Callable[[], None]) -> None:
    """Make no call: where there is no virtual time, nothing times out."""


class _LockstepTopic:
    def __init__(self, name: str) -> None:
        self.name = name
        self._measured: tuple[Any, int] = (None, 0)
        self.publishers: list[LockstepPublisher] = []
        self.subscriptions: list[LockstepSubscription] = []
        self.sent: dict[bytes, int] = {}  # messages, by publisher's identity

    def size(self, message: Any) -> int:
        """Return the length of a message [bytes], measured once for all readers."""
        if self._measured[0] is not message:
            self._measured = (message, length_of(message))
        return self._measured[1]

    def join(self, end: End, ends: list[End]) -> None:
        others: list[LockstepPublisher | LockstepSubscription] = [
            *self.publishers, *self.subscriptions,
        ]  # fmt: skip
        for other in others:
            report_conflict(self.name, end.node, end.message, other.node, other.message)
        ends.append(end)

    def leave(self, end: End, ends: list[End]) -> None:
        if end in ends:
            ends.remove(end)
