"""The contract of a bus, which the Zenoh bus and the lockstep bus both implement."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, TypeVar

from cairn.bus.exclusive import Exclusive
from cairn.bus.message_limits import default_max_bytes
from cairn.bus.qos import Qos
from cairn.errors import CairnError
from cairn.schemas.message import Service, type_name

End = TypeVar("End", bound="Publisher | Subscription | ServiceServer | ServiceClient")


Report = Callable[[str], None]
"""Takes a sentence for the log; called on any thread."""

Post = Callable[[Callable[[], None]], None]
"""Has a call made, now or later, as one of a component's own."""

OnReply = Callable[[Any], None]
"""Takes the response to a call of a service."""


class MessageId(NamedTuple):
    """Which message of a run it is: its publisher's identity (16 bytes), and its number from 1."""

    gid: bytes
    sequence: int


class Publisher(Protocol):
    """Publishes messages of one type on one topic."""

    @property
    def gid(self) -> bytes:
        """Its identity on the bus: 16 bytes."""

    @property
    def published(self) -> int:
        """Number of messages handed to the bus so far."""

    @property
    def has_subscribers(self) -> bool:
        """Whether a message published now would be received; always True on a latched topic.

        The last message of a latched topic is delivered to later subscribers, too.
        """

    def publish(self, message: Any) -> int:
        """Send one message; never waits for a subscriber.

        Returns the message's sequence number; 0 if it was not sent, as nothing subscribes to it.
        """

    def close(self) -> None:
        """Stop publishing and withdraw the publisher from the graph."""


class Receiver(Protocol):
    """What receives messages of a topic and what receives calls of a service have in common."""

    @property
    def received(self) -> int:
        """Number of messages or calls taken so far."""

    @property
    def invalid(self) -> int:
        """Number of messages or requests that could not be decoded to a valid message.

        Of messages, also of those that were too long.
        """

    @property
    def refused(self) -> int:
        """Number of messages of publishers that are not entitled to an exclusive topic.

        Of calls: of those that were too long, or came while too many waited.
        """

    def take(self) -> Any | None:
        """Remove and return the oldest pending message or call; None if there is none.

        Raises `InvalidMessage` for one that does not decode, which is counted and discarded; the
        client of such a call has its answer then.
        """

    def close(self) -> None:
        """Receive nothing more: discard the pending messages, refuse the pending calls."""


class Subscription(Receiver, Protocol):
    """Receives messages of one type from one topic; keeps the newest `qos.depth` of them."""

    @property
    def dropped(self) -> int:
        """Number of messages sent after the first one received here, and never taken."""

    @property
    def taken(self) -> MessageId | None:
        """Which message was taken last; None before, and if its publisher does not number them."""


class ServiceError(CairnError):
    """A service was not provided: no server, no answer in time, or the server refused the call."""


OnFailure = Callable[[ServiceError], None]
"""Takes what has prevented the response to a call of a service."""


class Call(Protocol):
    """A call that a server has received; it is answered once, now or later."""

    request: Any
    """The request, of the service's request class."""
    client: bytes
    """Identity of the client: 16 bytes; zeros if it sent none."""
    sequence: int
    """Number of the call, from 1 for each client; 0 if it sent none."""

    def reply(self, response: Any) -> None:
        """Answer; raises `TypeError` if it is not of the service's response class."""

    def refuse(self, reason: str) -> None:
        """Answer with an error, which the client's program gets as `ServiceError`."""


class ServiceServer(Receiver, Protocol):
    """Receives the calls of one service, in order."""

    def take(self) -> Call | None:
        """Remove and return the oldest pending call; None if there is none.

        Raises `InvalidMessage` if its request is not valid, after having answered it.
        """


class ServiceClient(Protocol):
    """Calls one service."""

    @property
    def gid(self) -> bytes:
        """Its identity on the bus: 16 bytes."""

    @property
    def sent(self) -> int:
        """Number of calls so far."""

    @property
    def is_available(self) -> bool:
        """Whether there is a server, as far as this process knows."""

    def call(
        self, request: Any, on_reply: OnReply, on_failure: OnFailure, timeout_s: float
    ) -> None:
        """Send a request; never waits for the answer.

        One of the functions is called later, through the client's `post`: with the response, or
        with what prevented it. After `close`, neither is.
        """

    def close(self) -> None:
        """Stop calling; answers that arrive later are ignored."""


class PublisherOptions(NamedTuple):
    """What a node publishes: the arguments of `Node.advertise`."""

    topic: str
    message: type[Any]
    qos: Qos
    exclusive: Exclusive | None
    shared: bool


class SubscriptionOptions(NamedTuple):
    """What a node subscribes to: the arguments of `Node.subscribe`."""

    topic: str
    message: type[Any]
    qos: Qos
    wake: Callable[[], None]
    exclusive: Exclusive | None
    max_bytes: int


class ServerOptions(NamedTuple):
    """What a node serves: the arguments of `Node.serve`."""

    name: str
    service: type[Service[Any, Any]]
    wake: Callable[[], None]
    max_bytes: int
    invalid_response: Any
    is_private: bool


class ClientOptions(NamedTuple):
    """What a node calls: the arguments of `Node.client`."""

    name: str
    service: type[Service[Any, Any]]
    post: Post
    deliver: Post


class Node(ABC):
    """One component on the bus; its name and ports are visible in the graph."""

    def __init__(self) -> None:
        self._ends: list[Publisher | Subscription | ServiceServer | ServiceClient] = []

    def advertise(
        self,
        topic: str,
        message: type[Any],
        qos: Qos,
        exclusive: Exclusive | None = None,
        *,
        shared: bool = False,
    ) -> Publisher:
        """Return a publisher of class `message` on `topic` (a full name: `/robot/odom`).

        With `exclusive` it proves to the topic's readers that this node is the entitled writer. On
        a topic that is `shared`, on which every component publishes, it does not report nodes that
        use another type: a program that announces thousands there would burden all of them.
        """
        options = PublisherOptions(topic, message, qos, exclusive, shared)
        return self._opened(self._open_publisher(options))

    def subscribe(
        self,
        topic: str,
        message: type[Any],
        qos: Qos,
        wake: Callable[[], None],
        exclusive: Exclusive | None = None,
        max_bytes: int | None = None,
    ) -> Subscription:
        """Return a subscription to messages of class `message` on `topic` (a full name).

        `wake` is called, on any thread, once for each message that becomes pending. With
        `exclusive`, only the messages of the entitled writer become pending. A message longer than
        `max_bytes`, by default that of its class (`default_max_bytes`), is rejected as invalid.
        """
        limit = default_max_bytes(message) if max_bytes is None else max_bytes
        options = SubscriptionOptions(topic, message, qos, wake, exclusive, limit)
        return self._opened(self._open_subscription(options))

    def serve(
        self,
        name: str,
        service: type[Service[Any, Any]],
        wake: Callable[[], None],
        max_bytes: int | None = None,
        invalid_response: Any = None,
        *,
        is_private: bool = False,
    ) -> ServiceServer:
        """Return a server of the service `name` (a full name: `/robot/save_map`).

        `wake` is called, on any thread, once for each call that becomes pending. A request longer
        than `max_bytes`, by default that of its class, is refused. `invalid_response` answers
        requests that cannot be decoded; without one, they are refused: ROS 2 clients wait for a
        response, and take no errors. A service that `is_private` to a node, such as
        `/robot/localizer/get_parameters`, shares what it needs with the node's others of the same
        package: it is called rarely, and every node has many.
        """
        limit = default_max_bytes(service.Request) if max_bytes is None else max_bytes
        options = ServerOptions(name, service, wake, limit, invalid_response, is_private)
        return self._opened(self._open_server(options))

    def client(
        self, name: str, service: type[Service[Any, Any]], post: Post, deliver: Post | None = None
    ) -> ServiceClient:
        """Return a client of the service `name`, whose answers arrive through `post`.

        An answer may also arrive through `deliver`, from a thread that may make the call itself,
        which takes less time.
        """
        options = ClientOptions(name, service, post, deliver or post)
        return self._opened(self._open_client(options))

    def close(self) -> None:
        """Leave the bus and close all publishers, subscriptions, servers and clients."""
        for end in self._ends:
            end.close()
        self._ends.clear()

    def _opened(self, end: End) -> End:
        self._ends.append(end)
        return end

    @abstractmethod
    def _open_publisher(self, options: PublisherOptions) -> Publisher:
        """Begin to publish."""

    @abstractmethod
    def _open_subscription(self, options: SubscriptionOptions) -> Subscription:
        """Begin to receive."""

    @abstractmethod
    def _open_server(self, options: ServerOptions) -> ServiceServer:
        """Begin to serve."""

    @abstractmethod
    def _open_client(self, options: ClientOptions) -> ServiceClient:
        """Prepare calls."""


class Bus(Protocol):
    """The connection of one process to all other processes."""

    def node(self, name: str, report: Report, warn: Report | None = None) -> Node:
        """Join the bus under a full name (`/robot/localizer`).

        `report` is called, on any thread, with an error message when another node uses a topic of
        this node with another message type (the two cannot receive each other's messages), and
        about messages that are refused, or too long to be received or sent. `warn`, by default
        `report`, is called likewise when the QoS of another node does not match, or it has the
        same name.
        """

    def wait_for_peers(self, timeout_s: float) -> list[str]:
        """Wait until this process and all others on the bus know each other's declarations.

        Returns the processes that were not reached within the timeout, such as "process 4711".
        """


def check_response(response: Any, expected: type[Any]) -> None:
    """Raise `TypeError` unless the answer to a call is of the service's response class."""
    if type(response) is not expected:
        raise TypeError(
            f"the answer is a {type(response).__qualname__}, not a {type_name(expected)}"
        )


def full_name(robot: str, topic: str) -> str:
    """Return the name on the bus of a robot's topic or component; a name with / is complete."""
    return topic if topic.startswith("/") else f"/{robot}/{topic}"
