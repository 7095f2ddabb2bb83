"""Waits for somebody to be there who answers at a key, or to be gone."""

import threading
import time
from typing import Any, cast

import zenoh


class Arrival:
    """Follows whether a queryable exists; use it as a context manager."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._given_up = False
        self._changed = threading.Event()
        self._querier = session.declare_querier(key)
        callback = zenoh.handlers.Callback(self._note, indirect=False)
        self._listener = self._querier.declare_matching_listener(cast("Any", callback))

    def __enter__(self) -> "Arrival":
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
