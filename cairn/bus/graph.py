"""The graph: which nodes are on the bus and what they publish and subscribe, from their tokens."""

import logging
import queue
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

import zenoh

from cairn.bus import keys
from cairn.errors import CairnError

_MAX_PENDING = 10_000
"""Changes of the graph that wait to be processed."""

_MAX_TOKENS = 20_000
"""A graph that is larger is not read completely: a robot has some hundreds of tokens."""

_MAX_ENDPOINTS = 10_000
"""So many endpoints a process remembers: the newest."""

_log = logging.getLogger("cairn.graph")


def read_graph(
    session: zenoh.Session, domain: int, timeout_s: float = 10.0, *, patience_s: float | None = None
) -> list[keys.NodeEntity | keys.EndpointEntity]:
    """Return all nodes and endpoints alive in a domain, sorted by their tokens.

    After `patience_s` [s] it returns what has arrived, perhaps nothing.

    For the session of a client (`open_client`): to a peer, zenoh 1.10 may declare the reply
    complete before all of it has arrived. Peers follow the graph with `GraphWatcher`. Raises
    `CairnError` if the router has not answered by the timeout [s].
    """
    tokens: list[str] = []
    replies: queue.Queue[zenoh.Reply | None] = queue.Queue()
    handler: Any = zenoh.handlers.Callback(replies.put, lambda: replies.put(None), indirect=False)
    session.liveliness().get(keys.tokens_pattern(domain), handler, timeout=timeout_s)
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
    """Reports each endpoint of the domain, those that exist already and those that appear."""

    def __init__(self, session: zenoh.Session, domain: int) -> None:
        """Follow nothing yet: `start` does."""
        self._session = session
        self._domain = domain
        self._subscriber: zenoh.Subscriber[Any] | None = None
        self._lock = threading.Lock()
        self._endpoints: dict[str, keys.EndpointEntity] = {}
        self._by_gid: dict[bytes, keys.EndpointEntity] = {}
        self._callbacks: list[Callable[[keys.EndpointEntity], None]] = []

    def start(self) -> None:
        """Follow the graph from now on.

        Zenoh then sends this process all tokens, which takes seconds if another process has
        declared thousands: after the start of a component they delay nothing.
        """
        if self._subscriber is not None:
            return
        self._subscriber = self._session.liveliness().declare_subscriber(
            keys.tokens_pattern(self._domain),
            zenoh.handlers.RingChannel(_MAX_PENDING),
            history=True,
        )
        self._thread = threading.Thread(
            target=self._follow, args=(self._subscriber.handler,), name="cairn graph", daemon=True
        )
        self._thread.start()

    def watch(self, on_endpoint: Callable[[keys.EndpointEntity], None]) -> Callable[[], None]:
        """Call `on_endpoint` for every endpoint, now and later; return a function that stops it."""
        with self._lock:
            self._callbacks.append(on_endpoint)
            present = list(self._endpoints.values())
        for endpoint in present:
            on_endpoint(endpoint)

        def stop() -> None:
            with self._lock:
                if on_endpoint in self._callbacks:
                    self._callbacks.remove(on_endpoint)

        return stop

    def endpoint(self, gid: bytes) -> keys.EndpointEntity | None:
        """Return the endpoint that has this identity; None if the graph does not contain it."""
        return self._by_gid.get(gid)

    def close(self) -> None:
        """Stop following the graph."""
        if self._subscriber is not None:
            self._subscriber.undeclare()
            self._thread.join(timeout=2.0)

    def _follow(self, channel: Any) -> None:
        while True:
            try:
                sample = channel.recv()
            except zenoh.ZError:  # the subscriber was undeclared
                return
            token = str(sample.key_expr)
            for entity in _parsed([token]):
                if not isinstance(entity, keys.EndpointEntity):
                    continue
                with self._lock:
                    if sample.kind == zenoh.SampleKind.DELETE:
                        self._endpoints.pop(token, None)
                        self._by_gid.pop(keys.gid(token), None)
                        continue
                    known = token in self._endpoints
                    self._endpoints[token] = entity
                    self._by_gid[keys.gid(token)] = entity
                    if len(self._endpoints) > _MAX_ENDPOINTS:
                        oldest = next(iter(self._endpoints))
                        del self._endpoints[oldest]
                        self._by_gid.pop(keys.gid(oldest), None)
                    callbacks = [] if known else list(self._callbacks)
                for on_endpoint in callbacks:
                    on_endpoint(entity)


def _parsed(tokens: Iterable[str]) -> Iterable[keys.NodeEntity | keys.EndpointEntity]:
    for token in tokens:
        try:
            yield keys.parse_token(token)
        except keys.WireFormatError:
            continue  # a token of another profile or version, which is not of our graph
