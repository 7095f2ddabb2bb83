"""What a console shows: the channels of a source, live or recorded, and their messages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Protocol

if TYPE_CHECKING:
    from cairn.client.connection import Connection
    from cairn.console.hub import Hub


@dataclass(frozen=True)
class Channel:
    """A topic with one message type.

    Attributes:
        id: never used again for another topic, type or schema.
        topic: full name, `/robot/scan`.
        type_name: ROS 2 name of the message type.
        schema: definition of the type with all that it contains (ros2msg); "" if it is unknown.
        latched: whether a new subscription receives the last messages.
        depth: number of messages kept for a browser that is slow, and if latched for a new one.
    """

    id: int
    topic: str
    type_name: str
    schema: str
    latched: bool = False
    depth: int = 1

    @property
    def robot(self) -> str:
        """Name of the robot that the topic belongs to; "" if it is of none, such as /rosout."""
        parts = self.topic.split("/")
        return parts[1] if len(parts) > 2 else ""


class Message(NamedTuple):
    """A message as it was sent: time [ns since 1970 UTC] and CDR."""

    time_ns: int
    payload: bytes


@dataclass(frozen=True)
class ConnectionGraph:
    """Full names of the nodes that publish and subscribe, by topic.

    Those in `foreign` are not components of Cairn, such as nodes of ROS 2.
    """

    publishers: Mapping[str, Set[str]]
    subscribers: Mapping[str, Set[str]]
    foreign: Set[str] = frozenset()


class Source(Protocol):
    """Where channels and messages come from. All methods are called on the event loop."""

    @property
    def mode(self) -> Literal["live", "recording"]:
        """Whether it is a bus or a file."""

    @property
    def recording(self) -> Mapping[str, Any] | None:
        """`start_ns`, `end_ns` and `file` of a recording; None if live."""

    @property
    def connection(self) -> Connection:
        """The connection to the bus; `CairnError` if there is none now."""

    async def run(self, hub: Hub) -> None:
        """Call `hub.set_channels` and `hub.deliver` until canceled.

        Messages are wanted of the channels that are subscribed.
        """

    def subscribe(self, channel: Channel) -> None:
        """Deliver the messages of a channel from now on: it has a first subscription."""

    def unsubscribe(self, channel: Channel) -> None:
        """Deliver the messages of a channel no longer."""

    def kept(self, channel: Channel) -> Sequence[Message]:
        """Return the last messages of a latched channel that is subscribed, oldest first."""

    async def publish(self, topic: str, type_name: str, payload: bytes) -> None:
        """Publish CDR on the bus; `CairnError` if that is not possible or not allowed."""
