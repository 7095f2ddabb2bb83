"""The bus over Zenoh, speaking ROS 2's language (rmw_zenoh) on the wire."""

import itertools
import threading
import time
from collections.abc import Callable
from typing import Any

import zenoh
from zenoh.ext import (
    CacheConfig,
    HistoryConfig,
    MissDetectionConfig,
    declare_advanced_publisher,
    declare_advanced_subscriber,
)

from cairn.bus import keys
from cairn.bus.bus import type_conflict
from cairn.bus.codec import Codec
from cairn.bus.discovery import DiscoveryBarrier
from cairn.bus.drops import DropOldestQueue
from cairn.bus.graph import GraphWatcher
from cairn.bus.qos import Qos
from cairn.schemas.message import InvalidMessage, type_name

_PUBLISHERS = 1000
"""So many writers of one topic have their messages counted."""

_NO_GAP = 2**32
"""A greater leap in a writer's numbers is an oddity of the writer, not a loss."""


class ZenohBus:
    """Connects the components of one process to all others through one Zenoh session."""

    def __init__(self, session: zenoh.Session, domain: int = 0) -> None:
        """Take over an open session (`cairn.bus.session`); `close` closes it."""
        self.session = session
        self.domain = domain
        self.codec = Codec()
        self._ids = itertools.count()
        self.graph = GraphWatcher(session, domain)
        self._meeting = DiscoveryBarrier(session)
        self._closed = False

    def node(self, name: str, complain: Callable[[str], None]) -> "ZenohNode":
        """Join under a full name such as `/robot/localizer`."""
        return ZenohNode(self, name, complain)

    def wait_for_peers(self, timeout_s: float) -> list[str]:
        """Wait until every process on the bus and this one know all of each other."""
        return self._meeting.wait_for_peers(timeout_s)

    def next_id(self) -> int:
        """A number for a node or an endpoint, unique in this session."""
        return next(self._ids)

    def close(self) -> None:
        """Leave the bus and close the session."""
        if self._closed:
            return
        self._closed = True
        self.graph.close()
        self._meeting.close()
        self.session.close()


class ZenohNode:
    """One component's place on the bus: a ROS 2 node with its endpoints."""

    def __init__(self, bus: ZenohBus, name: str, complain: Callable[[str], None]) -> None:
        self.bus = bus
        self.name = name
        zid = str(bus.session.info.zid())
        self._entity = keys.NodeEntity(bus.domain, zid, bus.next_id(), name)
        self._ends: list[ZenohPublisher | ZenohSubscription] = []
        self._closed = False
        self._complain = complain
        self._token = bus.session.liveliness().declare_token(keys.token_key(self._entity))

    def advertise(self, topic: str, message: type[Any], qos: Qos) -> "ZenohPublisher":
        """Write messages of class `message` to `topic`."""
        publisher = ZenohPublisher(self, topic, message, qos)
        self._ends.append(publisher)
        return publisher

    def subscribe(
        self, topic: str, message: type[Any], qos: Qos, wake: Callable[[], None]
    ) -> "ZenohSubscription":
        """Read messages of class `message` from `topic`."""
        subscription = ZenohSubscription(self, topic, message, qos, wake)
        self._ends.append(subscription)
        return subscription

    def declare(
        self, kind: keys.EndpointKind, topic: str, message: type[Any], qos: Qos
    ) -> "Announcement":
        """Announce an endpoint of this node to the graph."""
        bus = self.bus
        entity = keys.EndpointEntity(
            self._entity, bus.next_id(), kind, topic, type_name(message),
            bus.codec.type_hash(message), qos,
        )  # fmt: skip
        return Announcement(bus, entity, self._complain)

    def close(self) -> None:
        """Leave the bus."""
        if self._closed:
            return
        self._closed = True
        for end in self._ends:
            end.close()
        self._ends.clear()
        self._token.undeclare()


class Announcement:
    """An endpoint's liveliness token, and the watch for others that use its topic differently."""

    def __init__(
        self, bus: ZenohBus, entity: keys.EndpointEntity, complain: Callable[[str], None]
    ) -> None:
        token = keys.token_key(entity)
        self.key = entity.data_key
        self.gid = keys.gid(token)
        self._entity = entity
        self._complain = complain
        self._token = bus.session.liveliness().declare_token(token)
        self._end_watch = bus.graph.watch(self._appeared)

    def close(self) -> None:
        """Withdraw the endpoint from the graph."""
        self._end_watch()
        self._token.undeclare()

    def _appeared(self, other: keys.EndpointEntity) -> None:
        mine = self._entity
        if other.topic != mine.topic or other.kind not in ("MP", "MS"):
            return
        if (other.type_name, other.type_hash) == (mine.type_name, mine.type_hash):
            return
        theirs = other.type_name
        if theirs == mine.type_name:
            theirs = f"another definition of it ({other.type_hash})"
        self._complain(type_conflict(mine.topic, mine.type_name, other.node.name, theirs))


class ZenohPublisher:
    """Writes to one topic; only from its component's thread."""

    def __init__(self, node: ZenohNode, topic: str, message: type[Any], qos: Qos) -> None:
        self.published = 0
        self._sent = 0
        self._closed = False
        self._codec = node.bus.codec
        self._latched = qos.durability == "transient_local"
        self._announcement = node.declare("MP", topic, message, qos)
        self._gid = self._announcement.gid
        key = self._announcement.key
        encoding = zenoh.Encoding.APPLICATION_CDR.with_schema(type_name(message))
        # Bulk data must not hold up small, urgent messages of the same process.
        bulk = self._codec.is_bulk(message)
        priority = zenoh.Priority.DATA_LOW if bulk else zenoh.Priority.INTERACTIVE_HIGH
        session = node.bus.session
        self._publisher: Any
        if self._latched:
            self._publisher = declare_advanced_publisher(
                session,
                key,
                encoding=encoding,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=priority,
                cache=CacheConfig(max_samples=qos.depth),
                publisher_detection=True,
                # Without heartbeats: in zenoh 1.10 closing a publisher that has some can block for
                # 10 s and leave the session's links dead; readers find gaps by the next message.
                sample_miss_detection=MissDetectionConfig(heartbeat=None, sporadic_heartbeat=None),
            )
        else:
            self._publisher = session.declare_publisher(
                key,
                encoding=encoding,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=priority,
            )

    @property
    def has_subscribers(self) -> bool:
        """Whether somebody reads, or may come and read what is latched."""
        return not self._closed and (self._latched or self._publisher.matching_status.matching)

    def publish(self, message: Any) -> None:
        """Send one message; without any reader, or once closed, it is neither encoded nor sent."""
        if self._closed:
            return
        self.published += 1
        if not self.has_subscribers:
            return
        self._sent += 1
        attachment = keys.Attachment(self._sent, time.time_ns(), self._gid)
        self._publisher.put(self._codec.encode(message), attachment=attachment.encode())

    def close(self) -> None:
        """Stop writing."""
        if self._closed:
            return
        self._closed = True
        self._publisher.undeclare()
        self._announcement.close()


class ZenohSubscription:
    """Reads from one topic.

    Zenoh's own thread only moves a sample into a ring, without Python, so that no reader,
    however slow, holds up the link; a thread per subscription takes from it and wakes the loop.
    """

    def __init__(
        self,
        node: ZenohNode,
        topic: str,
        message: type[Any],
        qos: Qos,
        wake: Callable[[], None],
    ) -> None:
        self.received = 0
        self.invalid = 0
        self._lost = 0  # on the way or in the ring
        self._closed = False
        self._codec = node.bus.codec
        self._message = message
        self._wake = wake
        self._waiting: DropOldestQueue[zenoh.Sample] = DropOldestQueue(qos.depth)
        self._last: dict[bytes, int] = {}
        self._announcement = node.declare("MS", topic, message, qos)
        key = self._announcement.key
        ring: Any = zenoh.handlers.RingChannel(qos.depth)
        session = node.bus.session
        self._subscriber: Any
        if qos.durability == "transient_local":
            self._subscriber = declare_advanced_subscriber(
                session,
                key,
                ring,
                history=HistoryConfig(detect_late_publishers=True, max_samples=qos.depth),
            )
        else:
            self._subscriber = session.declare_subscriber(key, ring)
        self._thread = threading.Thread(
            target=self._collect, args=(self._subscriber.handler,), name=topic, daemon=True
        )
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Messages that were sent after the first one seen here and never taken."""
        return self._lost + self._waiting.dropped

    def take(self) -> Any | None:
        """The oldest message waiting, None if there is none."""
        sample = self._waiting.take()
        if sample is None:
            return None
        try:
            message = self._codec.decode(self._message, sample.payload.to_bytes())
        except InvalidMessage:
            self.invalid += 1
            raise
        self.received += 1
        return message

    def close(self) -> None:
        """Stop reading."""
        if self._closed:
            return
        self._closed = True
        self._subscriber.undeclare()
        if threading.current_thread() is not self._thread:  # it may be making the closing call
            self._thread.join(timeout=2.0)
        self._waiting.clear()
        self._announcement.close()

    def _collect(self, channel: Any) -> None:
        while True:
            try:
                sample = channel.recv()
            except zenoh.ZError:  # the subscriber was undeclared
                return
            if self._waiting.put(sample):
                self._wake()
            # Last, because the handler may just have run, and should not have waited for it.
            if sample.attachment is not None:
                self._count_gap(sample.attachment.to_bytes())

    def _count_gap(self, attachment: bytes) -> None:
        # Numbers are per publisher and without gaps: what is missing was lost on the way or in
        # the ring.
        try:
            number = keys.Attachment.decode(attachment)
        except keys.WireFormatError:
            return  # a peer without rmw_zenoh's numbering
        if len(self._last) >= _PUBLISHERS:  # or a peer that invents names would fill the memory
            self._last.clear()
        last = self._last.get(number.gid)
        if last is not None and 1 < number.sequence - last < _NO_GAP:
            self._lost += number.sequence - last - 1
        self._last[number.gid] = number.sequence
