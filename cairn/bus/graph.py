"""The graph: which nodes are on the bus and what they publish and subscribe, from their tokens."""

import itertools
import logging
import queue
import threading
import time
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import zenoh

from cairn.bus import keys
from cairn.errors import CairnError

_MAX_TOKENS = 20_000
"""A graph that is larger is not read completely: a robot has some hundreds of tokens."""

_MAX_ENDPOINTS = 1000
"""A topic with so many endpoints is not followed any further: a robot's topic has some ten."""

_POLL_S = 0.1
"""Interval for reading what has changed: one thread for all topics, at any rate of changes."""

_POLLS_PER_TOPIC = 5
"""Every so many intervals one more topic is followed, of those that can wait.

A subscription costs the router 24 ms if other programs have announced 10,000 endpoints: those of a
whole robot at once would delay its start.
"""

_log = logging.getLogger("cairn.graph")


def read_graph(
    session: zenoh.Session,
    pattern: str,
    timeout_s: float = 10.0,
    *,
    patience_s: float | None = None,
) -> list[keys.NodeEntity | keys.EndpointEntity]:
    """Return the nodes and endpoints alive whose tokens match a pattern, sorted by their tokens.

    The router sends all tokens that match, and no others, so the narrowest pattern is the fastest:
    see `cairn.bus.keys`. After `patience_s` [s] it returns what has arrived, perhaps nothing.

    For the session of a client (`open_client`): to a peer, zenoh 1.10 may declare the reply
    complete before all of it has arrived. Peers follow the graph with `GraphWatcher`. Raises
    `CairnError` if the router has not answered by the timeout [s].
    """
    tokens: list[str] = []
    replies: queue.Queue[zenoh.Reply | None] = queue.Queue()
    handler: Any = zenoh.handlers.Callback(replies.put, lambda: replies.put(None), indirect=False)
    session.liveliness().get(pattern, handler, timeout=timeout_s)
    deadline = None if patience_s is None else time.monotonic() + patience_s
    while True:
        try:
            left_s = None if deadline is None else max(0.0, deadline - time.monotonic())
            reply = replies.get(timeout=left_s)
        except queue.Empty:
            _log.warning("graph too large: only %d tokens are read in time", len(tokens))
            break
        if reply is None:
            break
        if reply.ok is None:
            raise CairnError(
                f"the router did not list the components within {timeout_s:g} s: its process hangs "
                "or is stopped; end that `cairn up`, and start it again"
            )
        tokens.append(str(reply.ok.key_expr))
        if len(tokens) == _MAX_TOKENS:
            _log.warning("graph too large: only the first %d tokens are read", _MAX_TOKENS)
            break
    return list(_parsed(sorted(tokens)))


class GraphWatcher:
    """Reports the endpoints of topics, those that exist already and those that appear.

    It subscribes to the tokens of these topics alone, because each token that another program
    declares is sent to every process that subscribes to it.
    """

    def __init__(self, session: zenoh.Session, domain: int) -> None:
        """Follow nothing yet: `start` does."""
        self._session = session
        self._domain = domain
        self._lock = threading.Lock()
        self._reading = threading.Lock()  # the changes of a token are read in their order
        self._topics: dict[str, _Topic] = {}
        self._by_gid: dict[bytes, keys.EndpointEntity] = {}
        self._closed = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Follow the watched topics from now on.

        Zenoh then sends this process the tokens of these topics, which takes seconds if another
        process has declared thousands: after the start of a component they delay nothing.
        """
        with self._lock:
            if self._thread is not None:
                return
            self._thread = threading.Thread(target=self._follow, name="cairn graph", daemon=True)
            for name, topic in self._topics.items():
                if topic.is_urgent:
                    self._subscribe(name, topic)
        self._thread.start()

    def watch(
        self,
        topic: str,
        on_endpoint: Callable[[keys.EndpointEntity], None],
        *,
        is_urgent: bool = True,
    ) -> Callable[[], None]:
        """Call `on_endpoint` for every endpoint of a topic (full name), now and later.

        If it is not urgent, this may begin some seconds after the start. Returns a function that
        stops it.
        """
        with self._lock:
            followed = self._topics.setdefault(topic, _Topic())
            followed.is_urgent |= is_urgent
            if followed.is_urgent and not followed.is_followed and self._thread is not None:
                self._subscribe(topic, followed)
            followed.callbacks.append(on_endpoint)
            present = list(followed.endpoints.values())
        for endpoint in present:
            on_endpoint(endpoint)

        def stop() -> None:
            with self._lock:
                if on_endpoint not in followed.callbacks:
                    return
                followed.callbacks.remove(on_endpoint)
                if followed.callbacks:
                    return
                del self._topics[topic]
                for token in followed.endpoints:
                    self._by_gid.pop(keys.gid(token), None)
                subscriber, followed.subscriber = followed.subscriber, None
            if subscriber is not None:
                subscriber.undeclare()

        return stop

    def endpoint(self, gid: bytes) -> keys.EndpointEntity | None:
        """Return the endpoint that has this identity; None if no watched topic has it."""
        if gid not in self._by_gid:
            self._read_changes()
        return self._by_gid.get(gid)

    def close(self) -> None:
        """Stop following the graph."""
        self._closed.set()
        if self._thread is not None:
            self._thread.join(timeout=2.0)
        with self._lock:
            subscribers = [topic.subscriber for topic in self._topics.values() if topic.subscriber]
            for topic in self._topics.values():
                topic.subscriber = None
        for subscriber in subscribers:
            subscriber.undeclare()

    def _subscribe(self, name: str, topic: "_Topic") -> None:
        topic.is_followed = True
        topic.subscriber = self._session.liveliness().declare_subscriber(
            keys.endpoints_pattern(self._domain, name),
            zenoh.handlers.RingChannel(_MAX_ENDPOINTS),
            history=True,
        )

    def _follow(self) -> None:
        for number in itertools.count():
            if self._closed.wait(_POLL_S):
                return
            if number % _POLLS_PER_TOPIC == 0:
                self._follow_one_more()
            self._read_changes()

    def _follow_one_more(self) -> None:
        with self._lock:
            for name, topic in self._topics.items():
                if not topic.is_followed:
                    self._subscribe(name, topic)
                    return

    def _read_changes(self) -> None:
        with self._lock:
            topics = list(self._topics.items())
        for name, topic in topics:
            calls: list[Callable[[], None]] = []
            with self._reading:
                for _ in range(_MAX_ENDPOINTS):
                    sample = topic.next_change()
                    if sample is None:
                        break
                    calls += self._changed(name, topic, sample)
            for call in calls:
                call()

    def _changed(
        self, name: str, topic: "_Topic", sample: zenoh.Sample
    ) -> list[Callable[[], None]]:
        """Remember a change; return the calls to make."""
        token = str(sample.key_expr)
        entity = next(iter(_parsed([token])), None)
        calls: list[Callable[[], None]] = []
        crowded = None
        with self._lock:
            if self._topics.get(name) is not topic:  # no longer watched
                return []
            if not isinstance(entity, keys.EndpointEntity):
                topic.malformed += 1
            elif sample.kind == zenoh.SampleKind.DELETE:
                topic.endpoints.pop(token, None)
                self._by_gid.pop(keys.gid(token), None)
            else:
                if token not in topic.endpoints:
                    calls = [partial(callback, entity) for callback in topic.callbacks]
                topic.endpoints[token] = entity
                self._by_gid[keys.gid(token)] = entity
            if len(topic.endpoints) + topic.malformed >= _MAX_ENDPOINTS:
                crowded, topic.subscriber = topic.subscriber, None
        if crowded is not None:
            crowded.undeclare()
            _log.warning(
                "stopped following the endpoints of %s: it has %d or more, so further ones with "
                "another type are not reported; end the program that announces them, then "
                "restart this component",
                name,
                _MAX_ENDPOINTS,
            )
        return calls


class _Topic:
    """What is known of a watched topic."""

    def __init__(self) -> None:
        self.endpoints: dict[str, keys.EndpointEntity] = {}
        self.callbacks: list[Callable[[keys.EndpointEntity], None]] = []
        self.is_urgent = False
        self.is_followed = False  # or it was, until it was crowded
        self.malformed = 0  # tokens that have appeared or disappeared
        self.subscriber: zenoh.Subscriber[Any] | None = None

    def next_change(self) -> zenoh.Sample | None:
        """Return the next change that has arrived, if any."""
        subscriber = self.subscriber
        try:
            return None if subscriber is None else subscriber.handler.try_recv()
        except zenoh.ZError:  # another thread has just undeclared it
            return None


def _parsed(tokens: Iterable[str]) -> Iterable[keys.NodeEntity | keys.EndpointEntity]:
    for token in tokens:
        try:
            yield keys.parse_token(token)
        except keys.WireFormatError:
            continue  # a token of another profile or version, which is not of our graph
