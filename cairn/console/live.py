"""The live source: channels and messages of the robots on a bus.

Zenoh's thread only moves samples into rings (Rust). A thread for each subscribed topic takes them
from its ring and passes one at a time to the event loop, so a busy console loses the oldest samples
and delays neither the link nor the robot.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

import zenoh

from cairn.bus import keys
from cairn.bus.graph import GraphReader
from cairn.bus.message_limits import MAX_MESSAGE_SIZE, ring_length
from cairn.client.connection import Connection, Publishers
from cairn.console.message_types import MessageTypes
from cairn.console.source import Channel, ConnectionGraph, Message
from cairn.errors import CairnError

if TYPE_CHECKING:
    from cairn.console.hub import Hub

_MAX_CHANNELS: Final = 2_000
_MAX_KEPT: Final = 100  # messages of one publisher of a latched topic
_MAX_DEPTH: Final = 1_000
_MAX_PUBLISHERS: Final = 100  # of one topic
_KEPT_BYTES: Final = 32 << 20  # of one latched topic; the newest of each publisher always
_RING: Final = 16
_CHECK_S: Final = 0.5
_LOST_AFTER: Final = 3  # checks without a link
_FIRST_RETRY_S: Final = 0.5
_LAST_RETRY_S: Final = 5.0
_LINGER_S: Final = 2.0
_PASS_ON_LIMIT_S: Final = 10.0

_LOST: Final = (
    "the connection to the robot is lost: its deployment has ended or is restarting; the console "
    "connects again by itself"
)
_NO_CONNECTION: Final = "there is no connection to the robot now; the console tries again"


@dataclass(frozen=True)
class _LiveTopic:
    """A channel and how it is read."""

    channel: Channel
    key: str
    ring: int  # samples that wait in Zenoh
    publishers: frozenset[bytes]  # their gids


class LiveSource:
    """The robots that one router reaches; it reconnects by itself."""

    def __init__(self, endpoint: str = "", domain: int = 0) -> None:
        """`endpoint` is where the router listens: as for commands, "" is this user's."""
        self._endpoint = endpoint
        self._domain = domain
        self._connection: Connection | None = None
        self._hub: Hub | None = None
        self._topics: dict[int, _LiveTopic] = {}
        self._readers: dict[int, _TopicReader] = {}
        self._ending: dict[int, asyncio.TimerHandle] = {}  # readers without a browser
        self._inputs: dict[tuple[str, str], str] = {}  # keys, by topic and type
        self._endpoints: Mapping[str, keys.EndpointEntity] = {}
        self._types = MessageTypes()
        self._learning: asyncio.Task[None] | None = None
        self._ids: dict[tuple[str, str, str, str], int] = {}  # topic, type, hash, schema
        self._publishers: Publishers | None = None  # of the connection

    @property
    def mode(self) -> Literal["live", "recording"]:
        """It is a bus."""
        return "live"

    @property
    def recording(self) -> None:
        """There is none."""

    @property
    def connection(self) -> Connection:
        """The connection to the bus; `CairnError` if there is none now."""
        if self._connection is None:
            raise CairnError(_NO_CONNECTION)
        return self._connection

    async def run(self, hub: Hub) -> None:
        """Connect, follow the graph, and connect again when the link is lost, until canceled."""
        self._hub = hub
        retry_s = _FIRST_RETRY_S
        while True:
            try:
                connection = await asyncio.to_thread(Connection.open, self._endpoint, self._domain)
            except CairnError as error:
                hub.set_link(str(error))
                await asyncio.sleep(retry_s)
                retry_s = min(2 * retry_s, _LAST_RETRY_S)
                continue
            retry_s = _FIRST_RETRY_S
            try:
                with suppress(zenoh.ZError):  # the session has ended meanwhile
                    await self._follow(hub, connection)
                hub.set_link(_LOST)
            finally:
                await self._disconnect(connection)

    async def _follow(self, hub: Hub, connection: Connection) -> None:
        """Report the graph until the link is lost."""
        loop = asyncio.get_running_loop()
        self._connection, self._publishers = connection, Publishers(connection)
        hub.set_link()

        def take_over(endpoints: Mapping[str, keys.EndpointEntity]) -> None:
            if self._connection is connection:
                self._set_tokens(endpoints)

        def report(endpoints: Mapping[str, keys.EndpointEntity]) -> None:
            with suppress(RuntimeError):  # the event loop has ended
                loop.call_soon_threadsafe(take_over, endpoints)

        pattern = keys.endpoints_pattern(connection.domain, kind="M$*")
        graph = GraphReader(connection.session, pattern, report)
        try:
            missing = 0
            # Not session.is_closed(), which may wait forever: see Connection.is_alive.
            while missing < _LOST_AFTER:
                await asyncio.sleep(_CHECK_S)
                has_link = bool(list(connection.session.info.routers_zid()))
                missing = 0 if has_link else missing + 1
        finally:
            graph.close()

    async def _disconnect(self, connection: Connection) -> None:
        self._connection = self._publishers = None
        self._set_tokens({})
        await asyncio.to_thread(connection.close)

    def subscribe(self, channel: Channel) -> None:
        """Read a topic: the latched messages first."""
        reader = self._readers.get(channel.id)
        topic = self._topics.get(channel.id)
        if reader is not None and self._hub is not None:  # it was about to end
            self._ending.pop(channel.id).cancel()
            for message in reader.kept():
                self._hub.deliver(channel.id, message)
        elif topic is not None and self._connection is not None and self._hub is not None:
            self._readers[channel.id] = _TopicReader(self._connection, topic, self._hub.deliver)

    def unsubscribe(self, channel: Channel) -> None:
        """Read a topic no longer, unless it is subscribed again soon.

        So a browser that subscribes and unsubscribes endlessly does not burden the robot.
        """
        if channel.id in self._readers:
            loop = asyncio.get_running_loop()
            self._ending[channel.id] = loop.call_later(_LINGER_S, self._end, channel.id)

    def _end(self, id_: int) -> None:
        ending = self._ending.pop(id_, None)
        if ending is not None:
            ending.cancel()
        self._readers.pop(id_).close()

    def kept(self, channel: Channel) -> Sequence[Message]:
        """Return the last messages of a latched topic that is being read."""
        reader = self._readers.get(channel.id)
        return [] if reader is None else reader.kept()

    async def publish(self, topic: str, type_name: str, payload: bytes) -> None:
        """Publish CDR on a topic that a component subscribes to; `CairnError` if none does.

        Over the network, the user's role decides on which topics.
        """
        publishers = self._publishers
        if publishers is None:
            raise CairnError(_NO_CONNECTION)
        key = self._input_key(topic, type_name, payload)
        try:
            await asyncio.to_thread(publishers.put, key, type_name, payload)
        except zenoh.ZError as error:
            raise CairnError(f"{topic} is not published: {error}") from error

    def _input_key(self, topic: str, type_name: str, payload: bytes) -> str:
        key = self._inputs.get((topic, type_name))
        if key is None:
            raise CairnError(
                f"{topic} is not published: no component subscribes to it with {type_name}; "
                "choose an input of the robot, and its type"
            )
        known = self._types.find(type_name)
        if known is not None and len(payload) > known.max_bytes:
            raise CairnError(
                f"{topic} is not published: {len(payload):,} bytes are more than the "
                f"{known.max_bytes:,} that {type_name} has at most"
            )
        return key

    def _set_tokens(self, endpoints: Mapping[str, keys.EndpointEntity]) -> None:
        """Take over all endpoints that exist, by token; for the event loop."""
        assert self._hub is not None
        self._endpoints = endpoints
        self._topics = self._topics_of(endpoints)
        self._inputs = {
            (one.topic, one.type_name): one.data_key
            for one in endpoints.values()
            if one.kind == "MS"
        }
        publishers: defaultdict[str, set[str]] = defaultdict(set)
        subscribers: defaultdict[str, set[str]] = defaultdict(set)
        for one in endpoints.values():
            nodes = publishers if one.kind == "MP" else subscribers
            nodes[one.topic].add(one.node.name)
        self._hub.set_channels([topic.channel for topic in self._topics.values()])
        foreign = {one.node.name for one in endpoints.values() if one.node.is_foreign}
        self._hub.set_graph(ConnectionGraph(publishers, subscribers, foreign))
        for id_, reader in list(self._readers.items()):
            if id_ in self._topics:
                reader.set_publishers(self._topics[id_].publishers)
            else:
                self._end(id_)

    def _topics_of(self, endpoints: Mapping[str, keys.EndpointEntity]) -> dict[int, _LiveTopic]:
        """Return the topics that have a publisher, by channel."""
        found: defaultdict[tuple[str, str, str], dict[str, keys.EndpointEntity]] = defaultdict(dict)
        for token, one in endpoints.items():
            if one.kind == "MP":
                found[one.topic, one.type_name, one.type_hash][token] = one
        topics = {}
        for (name, type_, hash_), by_token in sorted(found.items())[:_MAX_CHANNELS]:
            publishers = list(by_token.values())
            known = self._types.find(type_)
            if known is None:
                self._learn_types()
            elif known.type_hash != hash_:
                known = None  # another definition
            schema = "" if known is None else known.schema
            id_ = self._ids.setdefault((name, type_, hash_, schema), len(self._ids) + 1)
            is_sensor = any(one.qos.reliability == "best_effort" for one in publishers)
            if is_sensor or (known is not None and known.is_bulk):
                depth = 1  # the newest wins
            else:
                depth = min(_MAX_DEPTH, max(one.qos.depth for one in publishers))
            is_latched = any(one.qos.latched for one in publishers)
            channel = Channel(id_, name, type_, schema, is_latched, depth)
            limit = MAX_MESSAGE_SIZE if known is None else known.max_bytes
            ring = ring_length(max(_RING, depth), limit)
            gids = frozenset(map(keys.gid, by_token))
            topics[id_] = _LiveTopic(channel, publishers[0].data_key, ring, gids)
        return topics

    def _learn_types(self) -> None:
        """Find out the types of plugins, once; then those channels get their schemas."""
        if self._learning is None:
            self._learning = asyncio.create_task(self._types.load_plugins())
            self._learning.add_done_callback(self._use_learned)

    def _use_learned(self, learning: asyncio.Task[None]) -> None:
        if not learning.cancelled():
            self._set_tokens(self._endpoints)


class _TopicReader:
    """Reads one topic on a thread of its own, and passes one message at a time to the loop."""

    def __init__(
        self,
        connection: Connection,
        topic: _LiveTopic,
        deliver: Callable[[int, Message], None],
    ) -> None:
        """For the event loop, as all methods."""
        self._connection = connection
        self._channel = topic.channel
        self._key, self._ring = topic.key, topic.ring
        self._publishers = topic.publishers
        self._deliver = deliver
        self._loop = asyncio.get_running_loop()
        self._closed = threading.Event()
        self._arrived = threading.Event()
        self._passing = threading.Lock()
        self._last: dict[bytes, int] = {}  # sequence number, by publisher
        self._kept: dict[bytes, deque[Message]] = {}  # by publisher
        self._subscriber: Any = None
        self._undeclaring = threading.Lock()
        self._start(self._read)

    def close(self) -> None:
        """Stop reading; does not wait."""
        self._closed.set()
        self._arrived.set()
        if self._subscriber is not None:
            self._start(self._undeclare)

    def kept(self) -> list[Message]:
        """Return the last messages, oldest first."""
        return sorted(message for messages in self._kept.values() for message in messages)

    def set_publishers(self, publishers: frozenset[bytes]) -> None:
        """Forget what is kept of publishers that have ended, and read what new ones keep."""
        new = publishers - self._publishers
        for gid in self._publishers - publishers:
            self._kept.pop(gid, None)
        self._publishers = publishers
        if new and self._channel.latched:
            self._start(self._read_kept)

    def _start(self, target: Callable[[], None]) -> None:
        threading.Thread(target=target, name=self._channel.topic, daemon=True).start()

    def _read(self) -> None:
        handler: Any = zenoh.handlers.RingChannel(self._ring)
        try:
            self._subscriber = self._connection.subscriber(self._key, handler, latched=False)
            ring_of_samples = self._subscriber.handler  # while another thread may undeclare it
            if self._channel.latched:  # meanwhile the ring collects what is published
                self._read_kept()
            while not self._closed.is_set():
                self._pass_on([ring_of_samples.recv()])
        except zenoh.ZError:  # the subscriber was undeclared, or the session has ended
            return
        self._undeclare()

    def _undeclare(self) -> None:
        with self._undeclaring, suppress(zenoh.ZError):
            self._subscriber.undeclare()

    def _read_kept(self) -> None:
        with suppress(zenoh.ZError):
            samples, _ = self._connection.cached(self._key)
            self._pass_on(sorted(samples, key=keys.sent_ns))

    def _pass_on(self, samples: Iterable[Any]) -> None:
        """Pass samples to the event loop one by one, those that are not older than the last."""
        with self._passing:
            for sample in samples:
                sent = keys.Attachment.of(sample)
                gid = b"" if sent is None else sent.gid
                if sent is not None:
                    if sent.sequence <= self._last.get(gid, 0):
                        continue
                    if len(self._last) >= _MAX_PUBLISHERS:
                        self._last.clear()
                    self._last[gid] = sent.sequence
                time_ns = time.time_ns() if sent is None else sent.sent_ns
                message = Message(time_ns, sample.payload.to_bytes())
                self._arrived.clear()
                if self._closed.is_set():
                    return
                try:
                    self._loop.call_soon_threadsafe(self._receive, gid, message)
                except RuntimeError:  # the loop has ended
                    return
                self._arrived.wait(_PASS_ON_LIMIT_S)

    def _receive(self, gid: bytes, message: Message) -> None:
        self._arrived.set()
        if self._closed.is_set():
            return
        if self._channel.latched:
            self._keep(gid, message)
        self._deliver(self._channel.id, message)

    def _keep(self, gid: bytes, message: Message) -> None:
        depth = min(self._channel.depth, _MAX_KEPT)
        self._kept.setdefault(gid, deque(maxlen=depth)).append(message)
        while len(self._kept) > _MAX_PUBLISHERS:
            del self._kept[next(iter(self._kept))]
        while self._kept_bytes() > _KEPT_BYTES and sum(map(len, self._kept.values())) > 1:
            oldest = min(self._kept, key=lambda one: self._kept[one][0])
            self._kept[oldest].popleft()
            if not self._kept[oldest]:
                del self._kept[oldest]

    def _kept_bytes(self) -> int:
        return sum(len(one.payload) for messages in self._kept.values() for one in messages)
