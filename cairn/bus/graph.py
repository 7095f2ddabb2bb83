"""The graph: which nodes are on the bus and what they publish and subscribe, from their tokens."""

import itertools
import logging
import queue
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import zenoh

from cairn.bus import keys
from cairn.errors import CairnError

_MAX_TOKENS = 20_000
"""A graph that is larger is not read completely: a robot has some hundreds of tokens."""

_MAX_ENDPOINTS = 1000
"""A topic or a name with so many tokens is not followed any further: a topic has some ten."""

_FIRST_RING = 64
"""Changes of a topic or a name that wait until they are read, at first.

Zenoh's ring takes 250 bytes for each, and is used slot by slot: with room for 1,000, each process
grew by up to 0.25 MB per topic as others restarted.
"""

_CONFIRMED_S = 5.0
"""Time in which Zenoh sends the tokens that exist, after a subscription [s]."""

_POLL_S = 0.1
"""Interval for reading what has changed: one thread for all topics, at any rate of changes."""

_READ_S, _SHORTEST_READ_S, _READ_SHARE = 1.0, 0.1, 4.0
"""A client reads the graph so often [s], after an unknown endpoint so soon [s], and in all cases
pauses for so many times as long as it took."""

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

    See `read_tokens`.
    """
    return list(read_tokens(session, pattern, timeout_s, patience_s=patience_s).values())


def read_tokens(
    session: zenoh.Session,
    pattern: str,
    timeout_s: float = 10.0,
    *,
    patience_s: float | None = None,
) -> dict[str, keys.NodeEntity | keys.EndpointEntity]:
    """Return the nodes and endpoints alive whose tokens match a pattern, by their sorted tokens.

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
            _log.warning(
                "read only %d tokens of the graph in %s s: the computer is busy, or it is large",
                len(tokens),
                patience_s,
            )
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
    found = {token: _entity(token) for token in sorted(tokens)}
    return {token: one for token, one in found.items() if one is not None}


class GraphReader:
    """Reads the endpoints that match a pattern once a second, on a thread, in a client's session.

    A client does not subscribe to tokens: a zenoh router (1.10) keeps what it has sent of each one
    to such a client for as long as the client is connected. With a client that followed all
    publishers, the router's process grew by 130 KiB with each restart of a component.
    """

    def __init__(
        self,
        session: zenoh.Session,
        pattern: str,
        report: Callable[[Mapping[str, keys.EndpointEntity]], None],
    ) -> None:
        """Begin; `report` gets all endpoints by their tokens, at first and when they change.

        It is called on the reader's thread.
        """
        self._session = session
        self._pattern = pattern
        self._report = report
        self._bell = threading.Event()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="cairn graph", daemon=True)
        self._thread.start()

    def read_soon(self) -> None:
        """Read them as soon as that may be, as an endpoint is not known; from any thread."""
        self._bell.set()

    def close(self) -> None:
        """Report nothing any more, but what is being read just now."""
        self._closed.set()
        self._bell.set()

    def _run(self) -> None:
        known: dict[str, keys.EndpointEntity] | None = None
        while not self._closed.is_set():
            self._bell.clear()
            began = time.monotonic()
            try:
                graph = read_tokens(self._session, self._pattern)
            except zenoh.ZError:
                return  # the session is closed
            except CairnError as error:
                _log.warning("%s; trying again", error)
                continue
            found = {
                token: one for token, one in graph.items() if isinstance(one, keys.EndpointEntity)
            }
            if found != known and not self._closed.is_set():
                known = found
                self._report(found)
            # Thousands of tokens that another program has declared must not take all the time.
            shortest_s = max(_SHORTEST_READ_S, _READ_SHARE * (time.monotonic() - began))
            self._closed.wait(shortest_s)  # also if the bell rings
            self._bell.wait(max(0.0, _READ_S - shortest_s))


class GraphWatcher:
    """Reports the endpoints of topics and the nodes of names, that exist already or appear.

    It subscribes to the tokens of these alone, because each token that another program declares is
    sent to every process that subscribes to it.
    """

    def __init__(self, session: zenoh.Session, domain: int) -> None:
        """Follow nothing yet: `start` does."""
        self._session = session
        self._domain = domain
        self._lock = threading.Lock()
        self._reading = threading.Lock()  # the changes of a token are read in their order
        self._followed: dict[str, _Followed] = {}  # by key expression
        self._by_gid: dict[bytes, keys.EndpointEntity] = {}
        self._closed = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Follow what is watched from now on.

        Zenoh then sends this process the tokens of these topics, which takes seconds if another
        process has declared thousands: after the start of a component they delay nothing.
        """
        with self._lock:
            if self._thread is not None:
                return
            self._thread = threading.Thread(target=self._follow, name="cairn graph", daemon=True)
            for pattern, followed in self._followed.items():
                if followed.is_urgent:
                    self._subscribe(pattern, followed)
        self._thread.start()

    def watch(
        self,
        topic: str,
        on_endpoint: Callable[[keys.EndpointEntity], None],
        *,
        is_urgent: bool = True,
    ) -> Callable[[], None]:
        """Call `on_endpoint` for every endpoint of a topic or service (full name), now and later.

        If it is not urgent, this may begin some seconds after the start. Returns a function that
        stops it.
        """
        pattern = keys.endpoints_pattern(self._domain, topic)
        return self._watch(pattern, f"the endpoints of {topic}", on_endpoint, is_urgent=is_urgent)

    def watch_nodes(
        self, name: str, on_node: Callable[[keys.NodeEntity], None]
    ) -> Callable[[], None]:
        """Call `on_node` for every node of a full name; as `watch`, not urgently."""
        pattern = keys.nodes_pattern(self._domain, name)
        return self._watch(pattern, f"the nodes named {name}", on_node, is_urgent=False)

    def _watch(
        self, pattern: str, what: str, on_entity: Callable[[Any], None], *, is_urgent: bool
    ) -> Callable[[], None]:
        with self._lock:
            followed = self._followed.setdefault(pattern, _Followed(what))
            followed.is_urgent |= is_urgent
            if followed.is_urgent and not followed.is_followed and self._thread is not None:
                self._subscribe(pattern, followed)
            followed.callbacks.append(on_entity)
            present = list(followed.entities.values())
        for entity in present:
            on_entity(entity)

        def stop() -> None:
            with self._lock:
                if on_entity not in followed.callbacks:
                    return
                followed.callbacks.remove(on_entity)
                if followed.callbacks:
                    return
                del self._followed[pattern]
                for token in followed.entities:
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
            subscribers = [one.subscriber for one in self._followed.values() if one.subscriber]
            for one in self._followed.values():
                one.subscriber = None
        for subscriber in subscribers:
            subscriber.undeclare()

    def _subscribe(self, pattern: str, followed: "_Followed") -> None:
        """Have what exists sent, and what changes from now on."""
        followed.is_followed = True
        followed.unconfirmed = set(followed.entities)
        followed.deleted = set()
        followed.malformed = 0
        followed.overflowed = False
        followed.subscribed_s = time.monotonic()
        followed.subscriber = self._session.liveliness().declare_subscriber(
            pattern,
            zenoh.handlers.RingChannel(followed.ring),
            history=True,
        )

    def _follow(self) -> None:
        for number in itertools.count():
            if self._closed.wait(_POLL_S):
                return
            if number % _POLLS_PER_TOPIC == 0:
                self._follow_one_more()
            self._read_changes()
            self._make_up_for_losses()

    def _follow_one_more(self) -> None:
        with self._lock:
            for pattern, followed in self._followed.items():
                if not followed.is_followed:
                    self._subscribe(pattern, followed)
                    return

    def _read_changes(self) -> None:
        with self._lock:
            all_followed = list(self._followed.items())
        for pattern, followed in all_followed:
            calls: list[Callable[[], None]] = []
            with self._reading:
                for number in range(1, _MAX_ENDPOINTS + 1):
                    sample = followed.next_change()
                    if sample is None:
                        break
                    followed.overflowed |= number >= followed.ring
                    calls += self._changed(pattern, followed, sample)
            for call in calls:
                call()

    def _make_up_for_losses(self) -> None:
        """Subscribe again, with the longest ring, to that of which changes may have been lost."""
        replaced = []
        with self._reading, self._lock:
            for pattern, followed in self._followed.items():
                old, is_short = followed.subscriber, followed.ring < _MAX_ENDPOINTS
                if old is None:
                    continue
                has_all = time.monotonic() - followed.subscribed_s > _CONFIRMED_S
                if has_all:
                    for token in followed.unconfirmed:
                        followed.entities.pop(token, None)
                        self._by_gid.pop(keys.gid(token), None)
                    followed.unconfirmed.clear()
                    followed.deleted.clear()
                if followed.overflowed and (is_short or has_all):
                    followed.ring = _MAX_ENDPOINTS
                    self._subscribe(pattern, followed)
                    replaced.append(old)
        for subscriber in replaced:
            subscriber.undeclare()

    def _changed(
        self, pattern: str, followed: "_Followed", sample: zenoh.Sample
    ) -> list[Callable[[], None]]:
        """Remember a change; return the calls to make."""
        token = str(sample.key_expr)
        entity = _entity(token)
        calls: list[Callable[[], None]] = []
        crowded = None
        with self._lock:
            if self._followed.get(pattern) is not followed:  # no longer watched
                return []
            followed.unconfirmed.discard(token)
            if entity is None:
                followed.malformed += 1
            elif sample.kind == zenoh.SampleKind.DELETE:
                followed.note_deleted(token)
                followed.entities.pop(token, None)
                self._by_gid.pop(keys.gid(token), None)
            else:
                # Zenoh sends what existed at a subscription beside what changes since: a token that
                # comes after its end may be either. What exists is read again.
                followed.overflowed |= token in followed.deleted
                if token not in followed.entities:
                    calls = [partial(callback, entity) for callback in followed.callbacks]
                followed.entities[token] = entity
                if isinstance(entity, keys.EndpointEntity):
                    self._by_gid[keys.gid(token)] = entity
            if len(followed.entities) + followed.malformed >= _MAX_ENDPOINTS:
                crowded, followed.subscriber = followed.subscriber, None
        if crowded is not None:
            crowded.undeclare()
            _log.warning(
                "stopped following %s: there are %d or more, so conflicts with further ones are "
                "not reported; end the program that announces them, then restart this component",
                followed.what,
                _MAX_ENDPOINTS,
            )
        return calls


class _Followed:
    """What is known of the endpoints of a topic, or the nodes of a name."""

    def __init__(self, what: str) -> None:
        self.what = what
        self.entities: dict[str, keys.NodeEntity | keys.EndpointEntity] = {}
        self.callbacks: list[Callable[[Any], None]] = []
        self.is_urgent = False
        self.is_followed = False  # or it was, until it was crowded
        self.malformed = 0  # tokens that have appeared or disappeared
        self.ring = _FIRST_RING
        self.overflowed = False  # so changes may have been lost
        self.unconfirmed: set[str] = set()  # of the entities: not seen since the subscription
        self.deleted: set[str] = set()  # in the first seconds of the subscription
        self.subscribed_s = 0.0
        self.subscriber: zenoh.Subscriber[Any] | None = None

    def note_deleted(self, token: str) -> None:
        """Remember the end of a token, as long as what existed before may still arrive."""
        is_new = time.monotonic() - self.subscribed_s <= _CONFIRMED_S
        if is_new and len(self.deleted) < _MAX_ENDPOINTS:
            self.deleted.add(token)

    def next_change(self) -> zenoh.Sample | None:
        """Return the next change that has arrived, if any."""
        subscriber = self.subscriber
        try:
            return None if subscriber is None else subscriber.handler.try_recv()
        except zenoh.ZError:  # another thread has just undeclared it
            return None


def _entity(token: str) -> keys.NodeEntity | keys.EndpointEntity | None:
    """Return what a token announces; None if it is of another profile or version."""
    try:
        return keys.parse_token(token)
    except keys.WireFormatError:
        return None
