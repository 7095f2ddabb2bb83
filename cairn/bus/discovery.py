"""Discovery: wait until all processes on the bus know each other's declarations.

A message published before the link to a subscriber is established, or before the subscriber's
declaration has arrived, is lost without a trace. Therefore every process answers queries at a key
of its own. A query travels behind the declarations on the same link, so when the reply has
arrived, both sides know all declarations of each other.

Only a process of the same run is waited for: its session id proves that it is one
(`cairn.bus.session`), and so do its replies. All other sessions together, such as those of ROS 2
nodes, are waited for shortly, and those that do not answer not even shortly for a while: each
process hands on which these are.

On a robot of several machines, the processes of the other machines have no direct links to this
one. The routers of those machines list them; a query to them travels through the routers, again
behind the declarations.
"""

import json
import secrets
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from hashlib import blake2b
from pathlib import Path
from typing import Any, cast

import zenoh

from cairn.bus.channels import ChannelReader
from cairn.bus.keys import CAIRN_ID_PREFIX, process_id, router_key, session_key
from cairn.bus.message_limits import REPLY_BYTES
from cairn.bus.session import is_member, process_of
from cairn.limits.json import parse_json

_ANSWER_POLL_S = 0.1
"""Interval for checking whether a process that has not answered yet still exists."""

_ASK_AGAIN_S = 0.5
"""A process that has not answered by then is asked again, and then after twice the time."""

_LINK_POLL_S = 0.05
"""Interval for checking whether a process that is not linked yet still exists."""

_ROUTER_TIMEOUT_S = 1.0
"""A router that has not answered by then is treated as one without an admin space."""

_OTHERS_LIMIT_S = 0.3
"""Sessions that are not of this run, and stopped processes, are waited for at most so long."""

_SILENT_S = 60.0
"""A session that has not answered is not waited for again during this time."""

_MAX_SILENT = 256
"""So many sessions that have not answered are remembered."""

_MAX_OTHERS = 1000
"""So many sessions that are not of this run are waited for."""

_DESCRIPTION_BYTES = 4 << 20
"""Longest description of a router's links that is read."""

_UNREAD_BYTES = 16 << 20
"""So much of the replies to one query is kept until it is read; a false queryable may send more."""

_REPLY_OVERHEAD_BYTES = 1000

_MAX_THREADS = 32

_TAG_BYTES = 16
_NONCE_BYTES = 16


class DiscoveryBarrier:
    """Answers the discovery queries of other processes and queries them in turn."""

    def __init__(
        self, session: zenoh.Session, secret: str = "", *, several_machines: bool = False
    ) -> None:
        """`secret` is that of the run; without one, all processes of Cairn count as its own.

        With `several_machines`, the processes at the routers of other machines count, too.
        """
        self._session = session
        self._secret = secret
        self._zid = str(session.info.zid())
        self._silent = _SilentSessions()
        self._links = PeerLinks(session, secret, several_machines=several_machines)
        own_key = session_key(self._zid)
        queryable: Any = session.declare_queryable(own_key, zenoh.handlers.RingChannel(256))
        self._reader = ChannelReader(queryable, partial(self._answer, own_key), "cairn discovery")

    def wait_for_peers(self, timeout_s: float) -> list[str]:
        """Wait until every process of the run and this one know all declarations of each other.

        Returns the processes that were not reached within the timeout, such as "process 4711", and
        the other sessions that were not reached within 0.3 s.
        """
        deadline = time.monotonic() + timeout_s
        peers = self._links.peers(timeout_s)
        own = sorted(zid for zid in peers if is_member(zid, self._secret))
        remote = self._links.remote_peers(timeout_s)
        unreached = self._reach_own(
            [*own, *sorted(zid for zid in remote if is_member(zid, self._secret))], deadline
        )
        others = sorted(peers.difference(own, self._silent.left_s()))[:_MAX_OTHERS]
        silent = self._reach_others(others, min(deadline, time.monotonic() + _OTHERS_LIMIT_S))
        self._silent.add(dict.fromkeys(silent, _SILENT_S))
        elsewhere = " on another machine"
        return [process_of(zid) + (elsewhere if zid in remote else "") for zid in unreached] + [
            f"session {zid}, which is not of this run" for zid in silent
        ]

    def close(self) -> None:
        """Stop answering."""
        self._reader.close()
        self._links.close()

    def _reach_own(self, peers: Sequence[str], deadline: float) -> list[str]:
        """Wait for processes of this run; return those that were not reached."""
        if not peers:
            return []
        # In parallel, or one process that hangs would use up the time that the others need.
        with ThreadPoolExecutor(min(len(peers), _MAX_THREADS), "cairn wait for peers") as pool:
            reached = list(pool.map(lambda zid: self._reach(zid, deadline), peers))
        return [zid for zid, known in zip(peers, reached, strict=True) if not known]

    def _reach(self, zid: str, deadline: float) -> bool:
        is_remote = self._links.is_remote(zid)
        stopped_limit = time.monotonic() + _OTHERS_LIMIT_S

        def is_over() -> bool:
            now = time.monotonic()
            is_stopped = not is_remote and now >= stopped_limit and self._is_stopped(zid)
            return now >= deadline or is_stopped

        if not is_remote and not self._links.wait_for_link(zid, deadline, is_over):
            return self._has_left(zid, deadline)
        with QueryableWatcher(self._session, session_key(zid)) as watcher:
            while not watcher.wait(min(_ANSWER_POLL_S, _remaining(deadline))):
                if self._has_left(zid, deadline):
                    return True
                if is_over():
                    return False
        nonce = secrets.token_bytes(_NONCE_BYTES)
        changed = threading.Event()
        queries: list[_Query] = []
        due, wait_s = time.monotonic(), _ASK_AGAIN_S
        while True:
            # Again and again: a false queryable may have hidden that this one did not exist yet.
            if time.monotonic() >= due:
                key = session_key(zid)
                queries.append(_Query(self._session, key, _remaining(deadline), nonce, changed))
                due, wait_s = time.monotonic() + wait_s, 2.0 * wait_s
            ended = all(query.ended.is_set() for query in queries)
            if any(self._is_proved(zid, nonce, query.take()) for query in queries):
                return True
            if ended or self._has_left(zid, deadline):
                return self._has_left(zid, deadline)
            if is_over():
                return False
            changed.wait(_ANSWER_POLL_S)
            changed.clear()

    def _is_proved(self, zid: str, nonce: bytes, replies: Sequence[tuple[str, bytes]]) -> bool:
        """Return whether one of the replies comes from the process; others may reply, too."""
        for _, payload in replies:
            silent = payload[_TAG_BYTES:]
            if not self._secret:  # a program outside the run cannot check the reply
                return True
            if secrets.compare_digest(payload[:_TAG_BYTES], self._tag(zid, nonce, silent)):
                self._silent.add(_parsed_silent(silent))
                return True
        return False

    def _reach_others(self, peers: Sequence[str], deadline: float) -> list[str]:
        """Wait for sessions that are not of this run; return those that were not reached."""
        left = list(peers)
        while left:
            linked = self._links.linked()
            left = [zid for zid in left if zid not in linked or zid.startswith(CAIRN_ID_PREFIX)]
            if linked.intersection(left):  # processes of another run
                query = _Query(self._session, session_key("*"), _remaining(deadline), b"")
                query.ended.wait(_remaining(deadline))
                answered = {key for key, _ in query.take()}
                left = [zid for zid in left if session_key(zid) not in answered]
            remaining = deadline - time.monotonic()
            if left and remaining <= 0:
                present = self._links.present(_ROUTER_TIMEOUT_S).peers
                return [zid for zid in left if zid in present]
            self._links.wait_for_change(min(_LINK_POLL_S, max(0.0, remaining)))
        return []

    def _has_left(self, zid: str, deadline: float) -> bool:
        # A process that shuts down stops answering before its link is closed.
        return self._links.has_left(zid, _remaining(deadline))

    def _is_stopped(self, zid: str) -> bool:
        """Return whether a process of this run, which is on this machine, is stopped by a signal.

        It will not answer until it is continued.
        """
        if not self._secret:
            return False  # perhaps another machine's
        try:
            status = Path(f"/proc/{process_id(zid)}/stat").read_bytes()
        except OSError:
            return False
        return status.rpartition(b")")[2].split()[:1] in ([b"T"], [b"t"])

    def _answer(self, own_key: str, query: zenoh.Query) -> None:
        nonce = b"" if query.payload is None else query.payload.to_bytes()[:_NONCE_BYTES]
        silent = json.dumps(self._silent.left_s()).encode()
        with query, suppress(zenoh.ZError):  # the process that asked may have ended
            query.reply(own_key, self._tag(self._zid, nonce, silent) + silent)

    def _tag(self, zid: str, nonce: bytes, silent: bytes) -> bytes:
        """Return what proves that a reply comes from a process of this run."""
        key = self._secret.encode()[:64]
        text = b"discovery reply " + zid.encode() + b" " + nonce + silent
        return blake2b(text, key=key, digest_size=_TAG_BYTES).digest()


class _SilentSessions:
    """Sessions that did not answer lately, and are therefore not waited for; for any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._until: dict[str, float] = {}

    def add(self, left_s: Mapping[str, float]) -> None:
        """Remember these for their times [s]; those of sessions known already do not change."""
        now = time.monotonic()
        with self._lock:
            self._until = {zid: until for zid, until in self._until.items() if until > now}
            for zid, for_s in left_s.items():
                if len(self._until) < _MAX_SILENT:
                    self._until.setdefault(zid, now + for_s)

    def left_s(self) -> dict[str, float]:
        """Return those remembered, with the time [s] for which they still are."""
        now = time.monotonic()
        with self._lock:
            return {zid: until - now for zid, until in self._until.items() if until > now}


class _Query:
    """A query whose replies are collected, so that its caller can watch for other events."""

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        timeout_s: float,
        payload: bytes | None = None,
        changed: threading.Event | None = None,
    ) -> None:
        """`changed` is set with each reply, and at the end."""
        self.ended = threading.Event()
        self._changed = changed or threading.Event()
        self._lock = threading.Lock()
        self._replies: list[tuple[str, bytes]] = []
        self._size = 0
        handler = zenoh.handlers.Callback(self._on_reply, self._on_end, indirect=False)
        session.get(
            key,
            cast("Any", handler),
            payload=payload,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout_s,
        )

    def take(self) -> list[tuple[str, bytes]]:
        """Return key and payload of each reply since the last call."""
        with self._lock:
            replies, self._replies, self._size = self._replies, [], 0
        return replies

    def _on_reply(self, reply: zenoh.Reply) -> None:
        if reply.ok is None:
            return
        size = len(reply.ok.payload) + _REPLY_OVERHEAD_BYTES
        with self._lock:
            if self._size + size > _UNREAD_BYTES:
                return
            self._size += size
            self._replies.append((str(reply.ok.key_expr), reply.ok.payload.to_bytes()))
        self._changed.set()

    def _on_end(self) -> None:
        self.ended.set()
        self._changed.set()


class PeerLinks:
    """Knows the other processes from the router, and waits for the direct links to them.

    A process that has just opened its session learns of the others from the router and links to
    each directly. Until that link is established, neither side knows the other's declarations.
    """

    def __init__(
        self, session: zenoh.Session, secret: str = "", *, several_machines: bool = False
    ) -> None:
        self._session = session
        self._secret = secret
        self._several_machines = several_machines
        self._remote: set[str] = set()  # as last asked
        self._zid = str(session.info.zid())
        self._changed = threading.Condition()
        self._events = 0
        callback: Any = zenoh.handlers.Callback(self._on_link_event, indirect=False)
        self._listener = session.info.declare_transport_events_listener(callback, history=False)
        self._join()

    def peers(self, timeout_s: float) -> set[str]:
        """Return the ids of the processes to which a direct link exists or will exist soon.

        Those are the ones linked already and the peers in the description of a router.
        """
        return (self.linked() | self._ask_routers(timeout_s).peers) - {self._zid}

    def remote_peers(self, timeout_s: float) -> set[str]:
        """Return the ids of the processes on other machines, as the routers there list them."""
        if self._several_machines:
            local = self.peers(timeout_s) | {self._zid}
            self._remote = self._listed_by_all(timeout_s) - local
        return self._remote

    def is_remote(self, zid: str) -> bool:
        """Return whether a process was on another machine when `remote_peers` was called last."""
        return zid in self._remote

    def linked(self) -> set[str]:
        """Return the ids of the sessions to which a direct link exists."""
        info = self._session.info
        return {str(zid) for zid in (*info.peers_zid(), *info.routers_zid())}

    def present(self, timeout_s: float) -> "_RouterAnswers":
        """Return the processes that a router knows.

        If a router does not describe its links, or there is none, those linked are among them.
        Otherwise a link proves nothing: in zenoh 1.10 one that is established while the other side
        closes its session outlives that session.
        """
        answer = self._ask_routers(timeout_s)
        if not answer.described:
            answer.peers.update(self.linked())
        return answer

    def has_left(self, zid: str, timeout_s: float) -> bool:
        """Return whether a process is not `present` any more.

        False, as it is not certain, if a router does not answer within the timeout.
        """
        if self.is_remote(zid):  # or its machine cannot be reached any more
            return zid not in self._listed_by_all(timeout_s)
        answer = self.present(timeout_s)
        return answer.complete and zid not in answer.peers

    def wait_for_link(self, zid: str, deadline: float, is_over: Callable[[], bool]) -> bool:
        """Wait for the link to a process, until `deadline` (monotonic) [s] or until `is_over()`.

        Returns False at once if the router no longer knows the process.
        """
        while not self._is_linked_within(zid, min(deadline - time.monotonic(), _LINK_POLL_S)):
            remaining = deadline - time.monotonic()
            if remaining <= 0 or is_over() or self.has_left(zid, remaining):
                return False
        return True

    def _is_linked_within(self, zid: str, timeout_s: float) -> bool:
        limit = time.monotonic() + timeout_s
        while True:
            events = self._events
            # Without the lock: Zenoh may answer only after `_on_link_event`, which needs it.
            if zid in self.linked():
                return True
            left_s = limit - time.monotonic()
            if left_s <= 0:
                return False
            with self._changed:
                if self._events == events:
                    self._changed.wait(left_s)

    def wait_for_change(self, timeout_s: float) -> None:
        """Wait for a link that opens or closes, at most `timeout_s` [s]."""
        with self._changed:
            self._changed.wait(timeout_s)

    def close(self) -> None:
        """Stop following link events."""
        self._listener.undeclare()

    def _join(self) -> None:
        # At first this process does not know the router's admin space, nor the router this
        # process. Once the router has answered, both do, and so do all that ask the router.
        deadline = time.monotonic() + _ROUTER_TIMEOUT_S
        for router in self._routers():
            with QueryableWatcher(self._session, router_key(router)) as watcher:
                watcher.wait(_remaining(deadline))
        self.peers(_ROUTER_TIMEOUT_S)

    def _routers(self) -> list[str]:
        """Return the router of this run; if it is not linked to one, all routers."""
        routers = [str(zid) for zid in self._session.info.routers_zid()]
        return [zid for zid in routers if self._secret and is_member(zid, self._secret)] or routers

    def _ask_routers(self, timeout_s: float) -> "_RouterAnswers":
        routers = self._routers()
        peers, complete, described = set(routers), True, bool(routers)
        deadline = time.monotonic() + timeout_s
        # In parallel: several that do not answer must not use up several timeouts.
        queries = [_Query(self._session, router_key(router), timeout_s) for router in routers]
        for query in queries:
            query.ended.wait(_remaining(deadline))
            payloads = [payload for _, payload in query.take()]
            complete &= bool(payloads)
            lists = [_peers_of_router(payload) for payload in payloads]
            described &= any(known is not None for known in lists)
            peers.update(*(known for known in lists if known is not None))
        return _RouterAnswers(peers, complete, described)

    def _listed_by_all(self, timeout_s: float) -> set[str]:
        """Return the ids of the processes that any router lists, on whatever machine it is."""
        query = _Query(self._session, router_key("*"), min(timeout_s, _ROUTER_TIMEOUT_S))
        query.ended.wait(timeout_s)
        lists = [_peers_of_router(payload) for _, payload in query.take()]
        return set().union(*(known for known in lists if known is not None))

    def _on_link_event(self, _: Any) -> None:
        with self._changed:
            self._events += 1
            self._changed.notify_all()


class QueryableWatcher:
    """Waits until a queryable exists at a key; use it as a context manager."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._changed = threading.Event()
        self._querier = session.declare_querier(key)
        callback: Any = zenoh.handlers.Callback(lambda _: self._changed.set(), indirect=False)
        self._listener = self._querier.declare_matching_listener(callback)

    def __enter__(self) -> "QueryableWatcher":
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.undeclare()
        self._querier.undeclare()

    def wait(self, timeout_s: float) -> bool:
        """Wait until the queryable exists; return whether it does at the timeout."""
        deadline = time.monotonic() + timeout_s
        while not self._is_present():
            # An event may report an outdated change, so only the current state counts.
            if not self._changed.wait(max(0.0, deadline - time.monotonic())):
                break
            self._changed.clear()
        return self._is_present()

    def _is_present(self) -> bool:
        # zenoh's stub says bool, but it is an object, which is always true
        return bool(cast("Any", self._querier.matching_status).matching)


@dataclass(frozen=True)
class _RouterAnswers:
    """What the routers know."""

    peers: set[str]
    """The ids of the routers and of all processes that they list."""
    complete: bool
    """Whether no router failed to answer in time."""
    described: bool
    """Whether there is a router and each listed its links."""


def _peers_of_router(description: bytes) -> set[str] | None:
    """Return the ids of the peers linked to a router, from its description of itself."""
    try:
        sessions = parse_json(description, _DESCRIPTION_BYTES)["sessions"]
        return {str(one["peer"]) for one in sessions if one["whatami"] == "peer"}
    except (ValueError, KeyError, TypeError):
        return None  # a router of another version: only the direct links are known


def _parsed_silent(left_s: bytes) -> dict[str, float]:
    """Return the silent sessions, with their times [s], in a reply of a process of this run."""
    try:
        parsed = parse_json(left_s, REPLY_BYTES)
        return {str(zid): min(float(for_s), _SILENT_S) for zid, for_s in parsed.items()}
    except (ValueError, TypeError, AttributeError):  # of another version
        return {}


def _remaining(deadline: float) -> float:
    return max(0.01, deadline - time.monotonic())
