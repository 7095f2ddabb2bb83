"""Waits for somebody to be there who answers at a key."""

import threading
from typing import Any, cast

import zenoh


class Arrival:
    """Follows whether a queryable exists; use it as a context manager."""

    def __init__(self, session: zenoh.Session, key: str) -> None:
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
        if not self._there():
            self._changed.wait(timeout_s)
        return self._there()

    def give_up(self) -> None:
        """End the wait: it will not come. From any thread."""
        self._changed.set()

    def _there(self) -> bool:
        # zenoh's stub says bool; it is an object, and always true itself
        return bool(cast("Any", self._querier.matching_status).matching)

    def _note(self, status: Any) -> None:
        if status.matching:
            self._changed.set()
