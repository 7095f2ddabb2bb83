"""A subscription of a script: the messages of one topic, for a callback or for a loop."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Generic, TypeVar

import zenoh

from cairn.bus import keys
from cairn.bus.codec import Codec
from cairn.bus.drop_oldest_queue import DropOldestQueue
from cairn.client.connection import KEPT_BYTES, Connection
from cairn.errors import CairnError
from cairn.system.closing import Closing

M = TypeVar("M")

_log = logging.getLogger("cairn.client")


class NoMessageError(CairnError):
    """No message arrived within the time limit."""


class Subscription(Closing, Generic[M]):
    """The messages of one topic; a context manager and an iterator."""

    def __init__(
        self,
        connection: Connection,
        opened: set[Subscription[Any]],
        topic: str,
        message: type[M],
        callback: Callable[[M], None] | None,
        depth: int,
        timeout_s: float,
        accept: Callable[[M], bool] | None = None,
    ) -> None:
        self.topic = topic
        self.timeout_s = timeout_s
        self.key = keys.message_key(connection.domain, topic, message)
        self._codec = Codec()
        self._message = message
        self._callback = callback
        self._accept = accept
        self._payloads: DropOldestQueue[bytes] = DropOldestQueue(depth, KEPT_BYTES)
        self._changed = threading.Condition()
        self._closed = False
        # A callback runs on a thread of its own, so that it may be slow; else nothing slow happens.
        handler = zenoh.handlers.Callback(self._receive, indirect=callback is not None)
        self._subscriber = connection.subscriber(self.key, handler, latched=True)
        self._opened = opened
        opened.add(self)

    @property
    def dropped(self) -> int:
        """Number of messages that were dropped because the reader was slow."""
        return self._payloads.dropped

    def __iter__(self) -> Iterator[M]:
        """Yield messages; `NoMessageError` if none arrives within `timeout_s`."""
        while True:
            yield self.next()

    def next(self, timeout_s: float | None = None) -> M:
        """Return the next message.

        Raises `NoMessageError` if none arrives within `timeout_s` [s] (by default, that of the
        subscription) or if the subscription is closed, `InvalidMessage` if one arrives that is not
        valid.
        """
        limit_s = self.timeout_s if timeout_s is None else timeout_s
        deadline = time.monotonic() + limit_s
        while True:
            with self._changed:
                while (payload := self._payloads.take()) is None:
                    if self._closed:
                        raise NoMessageError(
                            f"{self.topic}: the subscription is closed; call subscribe again"
                        )
                    left_s = deadline - time.monotonic()
                    if left_s <= 0:
                        raise NoMessageError(f"{self.topic}: no message within {limit_s:g} s")
                    self._changed.wait(min(left_s, threading.TIMEOUT_MAX))
            message = self._codec.decode(self._message, payload)
            if self._accept is None or self._accept(message):
                return message

    def close(self) -> None:
        """Stop receiving and drop what was not read; a reader gets `NoMessageError`."""
        with self._changed:
            if self._closed:
                return
            self._closed = True
            self._payloads.clear()
            self._changed.notify_all()
        self._opened.discard(self)
        self._subscriber.undeclare()

    def _receive(self, sample: Any) -> None:
        payload = sample.payload.to_bytes()
        if self._callback is not None:
            try:
                self._callback(self._codec.decode(self._message, payload))
            except Exception:  # the user's callback may fail in any way; the next message follows
                _log.exception("callback for %s failed", self.topic)
            return
        with self._changed:
            if self._closed:
                return
            self._payloads.put(payload, len(payload))
            self._changed.notify()
