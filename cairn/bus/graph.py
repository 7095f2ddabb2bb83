"""Who is on the bus and who reads and writes what, from the liveliness tokens alone."""

import threading
from collections.abc import Callable, Iterable
from typing import Any

import zenoh

from cairn.bus import keys

_WAITING = 10_000


def read_graph(
    session: zenoh.Session, domain: int, timeout_s: float = 2.0
) -> list[keys.NodeEntity | keys.EndpointEntity]:
    """All nodes and endpoints alive in a domain, sorted by their tokens.

    For the session of a client (`open_client`): to a peer, zenoh 1.10 may declare the answer
    complete before all of it has come; peers follow with `GraphWatcher`.
    """
    replies = session.liveliness().get(keys.tokens_pattern(domain), timeout=timeout_s)
    tokens = sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)
    return list(_parsed(tokens))


class GraphWatcher:
    """Tells those who ask about each endpoint that appears in the domain or is there already."""

    def __init__(self, session: zenoh.Session, domain: int) -> None:
        self._lock = threading.Lock()
        self._endpoints: dict[str, keys.EndpointEntity] = {}
        self._watchers: list[Callable[[keys.EndpointEntity], None]] = []
        self._subscriber: zenoh.Subscriber[Any] = session.liveliness().declare_subscriber(
            keys.tokens_pattern(domain), zenoh.handlers.RingChannel(_WAITING), history=True
        )
        self._thread = threading.Thread(target=self._follow, name="cairn graph", daemon=True)
        self._thread.start()

    def watch(self, appeared: Callable[[keys.EndpointEntity], None]) -> Callable[[], None]:
        """Have `appeared` called for every endpoint, now and later; returns how to end that."""
        with self._lock:
            self._watchers.append(appeared)
            present = list(self._endpoints.values())
        for endpoint in present:
            appeared(endpoint)

        def end() -> None:
            with self._lock:
                if appeared in self._watchers:
                    self._watchers.remove(appeared)

        return end

    def close(self) -> None:
        """Stop following."""
        self._subscriber.undeclare()
        self._thread.join(timeout=2.0)

    def _follow(self) -> None:
        channel = self._subscriber.handler
        while True:
            try:
                sample = channel.recv()
            except zenoh.ZError:  # the subscriber was undeclared
                return
            key = str(sample.key_expr)
            for entity in _parsed([key]):
                if not isinstance(entity, keys.EndpointEntity):
                    continue
                with self._lock:
                    if sample.kind == zenoh.SampleKind.DELETE:
                        self._endpoints.pop(key, None)
                        continue
                    known = key in self._endpoints
                    self._endpoints[key] = entity
                    watchers = [] if known else list(self._watchers)
                for appeared in watchers:
                    appeared(entity)


def _parsed(tokens: Iterable[str]) -> Iterable[keys.NodeEntity | keys.EndpointEntity]:
    for token in tokens:
        try:
            yield keys.parse_token(token)
        except keys.WireFormatError:
            continue  # a token of another profile or version: not of our graph
