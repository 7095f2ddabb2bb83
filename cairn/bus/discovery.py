"""Discovery: wait until all processes on the bus know each other."""

import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any, cast

import zenoh

from cairn.bus.keys import router_key, session_key
from cairn.bus.session import MARK

_ANSWER_POLL_S = 0.1
"""Between two looks at whether a process that does not answer yet is still there."""


class DiscoveryBarrier:
    """This process's answer to the others, and its way to meet them."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._links = PeerLinks(session)
        own = session_key(str(session.info.zid()))
        self._queryable: zenoh.Queryable[Any] = session.declare_queryable(
            own, zenoh.handlers.RingChannel(256)
        )
        self._thread = threading.Thread(
            target=self._answer, args=(own,), name="cairn meeting", daemon=True
        )
        self._thread.start()

    def wait_for_peers(self, timeout_s: float) -> list[str]:
        """Meet every process on the bus; returns the keys of those not met within the limit."""
        deadline = time.monotonic() + timeout_s
        others = sorted(self._links.others(timeout_s))
        if not others:
            return []
        # At the same time, or one that hangs would take the time that the others need.
        with ThreadPoolExecutor(len(others), "cairn settle") as pool:
            met = list(pool.map(lambda zid: self._meet(zid, deadline), others))
        return [session_key(zid) for zid, known in zip(others, met, strict=True) if not known]

    def close(self) -> None:
        """Answer no more."""
        self._queryable.undeclare()
        self._thread.join(timeout=2.0)
        self._links.close()

    def _meet(self, zid: str, deadline: float) -> bool:
        if not self._links.wait(zid, deadline):
            return self._has_left(zid, deadline)
        if not zid.startswith(MARK):
            return True  # not one of ours: it does not answer
        with QueryableWatcher(self._session, session_key(zid)) as arrival:
            while not arrival.wait(min(_ANSWER_POLL_S, _left(deadline))):
                if self._has_left(zid, deadline):
                    return True
                if time.monotonic() >= deadline:
                    return False
            replies = self._session.get(session_key(zid), timeout=_left(deadline))
            answered = any(reply.ok is not None for reply in replies)
            return answered or self._has_left(zid, deadline)

    def _has_left(self, zid: str, deadline: float) -> bool:
        # On its way out a process ceases to answer before its link is closed.
        return zid not in self._links.others(_left(deadline))

    def _answer(self, own: str) -> None:
        channel = self._queryable.handler
        while True:
            try:
                query = channel.recv()
            except zenoh.ZError:  # the queryable was undeclared
                return
            with query, suppress(zenoh.ZError):  # who asked may be gone
                query.reply(own, b"")


def _left(deadline: float) -> float:
    return max(0.01, deadline - time.monotonic())


_JOIN_LIMIT_S = 1.0
"""After so long a router is taken for one without an admin space."""

_LOOK_AGAIN_S = 0.05
"""Between two looks at whether a process that is waited for is still there."""


class PeerLinks:
    """The links of one peer's or router's session; `close` ends the following."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._zid = str(session.info.zid())
        self._changed = threading.Condition()
        callback: Any = zenoh.handlers.Callback(self._note, indirect=False)
        self._listener = session.info.declare_transport_events_listener(callback, history=False)
        self._join()

    def others(self, timeout_s: float) -> set[str]:
        """The ids of those to which there is, or soon will be, a direct link.

        They are those linked already, and the peers of which a router's admin space tells.
        """
        found = self._standing()
        for router in self._session.info.routers_zid():
            for reply in self._session.get(router_key(str(router)), timeout=timeout_s):
                if reply.ok is not None:
                    found |= _peers(reply.ok.payload.to_bytes())
        return found - {self._zid}

    def wait(self, zid: str, deadline: float) -> bool:
        """Whether a link to that one stands, at the latest at `deadline` (monotonic) [s].

        False at once if the router has lost it meanwhile.
        """
        while zid not in self._standing():
            left = deadline - time.monotonic()
            if left <= 0 or zid not in self.others(left):
                return False
            with self._changed:
                self._changed.wait_for(lambda: zid in self._standing(), min(left, _LOOK_AGAIN_S))
        return True

    def close(self) -> None:
        """Follow the links no more."""
        self._listener.undeclare()

    def _join(self) -> None:
        # At first a router's admin space is not known here, nor this process to the router; once
        # it has answered, both are, and all who ask it are told of this process.
        for router in self._session.info.routers_zid():
            with QueryableWatcher(self._session, router_key(str(router))) as arrival:
                arrival.wait(_JOIN_LIMIT_S)
        self.others(_JOIN_LIMIT_S)

    def _standing(self) -> set[str]:
        info = self._session.info
        return {str(zid) for zid in (*info.peers_zid(), *info.routers_zid())}

    def _note(self, _: Any) -> None:
        with self._changed:
            self._changed.notify_all()


def _peers(answer: bytes) -> set[str]:
    """From a router's own description: the peers linked to it."""
    try:
        sessions = json.loads(answer)["sessions"]
        return {str(one["peer"]) for one in sessions if one["whatami"] == "peer"}
    except (ValueError, KeyError, TypeError):
        return set()  # another version's; what is linked here has to do


class QueryableWatcher:
    """Follows whether a queryable exists; use it as a context manager."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._given_up = False
        self._changed = threading.Event()
        self._querier = session.declare_querier(key)
        callback = zenoh.handlers.Callback(self._note, indirect=False)
        self._listener = self._querier.declare_matching_listener(cast("Any", callback))

    def __enter__(self) -> "QueryableWatcher":
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.undeclare()
        self._querier.undeclare()

    def wait(self, timeout_s: float) -> bool:
        """Whether it is there, at the latest after the limit [s] or `give_up`."""
        return self._wait_until(True, timeout_s)

    def wait_gone(self, timeout_s: float) -> bool:
        """Whether it is gone, at the latest after the limit [s] or `give_up`.

        For a moment, a process that has ended still seems to be there.
        """
        return self._wait_until(False, timeout_s)

    def give_up(self) -> None:
        """End the wait: nothing more will change. From any thread."""
        self._given_up = True
        self._changed.set()

    def _wait_until(self, there: bool, timeout_s: float) -> bool:
        deadline = time.monotonic() + timeout_s
        while self._there() is not there and not self._given_up:
            # An event may tell of a change that is long over: only what is there now counts.
            if not self._changed.wait(max(0.0, deadline - time.monotonic())):
                break
            self._changed.clear()
        return self._there() is there

    def _there(self) -> bool:
        # zenoh's stub says bool; it is an object, and always true itself
        return bool(cast("Any", self._querier.matching_status).matching)

    def _note(self, _: Any) -> None:
        self._changed.set()
