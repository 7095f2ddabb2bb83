"""The bus over Zenoh, with the wire format of ROS 2 (rmw_zenoh).

`_declare_publisher` and `_declare_subscriber` map the QoS of a topic to Zenoh.
"""

import itertools
import time
from collections.abc import Callable
from functools import partial
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
from cairn.bus.bus import (
    ClientOptions,
    MessageId,
    Node,
    PublisherOptions,
    Report,
    ServerOptions,
    SubscriptionOptions,
)
from cairn.bus.channels import ChannelReader
from cairn.bus.codec import Codec
from cairn.bus.conflicts import endpoint_qos_mismatch, endpoint_type_conflict
from cairn.bus.discovery import DiscoveryBarrier
from cairn.bus.drop_oldest_queue import DropOldestQueue, LossCounter
from cairn.bus.exclusive import RefusalLog, Refused, Signer, Verifier
from cairn.bus.graph import GraphWatcher
from cairn.bus.message_limits import (
    DEFAULT_LIMITS,
    PENDING_BYTES,
    MessageLimits,
    PublisherLog,
    is_bulk,
    ring_length,
    too_long,
)
from cairn.bus.qos import SERVICES, Qos
from cairn.bus.services import PrivateQueries, ZenohClient, ZenohServer
from cairn.bus.session import close_session, is_member, process_of
from cairn.bus.type_hash import type_hash
from cairn.schemas.message import InvalidMessage, Service, repairs_of, type_name

_EXCLUSIVE_RING = 1024
"""Samples that the ring of an exclusive port holds: so many forged ones displace no true one."""

_MOST_REPORTED = 100
"""Repairs that one input reports, of all publishers together."""

_CLOSE_LIMIT_S = 0.2
"""A session that takes longer to close does so while its process ends."""


class ZenohBus:
    """Connects the components of one process to all others through one Zenoh session."""

    def __init__(
        self,
        session: zenoh.Session,
        domain: int = 0,
        secret: str = "",
        limits: MessageLimits = DEFAULT_LIMITS,
        codec: Codec | None = None,
        *,
        several_machines: bool = False,
    ) -> None:
        """Take over an open session (`cairn.bus.session`), which `close` closes.

        `secret` and `limits` are those of the run, with which the session was opened. `codec` may
        know types already. `several_machines`: the run is on several machines.
        """
        self.session = session
        self.domain = domain
        self.secret = secret
        self.limits = limits
        self.codec = codec or Codec()
        self._ids = itertools.count()
        self.graph = GraphWatcher(session, domain)
        self._barrier = DiscoveryBarrier(session, secret, several_machines=several_machines)
        self._closed = False

    def node(self, name: str, report: Report, warn: Report | None = None) -> "ZenohNode":
        """Join the bus under a full name; see `cairn.bus.bus.Bus`."""
        return ZenohNode(self, name, report, warn or report)

    def wait_for_peers(self, timeout_s: float) -> list[str]:
        """Wait until every process on the bus and this one know all of each other.

        Returns the processes that were not reached within the timeout, such as "process 4711".
        """
        unreached = self._barrier.wait_for_peers(timeout_s)
        self.graph.start()
        return unreached

    def next_id(self) -> int:
        """Return a number for a node or an endpoint, unique in this session."""
        return next(self._ids)

    def close(self) -> None:
        """Leave the bus and close the session."""
        if self._closed:
            return
        self._closed = True
        self.graph.close()
        self._barrier.close()
        close_session(self.session, _CLOSE_LIMIT_S)


class ZenohNode(Node):
    """One component on the bus: a ROS 2 node with its endpoints."""

    def __init__(self, bus: ZenohBus, name: str, report: Report, warn: Report) -> None:
        super().__init__()
        self.bus = bus
        self.name = name
        self.report = report
        """Receives errors about conflicting types and rejected messages."""
        zid = str(bus.session.info.zid())
        self._entity = keys.NodeEntity(bus.domain, zid, bus.next_id(), name)
        self._private: dict[str, PrivateQueries] = {}
        self._closed = False
        self.warn = warn
        self._namesakes = PublisherLog(warn)
        self._stop_watching = bus.graph.watch_nodes(name, self._on_node)
        self._token = bus.session.liveliness().declare_token(keys.token_key(self._entity))

    def _open_publisher(self, options: PublisherOptions) -> "ZenohPublisher":
        return ZenohPublisher(self, options)

    def _open_subscription(self, options: SubscriptionOptions) -> "ZenohSubscription":
        return ZenohSubscription(self, options)

    def _open_server(self, options: ServerOptions) -> ZenohServer:
        return ZenohServer(self, options)

    def _open_client(self, options: ClientOptions) -> ZenohClient:
        name, service, post, deliver = options
        announcement = self.announce("SC", name, service, SERVICES)
        return ZenohClient(
            self.bus.session, self.bus.codec, name, announcement.key, announcement.gid, service,
            post, deliver, announcement.close,
        )  # fmt: skip

    def private_queries(self, name: str, service: type[Service[Any, Any]]) -> PrivateQueries:
        """Return what reads the queries of a private service and of those of the same package."""
        pattern = keys.private_services_key(self.bus.domain, name, type_name(service))
        queries = self._private.get(pattern)
        if queries is None:
            queries = self._private[pattern] = PrivateQueries(self.bus.session, pattern)
        return queries

    def announce(
        self,
        kind: keys.EndpointKind,
        topic: str,
        interface: type[Any],
        qos: Qos,
        *,
        shared: bool = False,
    ) -> "Announcement":
        """Announce an endpoint of this node in the graph, and watch those of others.

        `interface` is the class of the messages, or of the service.
        The others are not watched if the topic is `shared` by all components.
        """
        bus = self.bus
        entity = keys.EndpointEntity(
            self._entity, bus.next_id(), kind, topic, type_name(interface),
            type_hash(interface), qos,
        )  # fmt: skip
        reports = None if shared else (PublisherLog(self.report), PublisherLog(self.warn))
        return Announcement(bus, entity, reports)

    def close(self) -> None:
        """Leave the bus and close all publishers, subscriptions, servers and clients."""
        if self._closed:
            return
        self._closed = True
        super().close()
        for queries in self._private.values():
            queries.close()
        self._stop_watching()
        self._token.undeclare()

    def _on_node(self, other: keys.NodeEntity) -> None:
        # In this run the name is unique: it is this node, or its process before a restart.
        if self.bus.secret and is_member(other.zid, self.bus.secret):
            return
        if other == self._entity:
            return
        where = "is not of Cairn" if other.is_foreign else "is of another deployment"
        self._namesakes.add(
            process_of(other.zid),
            lambda process: (
                f"another node has the name {self.name}, in {process}, which {where}: tools of "
                "ROS 2 and services cannot distinguish the two; rename one of them"
            ),
        )


class Announcement:
    """An endpoint's liveliness token; reports endpoints of others that do not fit it.

    `reports` are those of types and of QoS. Without them it reports none.
    """

    def __init__(
        self,
        bus: ZenohBus,
        entity: keys.EndpointEntity,
        reports: tuple[PublisherLog, PublisherLog] | None,
    ) -> None:
        token = keys.token_key(entity)
        self.key = entity.data_key
        self.gid = keys.gid(token)
        self._entity = entity
        self._token = bus.session.liveliness().declare_token(token)
        self._stop_watching: Callable[[], None] | None = None
        if reports is not None:
            on_endpoint = partial(self._on_endpoint, *reports)
            # A publisher needs no names: only readers report who sends them what.
            self._stop_watching = bus.graph.watch(
                entity.topic, on_endpoint, is_urgent=entity.kind in ("MS", "SC")
            )

    def close(self) -> None:
        """Withdraw the endpoint from the graph."""
        if self._stop_watching is not None:
            self._stop_watching()
        self._token.undeclare()

    def _on_endpoint(
        self, conflicts: PublisherLog, mismatches: PublisherLog, other: keys.EndpointEntity
    ) -> None:
        name = other.node.name
        if problem := endpoint_type_conflict(other, self._entity):
            conflicts.add(name, lambda _: problem)
        # Of two components, the subscriber reports it: once for the pair.
        elif (self._entity.kind == "MS" or other.node.is_foreign) and (
            mismatch := endpoint_qos_mismatch(other, self._entity)
        ):
            mismatches.add(name, lambda _: mismatch)


class ZenohPublisher:
    """Publishes on one topic; only from its component's calls."""

    def __init__(self, node: ZenohNode, options: PublisherOptions) -> None:
        topic, message, qos, exclusive, shared = options
        self.published = 0
        self._sent = 0
        self._closed = False
        self._codec = node.bus.codec
        self._latched = qos.latched
        self._topic = topic
        self._max_bytes = node.bus.limits.of(topic)
        self._too_long = PublisherLog(node.report)
        self._codec.register(message)
        self._announcement = node.announce("MP", topic, message, qos, shared=shared)
        self.gid = self._announcement.gid
        self._signer: Signer | None = None
        if exclusive is not None and exclusive.writer == node.name and exclusive.key:
            self._signer = Signer(exclusive, self._announcement.key)
        self._publisher = _declare_publisher(
            node.bus.session,
            self._announcement.key,
            qos,
            type_name(message),
            bulk=is_bulk(message),
        )

    @property
    def has_subscribers(self) -> bool:
        """Whether a message published now would be received; always True if latched."""
        return not self._closed and (self._latched or self._publisher.matching_status.matching)

    def publish(self, message: Any) -> int:
        """Send one message; without a subscriber, or once closed, it is not even encoded.

        Returns its sequence number; 0 if it was not sent.
        """
        if self._closed:
            return 0
        self.published += 1
        if not self.has_subscribers:
            return 0
        payload = self._codec.encode(message)
        if len(payload) > self._max_bytes:
            self._too_long.add("this component", lambda _: self._not_sent(len(payload)))
            return 0
        self._sent += 1
        attachment = keys.plain_attachment(self._sent, time.time_ns(), self.gid)
        if self._signer is not None:
            proof = self._signer.proof(attachment, payload)
            attachment = keys.signed_attachment(attachment, proof)
        self._publisher.put(payload, attachment=attachment)
        return self._sent

    def _not_sent(self, size: int) -> str:
        return (
            f"did not send a message of {size:,} bytes on {self._topic}: every process of this "
            f"deployment discards more than {self._max_bytes:,} bytes there; publish less, or "
            "raise `max_bytes` of the inputs that read it, or `bus.max_message_size`"
        )

    def close(self) -> None:
        """Stop publishing."""
        if self._closed:
            return
        self._closed = True
        self._publisher.undeclare()
        self._announcement.close()


class ZenohSubscription:
    """Receives from one topic.

    Zenoh's own thread only moves a sample into a ring, without Python, so that no subscriber,
    however slow, blocks the link. A thread per subscription takes samples from the ring and wakes
    the component's loop. It also verifies the samples of an exclusive topic: forged ones displace
    none of those that are pending.
    """

    def __init__(self, node: ZenohNode, options: SubscriptionOptions) -> None:
        topic, message, qos, wake, exclusive, max_bytes = options
        self.received = 0
        self._malformed = 0  # counted by the component's calls
        self._too_long = 0  # counted by this subscription's thread
        self._closed = False
        self._codec = node.bus.codec
        self._graph = node.bus.graph
        self._topic = topic
        self._message = message
        self._wake = wake
        self._max_bytes = max_bytes
        self._long_messages = PublisherLog(node.report)
        self._warn = node.warn
        self._reported: set[tuple[str, str]] = set()  # which repairs of whose messages
        self._taken: zenoh.Sample | None = None
        self._pending: DropOldestQueue[tuple[zenoh.ZBytes | bytes, zenoh.Sample]] = DropOldestQueue(
            qos.depth, PENDING_BYTES
        )
        self._in_transit = LossCounter()
        self._codec.register(message)
        self._announcement = node.announce("MS", topic, message, qos)
        self._gate = None
        if exclusive is not None:
            since_ns = 0 if qos.latched else exclusive.now_ns() - exclusive.clock_tolerance_ns
            verifier = Verifier(exclusive, self._announcement.key, since_ns)
            refusals = RefusalLog(topic, exclusive, node.report)
            self._gate = _ExclusiveGate(verifier, refusals, node.bus.graph)
        ring = qos.depth if exclusive is None else max(qos.depth, _EXCLUSIVE_RING)
        ring = ring_length(ring, max_bytes)
        subscriber = _declare_subscriber(node.bus.session, self._announcement.key, qos, ring)
        self._reader = ChannelReader(subscriber, self._receive, topic)

    @property
    def dropped(self) -> int:
        """Messages sent after the first one received here and never taken.

        They were lost on the way or in the ring, or dropped from the queue of pending messages.
        """
        return self._in_transit.lost + self._pending.dropped

    @property
    def invalid(self) -> int:
        """Messages that were too long, or could not be decoded to a valid message."""
        return self._too_long + self._malformed

    @property
    def refused(self) -> int:
        """Messages of publishers that are not entitled to an exclusive topic."""
        return self._gate.refusals.refused if self._gate is not None else 0

    @property
    def taken(self) -> MessageId | None:
        """Which message was taken last; None before, and if its publisher does not number them."""
        attachment = None if self._taken is None else keys.Attachment.of(self._taken)
        return None if attachment is None else MessageId(attachment.gid, attachment.sequence)

    def take(self) -> Any | None:
        """Remove, decode and return the oldest pending message; None if there is none.

        Raises `InvalidMessage` if it is not valid: no handler receives such a message.
        """
        pending = self._pending.take()
        if pending is None:
            return None
        payload, self._taken = pending
        try:
            data = payload if isinstance(payload, bytes) else payload.to_bytes()
            message = self._codec.decode(self._message, data)
        except InvalidMessage:
            self._malformed += 1
            raise
        self.received += 1
        if repairs := repairs_of(message):
            self._report_repairs(repairs)
        return message

    def close(self) -> None:
        """Stop receiving and discard the pending messages."""
        if self._closed:
            return
        self._closed = True
        self._reader.close()
        self._pending.clear()
        self._announcement.close()

    def _receive(self, sample: zenoh.Sample) -> None:
        size = len(sample.payload)
        if size > self._max_bytes:  # before it is copied or decoded
            self._reject_long(sample, size)
            return
        payload = sample.payload if self._gate is None else self._gate.verified(sample)
        if payload is None:
            return
        if self._pending.put((payload, sample), size):
            self._wake()
        # Last, because the wake-up may run the handler, which should not wait for this.
        attachment = keys.Attachment.of(sample)
        if attachment is not None:  # otherwise a peer without rmw_zenoh's numbering
            self._in_transit.received(attachment.gid, attachment.sequence)

    def _report_repairs(self, repairs: tuple[str, ...]) -> None:
        """Say once for each publisher what is repaired in its messages."""
        attachment = None if self._taken is None else keys.Attachment.of(self._taken)
        publisher = _publisher(self._graph, attachment)
        new = [text for text in repairs if (publisher, text) not in self._reported]
        if not new or len(self._reported) >= _MOST_REPORTED:  # a peer can take any number of names
            return
        self._reported.update((publisher, text) for text in new)
        self._warn(
            f"messages on {self._topic} from {publisher} are repaired ({'; '.join(new)}); this is "
            "said once"
        )

    def _reject_long(self, sample: zenoh.Sample, size: int) -> None:
        self._too_long += 1
        attachment = keys.Attachment.of(sample)
        self._long_messages.add(
            _publisher(self._graph, attachment),
            lambda named: too_long(self._topic, named, size, self._max_bytes),
        )
        if attachment is not None:  # it is not lost
            self._in_transit.received(attachment.gid, attachment.sequence)


class _ExclusiveGate:
    """Lets the samples of an exclusive topic's writer pass; refuses and reports all others."""

    def __init__(self, verifier: Verifier, refusals: RefusalLog, graph: GraphWatcher) -> None:
        self.refusals = refusals
        self._verifier = verifier
        self._graph = graph

    def verified(self, sample: zenoh.Sample) -> bytes | None:
        """Return the payload of a sample from the entitled writer; None if it is refused."""
        attachment = keys.Attachment.of(sample)
        try:
            if attachment is None:
                raise Refused("it is not signed")
            self._verifier.check_order(attachment.proof)
            payload = sample.payload.to_bytes()
            self._verifier.verify(attachment.head(), attachment.proof, payload)
        except Refused as error:
            self.refusals.refuse(self._publisher(attachment), str(error))
            return None
        return payload

    def _publisher(self, attachment: keys.Attachment | None) -> str:
        name = _publisher(self._graph, attachment)
        return f"a publisher that claims to be {name}" if name == self.refusals.writer else name


def _publisher(graph: GraphWatcher, attachment: keys.Attachment | None) -> str:
    """Return the name of the node that a sample claims to come from."""
    endpoint = None if attachment is None else graph.endpoint(attachment.gid)
    return "a publisher that is not in the graph" if endpoint is None else endpoint.node.name


def _declare_publisher(
    session: zenoh.Session, key: str, qos: Qos, ros_type: str, *, bulk: bool
) -> Any:
    """Map a topic's QoS to a Zenoh publisher.

    Reliability makes no difference: congestion control is DROP for all topics, because a writer
    that a reader blocks is the worse failure on a robot. Latched topics have a cache of `depth`.
    Bulk data have a lower priority, so that they do not delay small, urgent messages.
    """
    options: dict[str, Any] = {
        "encoding": zenoh.Encoding.APPLICATION_CDR.with_schema(ros_type),
        "congestion_control": zenoh.CongestionControl.DROP,
        "priority": zenoh.Priority.DATA_LOW if bulk else zenoh.Priority.INTERACTIVE_HIGH,
    }
    if not qos.latched:
        return session.declare_publisher(key, **options)
    return declare_advanced_publisher(
        session,
        key,
        **options,
        cache=CacheConfig(max_samples=qos.depth),
        publisher_detection=True,
        # Without heartbeats: in zenoh 1.10 closing a publisher that has some can block for 10 s
        # and leave the session's links dead; readers find gaps by the next message.
        sample_miss_detection=MissDetectionConfig(heartbeat=None, sporadic_heartbeat=None),
    )


def _declare_subscriber(session: zenoh.Session, key: str, qos: Qos, ring: int) -> Any:
    """Map a topic's QoS to a Zenoh subscriber with a ring of that many samples.

    A latched topic's subscriber also receives the samples in its publishers' caches.
    """
    channel: Any = zenoh.handlers.RingChannel(ring)
    if not qos.latched:
        return session.declare_subscriber(key, channel)
    return declare_advanced_subscriber(
        session,
        key,
        channel,
        history=HistoryConfig(detect_late_publishers=True, max_samples=qos.depth),
    )
