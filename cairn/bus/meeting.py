"""Makes sure that processes know each other before one says that it is ready.

A message put before the link to a reader stands, or before its declaration has arrived, is lost
without a trace. Every process therefore answers at a key of its own; a query travels behind the
declarations on the same link, so that whoever got the answer knows, and is known, completely.
"""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any

import zenoh

from cairn.bus.arrival import Arrival
from cairn.bus.links import Links
from cairn.bus.liveliness import alive
from cairn.bus.session import PEER_MARK

KEYS = "@cairn/session/"
"""The key of a process is this and the id of its session."""


class Meeting:
    """This process's answer to the others, and its way to meet them."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._links = Links(session)
        self._zid = str(session.info.zid())
        own = KEYS + self._zid
        self._queryable: zenoh.Queryable[Any] = session.declare_queryable(
            own, zenoh.handlers.RingChannel(256)
        )
        self._thread = threading.Thread(
            target=self._answer, args=(own,), name="cairn meeting", daemon=True
        )
        self._thread.start()
        self._token = session.liveliness().declare_token(own)

    def settle(self, timeout_s: float) -> list[str]:
        """Meet every process on the bus; returns the keys of those not met within the limit."""
        deadline = time.monotonic() + timeout_s
        others = self._links.others(timeout_s)
        # At the same time, or one that hangs would take the time that the others need.
        with ThreadPoolExecutor(len(others) + 1, "cairn settle") as pool:
            far = pool.submit(self._meet_far, set(others), deadline)
            met = pool.map(lambda zid: self._meet(zid, others[zid], deadline), others)
            unmet = [zid for zid, known in zip(others, met, strict=True) if not known]
            return sorted(KEYS + zid for zid in unmet + far.result())

    def close(self) -> None:
        """Answer no more."""
        self._token.undeclare()
        self._queryable.undeclare()
        self._thread.join(timeout=2.0)
        self._links.close()

    def _meet_far(self, near: set[str], deadline: float) -> list[str]:
        """Meet those that neither this process nor its router is linked to; whom it could not."""
        keys = alive(self._session, KEYS + "*", _left(deadline))
        zids = {key.removeprefix(KEYS) for key in keys} - near - {self._zid}
        return [zid for zid in zids if not self._meet(zid, False, deadline)]

    def _meet(self, zid: str, direct: bool, deadline: float) -> bool:
        if direct and not self._links.wait(zid, deadline):
            return zid not in self._links.others(_left(deadline))
        key = KEYS + zid
        ours = zid.startswith(PEER_MARK) or alive(self._session, key, _left(deadline))
        if not ours:
            return time.monotonic() < deadline  # not one of ours, or it has gone
        with Arrival(self._session, key) as arrival:
            if not arrival.wait(_left(deadline)):
                return False
            replies = self._session.get(key, timeout=_left(deadline))
            return any(reply.ok is not None for reply in replies)

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
