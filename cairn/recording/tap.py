"""A tap delivers every message on a bus, as bytes and with its publisher.

Over Zenoh it works in the session of a client and in that of a component. It never slows a
publisher: Zenoh moves each sample into a ring, from which a thread of the tap takes it.
"""

from __future__ import annotations

import queue
import re
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple, Protocol

import zenoh

from cairn.bus import keys
from cairn.bus.caches import query_caches
from cairn.bus.codec import Codec
from cairn.bus.graph import GraphReader
from cairn.bus.lockstep_bus import LockstepBus, LockstepPublisher
from cairn.bus.qos import Qos
from cairn.bus.type_hash import type_hash
from cairn.recording.topics import TopicPatterns
from cairn.schemas.message import type_name

EVERY_TOPIC = ("/**",)

_RING = 4096
"""Samples that wait for the tap's thread, which holds none of them up."""
_PAUSE_S = 0.02
"""Pause in which samples gather: waking the thread for each one takes twice the processor time."""

_MAX_PUBLISHERS = 20_000
_MAX_KEYS = 10_000
_LONGEST_KEY = 1000  # characters
_CACHE_LIMIT_S = 5.0


class Sample(NamedTuple):
    """One message on the bus.

    `topic` is its full name, `payload` its CDR. `gid` is the 16-byte identity of its publisher,
    which counts its messages in `sequence`, from 1. A foreign publisher that sends neither has one
    made of the key expression, and its messages are counted as they arrive. `sent_ns` and
    `received_ns`, which is up to 20 ms late, are in nanoseconds since 1970-01-01 UTC; in lockstep
    both are virtual time.
    """

    topic: str
    type_name: str
    type_hash: str
    payload: bytes
    gid: bytes
    sequence: int
    sent_ns: int
    received_ns: int


class PublisherInfo(NamedTuple):
    """What the graph has of a publisher: the full name of its node, and its QoS."""

    node: str
    qos: Qos


class Tap(Protocol):
    """Delivers the messages on a bus until it is closed."""

    @property
    def lost(self) -> Counter[str]:
        """Number of messages lost on the way to the tap, by topic, from gaps in their numbers."""

    @property
    def refused(self) -> int:
        """Number of samples that are not messages, or came from too many topics."""

    def publisher(self, gid: bytes) -> PublisherInfo | None:
        """Return what is known of a publisher; None if the graph does not have it (yet)."""

    def is_present(self, gid: bytes) -> bool:
        """Return whether a publisher that was known has not ended."""

    def close(self) -> None:
        """Deliver nothing any more."""


class ZenohTap:
    """Delivers every message that reaches a Zenoh session; latched ones of before, too."""

    def __init__(
        self,
        session: zenoh.Session,
        domain: int,
        receive: Callable[[Sample], None],
        topics: Sequence[str] = EVERY_TOPIC,
        *,
        is_client: bool = True,
    ) -> None:
        """Open it; `receive` is called on threads of the tap and of Zenoh, and must be quick.

        `topics` are patterns of full names (`TopicPatterns`). `is_client`: whether the session is
        that of a client (`open_client`), or of a component.
        """
        self.lost: Counter[str] = Counter()
        self.refused = 0
        self._session = session
        self._domain = domain
        self._receive = receive
        self._lock = threading.Lock()
        self._known: dict[bytes, PublisherInfo] = {}
        self._ended: dict[bytes, None] = {}
        self._keys: dict[str, tuple[str, str, str]] = {}
        self._followed: dict[bytes, _Numbers] = {}
        self._wanted = TopicPatterns(topics)
        self._present: Mapping[str, keys.EndpointEntity] = {}
        self._closed = False
        self._tokens: queue.Queue[zenoh.Sample | None] = queue.Queue(_MAX_PUBLISHERS)
        pattern = keys.endpoints_pattern(domain, kind="MP")
        self._reader: GraphReader | None = None
        self._token_subscriber: Any = None
        if is_client:
            self._reader = GraphReader(session, pattern, self._note_all)
        else:
            handler: Any = zenoh.handlers.Callback(self._queue_token, indirect=False)
            self._token_subscriber = session.liveliness().declare_subscriber(
                pattern, handler, history=True
            )
        self._expressions = [
            str(zenoh.KeyExpr.autocanonize(f"{domain}/{topic}/*/*"))
            for topic in _disjoint(self._wanted.patterns)
        ]
        self._subscribers = [
            session.declare_subscriber(key, zenoh.handlers.RingChannel(_RING))
            for key in self._expressions
        ]
        self._threads = [
            threading.Thread(target=self._collect, args=(one.handler,), name="cairn tap")
            for one in self._subscribers
        ]
        if not is_client:
            self._threads.append(
                threading.Thread(target=self._follow_graph, name="cairn tap graph")
            )
        for thread in self._threads:
            thread.daemon = True
            thread.start()
        for key in self._expressions:
            self._ask_caches(key)

    def publisher(self, gid: bytes) -> PublisherInfo | None:
        """Return what is known of a publisher; None if the graph does not have it (yet)."""
        return self._known.get(gid)

    def is_present(self, gid: bytes) -> bool:
        """Return whether a publisher that was known has not ended."""
        return gid not in self._ended

    def close(self) -> None:
        """Deliver nothing any more."""
        if self._closed:
            return
        self._closed = True
        if self._reader is not None:
            self._reader.close()
        with suppress(zenoh.ZError):  # the session is closed
            for subscriber in self._subscribers:
                subscriber.undeclare()
            if self._token_subscriber is not None:
                self._token_subscriber.undeclare()
        with suppress(queue.Full):
            self._tokens.put_nowait(None)
        for thread in self._threads:
            thread.join(timeout=2.0)

    def _collect(self, channel: Any) -> None:
        while True:
            try:
                sample = channel.recv()
                while sample is not None:
                    self._deliver(sample, cached=False)
                    sample = channel.try_recv()
            except zenoh.ZError:  # the subscriber was undeclared
                return
            time.sleep(_PAUSE_S)

    def _deliver(self, sample: zenoh.Sample, *, cached: bool) -> None:
        received_ns = time.time_ns()
        key = str(sample.key_expr)
        parsed = self._keys.get(key) or self._parsed(key)
        if parsed is None or sample.kind != zenoh.SampleKind.PUT:
            self.refused += 1
            return
        attachment = keys.Attachment.of(sample)
        gid = keys.gid(key) if attachment is None else attachment.gid
        number = 0 if attachment is None else attachment.sequence
        with self._lock:
            numbers = self._followed.get(gid)
            if numbers is None:
                if len(self._followed) >= _MAX_PUBLISHERS:
                    self.refused += 1
                    return
                numbers = self._followed[gid] = _Numbers()
                if self._reader is not None and gid not in self._known:
                    self._reader.read_soon()
            if attachment is None:
                number = numbers.last + 1
            if not numbers.accept(number, cached=cached):
                return
            lost, numbers.lost = numbers.lost, 0
        topic, ros_type, digest = parsed
        if lost:
            self.lost[topic] += lost
        sent_ns = received_ns if attachment is None else attachment.sent_ns
        payload = sample.payload.to_bytes()
        self._receive(Sample(topic, ros_type, digest, payload, gid, number, sent_ns, received_ns))

    def _parsed(self, key: str) -> tuple[str, str, str] | None:
        """Return topic, type name and type hash of a key; None if it is not that of a message."""
        if len(self._keys) >= _MAX_KEYS or len(key) > _LONGEST_KEY:
            return None
        _, *names, dds, digest = key.split("/") if key.count("/") > 2 else ("", "", "")
        if not names or not (key.isascii() and key.isprintable()):
            return None
        try:
            parsed = "/" + "/".join(names), keys.ros_type(dds), digest
        except keys.WireFormatError:
            return None
        self._keys[key] = parsed
        return parsed

    def _queue_token(self, token: zenoh.Sample) -> None:
        with suppress(queue.Full):  # such a graph is forged
            self._tokens.put_nowait(token)

    def _follow_graph(self) -> None:
        while (token := self._tokens.get()) is not None:
            key = str(token.key_expr)
            try:
                entity = keys.parse_token(key)
            except keys.WireFormatError:
                continue
            if isinstance(entity, keys.EndpointEntity):
                self._note(key, entity, ended=token.kind == zenoh.SampleKind.DELETE)

    def _note_all(self, endpoints: Mapping[str, keys.EndpointEntity]) -> None:
        """Note the publishers that have appeared or ended since the last reading."""
        before, self._present = self._present, endpoints
        for key, entity in endpoints.items():
            if key not in before:
                self._note(key, entity, ended=False)
        for key, entity in before.items():
            if key not in endpoints:
                self._note(key, entity, ended=True)

    def _note(self, key: str, entity: keys.EndpointEntity, *, ended: bool) -> None:
        if not self._wanted.match(entity.topic):
            return
        gid = keys.gid(key)
        if ended:
            if gid in self._known:
                self._ended[gid] = None
        elif gid in self._known:
            self._ended.pop(gid, None)
        elif len(self._known) < _MAX_PUBLISHERS:
            self._known[gid] = PublisherInfo(entity.node.name, entity.qos)
            if entity.qos.latched:  # it may have published before it knew of this tap
                self._ask_caches(entity.data_key)

    def _ask_caches(self, key: str) -> None:
        """Have the latched publishers of a key send what they keep, without waiting."""

        def add(reply: zenoh.Reply) -> None:
            if reply.ok is not None and not self._closed:
                self._deliver(reply.ok, cached=True)

        with suppress(zenoh.ZError):  # the session is closed
            query_caches(self._session, key, add, lambda: None, _CACHE_LIMIT_S)


class _Numbers:
    """The numbers of one publisher's messages that were delivered, live or from its cache."""

    __slots__ = ("_cached", "_first", "last", "lost")

    def __init__(self) -> None:
        self.last = 0  # the last live one
        self.lost = 0
        self._first: int | None = None  # the first live one
        self._cached = 0

    def accept(self, number: int, *, cached: bool) -> bool:
        """Return whether a message was not delivered before."""
        if cached:
            if number <= self._cached or (self._first is not None and number >= self._first):
                return False
            self._cached = number
            return True
        if 0 < number <= self._cached:
            return False
        if self._first is None:
            self._first = number
        elif 1 < number - self.last < 1 << 32:  # a greater jump is the publisher's defect
            self.lost = number - self.last - 1
        self.last = number
        return True


class LockstepTap:
    """Delivers every message on the lockstep bus, within the call that publishes it."""

    def __init__(
        self,
        bus: LockstepBus,
        now: Callable[[], int],
        receive: Callable[[Sample], None],
        topics: Sequence[str] = EVERY_TOPIC,
    ) -> None:
        """Open it; `now` is virtual time [ns], `topics` are patterns as those of `ZenohTap`."""
        self.lost: Counter[str] = Counter()
        self.refused = 0
        self._bus = bus
        self._now = now
        self._receive = receive
        self._codec = Codec()
        self._wanted = TopicPatterns(topics)
        self._known: dict[bytes, PublisherInfo] = {}
        self._matches: dict[str, bool] = {}
        for publisher, message, identity in bus.latched():
            self._deliver(publisher, message, identity.sequence)
        bus.taps.append(self._on_message)

    def publisher(self, gid: bytes) -> PublisherInfo | None:
        """Return what is known of a publisher; None if there was none."""
        return self._known.get(gid)

    def is_present(self, gid: bytes) -> bool:
        """Return whether there has been such a publisher."""
        return gid in self._known

    def close(self) -> None:
        """Deliver nothing any more."""
        if self._on_message in self._bus.taps:
            self._bus.taps.remove(self._on_message)

    def _on_message(self, publisher: LockstepPublisher, message: Any) -> None:
        self._deliver(publisher, message, publisher.sequence)

    def _deliver(self, publisher: LockstepPublisher, message: Any, number: int) -> None:
        topic = publisher.topic
        wanted = self._matches.get(topic)
        if wanted is None:
            wanted = self._matches[topic] = self._wanted.match(topic)
        if not wanted:
            return
        gid = publisher.gid
        if gid not in self._known:
            self._known[gid] = PublisherInfo(publisher.node.name, publisher.qos)
        cls, now = publisher.message, self._now()
        payload = self._codec.encode(message)
        self._receive(Sample(topic, type_name(cls), type_hash(cls), payload, gid, number, now, now))


def _disjoint(patterns: Sequence[str]) -> list[str]:
    """Return key expressions that cover all patterns, and of which no two match the same topic."""
    chosen: list[zenoh.KeyExpr] = []
    for pattern in patterns:
        one = zenoh.KeyExpr.autocanonize(_key_expression(pattern))
        if any(other.includes(one) for other in chosen):
            continue
        chosen = [other for other in chosen if not one.includes(other)]
        if any(other.intersects(one) for other in chosen):
            return ["**"]
        chosen.append(one)
    return [str(one) for one in chosen]


def _key_expression(pattern: str) -> str:
    chunks = pattern.strip("/").split("/")
    return "/".join(
        chunk if chunk in ("*", "**") else re.sub(r"\*+", "$*", chunk) for chunk in chunks
    )
