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
from cairn.bus.session import MARK

KEYS = "@cairn/session/"
"""The key of a process is this and the id of its session."""

_LOOK_AGAIN_S = 0.1
"""Between two looks at whether a process that does not answer yet is still there."""


class Meeting:
    """This process's answer to the others, and its way to meet them."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._links = Links(session)
        own = f"{KEYS}{session.info.zid()}"
        self._queryable: zenoh.Queryable[Any] = session.declare_queryable(
            own, zenoh.handlers.RingChannel(256)
        )
        self._thread = threading.Thread(
            target=self._answer, args=(own,), name="cairn meeting", daemon=True
        )
        self._thread.start()

    def settle(self, timeout_s: float) -> list[str]:
        """Meet every process on the bus; returns the keys of those not met within the limit."""
        deadline = time.monotonic() + timeout_s
        others = sorted(self._links.others(timeout_s))
        if not others:
            return []
        # At the same time, or one that hangs would take the time that the others need.
        with ThreadPoolExecutor(len(others), "cairn settle") as pool:
            met = list(pool.map(lambda zid: self._meet(zid, deadline), others))
        return [KEYS + zid for zid, known in zip(others, met, strict=True) if not known]

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
        with Arrival(self._session, KEYS + zid) as arrival:
            while not arrival.wait(min(_LOOK_AGAIN_S, _left(deadline))):
                if self._has_left(zid, deadline):
                    return True
                if time.monotonic() >= deadline:
                    return False
            replies = self._session.get(KEYS + zid, timeout=_left(deadline))
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
