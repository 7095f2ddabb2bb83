"""The bus in memory: messages are handed over as objects, in order, for lockstep runs and tests."""

from collections import deque
from collections.abc import Callable
from typing import Any, TypeVar

from cairn.bus.bus import type_conflict
from cairn.bus.drops import DropOldestQueue
from cairn.bus.qos import Qos
from cairn.schemas.message import type_name

End = TypeVar("End", "LockstepPublisher", "LockstepSubscription")


class LockstepBus:
    """Connects nodes within one process and one thread; messages are immutable and not copied."""

    def __init__(self) -> None:
        self._topics: dict[str, _Topic] = {}

    def node(self, name: str, complain: Callable[[str], None]) -> "LockstepNode":
        """Join under a full name."""
        return LockstepNode(self, name, complain)

    def wait_for_peers(self, timeout_s: float) -> list[str]:  # noqa: ARG002 - nothing to wait for
        """Everybody knows everything at once in memory."""
        return []

    def topic(self, name: str) -> "_Topic":
        """The topic of that name, made on first use."""
        return self._topics.setdefault(name, _Topic(name))


class LockstepNode:
    """One component's place on the lockstep bus."""

    def __init__(self, bus: LockstepBus, name: str, complain: Callable[[str], None]) -> None:
        self.name = name
        self.complain = complain
        self._bus = bus
        self._ends: list[LockstepPublisher | LockstepSubscription] = []

    def advertise(self, topic: str, message: type[Any], qos: Qos) -> "LockstepPublisher":
        """Write messages of class `message` to `topic`."""
        end = LockstepPublisher(self, self._bus.topic(topic), message, qos)
        self._ends.append(end)
        return end

    def subscribe(
        self, topic: str, message: type[Any], qos: Qos, wake: Callable[[], None]
    ) -> "LockstepSubscription":
        """Read messages of class `message` from `topic`; latched ones wait at once."""
        end = LockstepSubscription(self, self._bus.topic(topic), message, qos, wake)
        self._ends.append(end)
        return end

    def close(self) -> None:
        """Leave the bus."""
        for end in self._ends:
            end.close()
        self._ends.clear()


class LockstepPublisher:
    """Writes to one topic in memory."""

    def __init__(self, node: LockstepNode, topic: "_Topic", message: type[Any], qos: Qos) -> None:
        self.node = node
        self.message = message
        self.published = 0
        self._closed = False
        self.latched: deque[Any] = deque(maxlen=qos.depth if _latches(qos) else 0)
        self._topic = topic
        topic.join(self, topic.writers)

    @property
    def has_subscribers(self) -> bool:
        """Whether somebody reads, or may come and read what is latched."""
        return not self._closed and (bool(self.latched.maxlen) or bool(self._topic.readers))

    def publish(self, message: Any) -> None:
        """Hand the message to every reader of its type."""
        if self._closed:
            return
        self.published += 1
        self.latched.append(message)
        for reader in tuple(self._topic.readers):
            if reader.message is self.message:
                reader.put(message)

    def close(self) -> None:
        """Stop writing."""
        self._closed = True
        self._topic.leave(self, self._topic.writers)


class LockstepSubscription:
    """Reads from one topic in memory."""

    def __init__(
        self,
        node: LockstepNode,
        topic: "_Topic",
        message: type[Any],
        qos: Qos,
        wake: Callable[[], None],
    ) -> None:
        self.node = node
        self.message = message
        self.received = 0
        self.invalid = 0
        self._topic = topic
        self._waiting: DropOldestQueue[Any] = DropOldestQueue(qos.depth)
        self._wake = wake
        topic.join(self, topic.readers)
        if _latches(qos):
            for writer in topic.writers:
                if writer.message is message:
                    for latched in tuple(writer.latched)[-qos.depth :]:
                        self.put(latched)

    def put(self, message: Any) -> None:
        """Let a message wait; the oldest one gives way if too many do."""
        if self._waiting.put(message):
            self._wake()

    @property
    def dropped(self) -> int:
        """Messages that gave way to newer ones."""
        return self._waiting.dropped

    def take(self) -> Any | None:
        """The oldest message waiting, None if there is none."""
        message = self._waiting.take()
        if message is not None:
            self.received += 1
        return message

    def close(self) -> None:
        """Stop reading."""
        self._waiting.clear()
        self._topic.leave(self, self._topic.readers)


class _Topic:
    def __init__(self, name: str) -> None:
        self.name = name
        self.writers: list[LockstepPublisher] = []
        self.readers: list[LockstepSubscription] = []

    def join(self, end: End, ends: list[End]) -> None:
        others: list[LockstepPublisher | LockstepSubscription] = [*self.writers, *self.readers]
        for other in others:
            if other.message is not end.message:
                ours, theirs = type_name(end.message), type_name(other.message)
                end.node.complain(type_conflict(self.name, ours, other.node.name, theirs))
                other.node.complain(type_conflict(self.name, theirs, end.node.name, ours))
        ends.append(end)

    def leave(self, end: End, ends: list[End]) -> None:
        if end in ends:
            ends.remove(end)


def _latches(qos: Qos) -> bool:
    return qos.durability == "transient_local"
