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


class Meeting:
    """This process's answer to the others, and its way to meet them."""

    def __init__(self, session: zenoh.Session, domain: int) -> None:
        self._session = session
        self._zid = str(session.info.zid())
        self._all = f"@cairn/{domain}/session/*"
        own = f"@cairn/{domain}/session/{self._zid}"
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
        replies = self._session.liveliness().get(self._all, timeout=timeout_s)
        keys = {str(reply.ok.key_expr) for reply in replies if reply.ok is not None}
        others = sorted(key for key in keys if not key.endswith(self._zid))
        if not others:
            return []
        # At the same time, or one that hangs would take the time that the others need.
        with ThreadPoolExecutor(len(others), "cairn settle") as pool:
            met = list(pool.map(lambda key: self._meet(key, deadline), others))
        return [key for key, known in zip(others, met, strict=True) if not known]

    def close(self) -> None:
        """Answer no more."""
        self._token.undeclare()
        self._queryable.undeclare()
        self._thread.join(timeout=2.0)

    def _meet(self, key: str, deadline: float) -> bool:
        with Arrival(self._session, key) as arrival:
            if not arrival.wait(max(0.0, deadline - time.monotonic())):
                return False
            left = deadline - time.monotonic()
            replies = self._session.get(key, timeout=max(0.01, left))
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
