"""Discovery: wait until all processes on the bus know each other's declarations.

A message published before the link to a subscriber is established, or before the subscriber's
declaration has arrived, is lost without a trace. Therefore every process answers queries at a key
of its own. A query travels behind the declarations on the same link, so when the reply has
arrived, both sides know all declarations of each other.
"""

import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, cast

import zenoh

from cairn.bus.keys import router_key, session_key
from cairn.bus.session import CAIRN_ID_PREFIX, process_of

_ANSWER_POLL_S = 0.1
"""Interval for checking whether a process that has not answered yet still exists."""

_LINK_POLL_S = 0.05
"""Interval for checking whether a process that is not linked yet still exists."""

_ROUTER_TIMEOUT_S = 1.0
"""A router that has not answered by then is treated as one without an admin space."""


class DiscoveryBarrier:
    """Answers the discovery queries of other processes and queries them in turn."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._links = PeerLinks(session)
        own_key = session_key(str(session.info.zid()))
        self._queryable: zenoh.Queryable[Any] = session.declare_queryable(
            own_key, zenoh.handlers.RingChannel(256)
        )
        self._thread = threading.Thread(
            target=self._answer, args=(own_key,), name="cairn discovery", daemon=True
        )
        self._thread.start()

    def wait_for_peers(self, timeout_s: float) -> list[str]:
        """Wait until every process on the bus and this one know all declarations of each other.

        Returns the processes that were not reached within the timeout, such as "process 4711".
        """
        deadline = time.monotonic() + timeout_s
        peers = sorted(self._links.peers(timeout_s))
        if not peers:
            return []
        # In parallel, or one process that hangs would use up the time that the others need.
        with ThreadPoolExecutor(len(peers), "cairn wait for peers") as pool:
            reached = list(pool.map(lambda zid: self._reach(zid, deadline), peers))
        return [process_of(zid) for zid, known in zip(peers, reached, strict=True) if not known]

    def close(self) -> None:
        """Stop answering."""
        self._queryable.undeclare()
        self._thread.join(timeout=2.0)
        self._links.close()

    def _reach(self, zid: str, deadline: float) -> bool:
        if not self._links.wait_for_link(zid, deadline):
            return self._has_left(zid, deadline)
        if not zid.startswith(CAIRN_ID_PREFIX):
            return True  # not a process of Cairn, so it does not answer
        with QueryableWatcher(self._session, session_key(zid)) as watcher:
            while not watcher.wait(min(_ANSWER_POLL_S, _remaining(deadline))):
                if self._has_left(zid, deadline):
                    return True
                if time.monotonic() >= deadline:
                    return False
            replies = self._session.get(session_key(zid), timeout=_remaining(deadline))
            answered = any(reply.ok is not None for reply in replies)
            return answered or self._has_left(zid, deadline)

    def _has_left(self, zid: str, deadline: float) -> bool:
        # A process that shuts down stops answering before its link is closed.
        return self._links.has_left(zid, _remaining(deadline))

    def _answer(self, own_key: str) -> None:
        channel = self._queryable.handler
        while True:
            try:
                query = channel.recv()
            except zenoh.ZError:  # the queryable was undeclared
                return
            with query, suppress(zenoh.ZError):  # the process that asked may have ended
                query.reply(own_key, b"")


class PeerLinks:
    """Knows the other processes from the router, and waits for the direct links to them.

    A process that has just opened its session learns of the others from the router and links to
    each directly. Until that link is established, neither side knows the other's declarations.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._zid = str(session.info.zid())
        self._changed = threading.Condition()
        callback: Any = zenoh.handlers.Callback(self._on_link_event, indirect=False)
        self._listener = session.info.declare_transport_events_listener(callback, history=False)
        self._join()

    def peers(self, timeout_s: float) -> set[str]:
        """Return the ids of the processes to which a direct link exists or will exist soon.

        Those are the ones linked already and the peers in the description of a router.
        """
        return (self._linked() | self._ask_routers(timeout_s).peers) - {self._zid}

    def has_left(self, zid: str, timeout_s: float) -> bool:
        """Return whether no router knows a process any more.

        If a router does not describe its links, or there is none, the process must not be linked
        either. Otherwise a link proves nothing: in zenoh 1.10 one that is established while the
        other side closes its session outlives that session. False, as it is not certain, if a
        router does not answer within the timeout.
        """
        answer = self._ask_routers(timeout_s)
        known = answer.peers if answer.described else answer.peers | self._linked()
        return answer.complete and zid not in known

    def wait_for_link(self, zid: str, deadline: float) -> bool:
        """Wait for the link to a process, until `deadline` (monotonic) [s].

        Returns False at once if the router no longer knows the process.
        """
        while zid not in self._linked():
            remaining = deadline - time.monotonic()
            if remaining <= 0 or self.has_left(zid, remaining):
                return False
            with self._changed:
                self._changed.wait_for(lambda: zid in self._linked(), min(remaining, _LINK_POLL_S))
        return True

    def close(self) -> None:
        """Stop following link events."""
        self._listener.undeclare()

    def _join(self) -> None:
        # At first this process does not know the router's admin space, nor the router this
        # process. Once the router has answered, both do, and so do all that ask the router.
        for router in self._session.info.routers_zid():
            with QueryableWatcher(self._session, router_key(str(router))) as watcher:
                watcher.wait(_ROUTER_TIMEOUT_S)
        self.peers(_ROUTER_TIMEOUT_S)

    def _ask_routers(self, timeout_s: float) -> "_RouterAnswers":
        routers = [str(zid) for zid in self._session.info.routers_zid()]
        peers, complete, described = set(routers), True, bool(routers)
        for router in routers:
            replies = list(self._session.get(router_key(router), timeout=timeout_s))
            complete &= all(reply.ok is not None for reply in replies)
            lists = [_peers_of_router(one.ok.payload.to_bytes()) for one in replies if one.ok]
            described &= any(known is not None for known in lists)
            peers.update(*(known for known in lists if known is not None))
        return _RouterAnswers(peers, complete, described)

    def _linked(self) -> set[str]:
        info = self._session.info
        return {str(zid) for zid in (*info.peers_zid(), *info.routers_zid())}

    def _on_link_event(self, _: Any) -> None:
        with self._changed:
            self._changed.notify_all()


class QueryableWatcher:
    """Waits until a queryable exists at a key, or no longer exists; use it as a context manager."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._given_up = False
        self._changed = threading.Event()
        self._querier = session.declare_querier(key)
        callback = zenoh.handlers.Callback(self._on_matching_event, indirect=False)
        self._listener = self._querier.declare_matching_listener(cast("Any", callback))

    def __enter__(self) -> "QueryableWatcher":
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.undeclare()
        self._querier.undeclare()

    def wait(self, timeout_s: float) -> bool:
        """Wait until the queryable exists; return whether it does at the timeout or `give_up`."""
        return self._wait_until(True, timeout_s)

    def wait_gone(self, timeout_s: float) -> bool:
        """Wait until the queryable is gone; return whether it is at the timeout or `give_up`.

        The queryable of a process that has ended remains visible for a moment.
        """
        return self._wait_until(False, timeout_s)

    def give_up(self) -> None:
        """End the wait, because nothing more will change; from any thread."""
        self._given_up = True
        self._changed.set()

    def _wait_until(self, present: bool, timeout_s: float) -> bool:
        deadline = time.monotonic() + timeout_s
        while self._is_present() is not present and not self._given_up:
            # An event may report an outdated change, so only the current state counts.
            if not self._changed.wait(max(0.0, deadline - time.monotonic())):
                break
            self._changed.clear()
        return self._is_present() is present

    def _is_present(self) -> bool:
        # zenoh's stub says bool, but it is an object, which is always true
        return bool(cast("Any", self._querier.matching_status).matching)

    def _on_matching_event(self, _: Any) -> None:
        self._changed.set()


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
        sessions = json.loads(description)["sessions"]
        return {str(one["peer"]) for one in sessions if one["whatami"] == "peer"}
    except (ValueError, KeyError, TypeError):
        return None  # a router of another version: only the direct links are known


def _remaining(deadline: float) -> float:
    return max(0.01, deadline - time.monotonic())
