"""What a bus is: the contract that the Zenoh bus and the lockstep bus both keep."""

from collections.abc import Callable
from typing import Any, Protocol

from cairn.bus.qos import Qos


class Publisher(Protocol):
    """Writes messages of one type to one topic."""

    @property
    def published(self) -> int:
        """Messages handed to the bus so far."""
        ...

    @property
    def has_subscribers(self) -> bool:
        """Whether a message sent now would come to anybody, be it one who comes later."""
        ...

    def publish(self, message: Any) -> None:
        """Send one message; never waits for a reader."""
        ...

    def close(self) -> None:
        """Stop writing; readers see the writer go."""
        ...


class Subscription(Protocol):
    """Reads messages of one type from one topic; keeps the newest `qos.depth` of them."""

    @property
    def received(self) -> int:
        """Messages taken so far."""
        ...

    @property
    def dropped(self) -> int:
        """Messages that were sent after the first one seen here and never taken."""
        ...

    @property
    def invalid(self) -> int:
        """Messages that could not be decoded to a valid message."""
        ...

    def take(self) -> Any | None:
        """The oldest message waiting, None if there is none.

        Raises `InvalidMessage` for one that does not decode; it is then counted and gone.
        """
        ...

    def close(self) -> None:
        """Stop reading; what waits is discarded."""
        ...


class Node(Protocol):
    """One component's place on the bus; its name and ports are seen by everybody."""

    def advertise(self, topic: str, message: type[Any], qos: Qos) -> Publisher:
        """Write messages of class `message` to `topic` (a full name: `/robot/odom`)."""
        ...

    def subscribe(
        self, topic: str, message: type[Any], qos: Qos, wake: Callable[[], None]
    ) -> Subscription:
        """Read messages of class `message` from `topic`.

        `wake` is called, on whatever thread, once for each message that begins to wait.
        """
        ...

    def close(self) -> None:
        """Leave the bus, with all publishers and subscriptions."""
        ...


class Bus(Protocol):
    """The connection of one process to all the others."""

    def node(self, name: str, complain: Callable[[str], None]) -> Node:
        """Join under a full name (`/robot/localizer`).

        `complain` is told, on whatever thread, of a topic of this node that somebody else uses
        with another message type: the two would never hear each other.
        """
        ...

    def wait_for_peers(self, timeout_s: float) -> list[str]:
        """Wait until all that was declared here is known to everybody on the bus, and theirs here.

        Returns whom it could not reach within the limit.
        """
        ...


def full_name(robot: str, topic: str) -> str:
    """The name on the bus of a robot's topic or component; one that starts with / stays."""
    return topic if topic.startswith("/") else f"/{robot}/{topic}"


def type_conflict(topic: str, ours: str, other: str, theirs: str) -> str:
    """The complaint about two message types on one topic."""
    return (
        f"topic {topic}: {other} uses it with {theirs}, this component with {ours}; they cannot "
        "hear each other. Give one of them another topic, or the same message type"
    )
