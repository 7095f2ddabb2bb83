"""Dropped messages: the queue that drops its oldest entry, and the count of lost messages."""

import threading
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")

_MAX_PUBLISHERS = 1000
"""Publishers of one topic whose sequence numbers are followed at the same time."""

_MAX_GAP = 2**32
"""A greater jump of a publisher's sequence numbers is its defect, not a loss."""


class DropOldestQueue(Generic[T]):
    """Hold the newest `depth` messages; each of them has a wake-up of the subscriber pending.

    `put` and `take` are atomic, for two threads: if a take came between the removal of the oldest
    message and the arrival of the newest, it would use up the last wake-up, and the topic would
    stall for good.
    """

    def __init__(self, depth: int) -> None:
        self.dropped = 0
        """Number of messages dropped in favor of newer ones."""
        self._depth = depth
        self._messages: deque[T] = deque()
        self._lock = threading.Lock()

    def put(self, message: T) -> bool:
        """Add a message and return whether the subscriber has to be woken for it.

        A message that replaces the oldest one inherits its wake-up.
        """
        with self._lock:
            full = len(self._messages) >= self._depth
            if full:
                self._messages.popleft()
                self.dropped += 1
            self._messages.append(message)
            return not full

    def take(self) -> T | None:
        """Remove and return the oldest message; None if there is none."""
        with self._lock:
            return self._messages.popleft() if self._messages else None

    def clear(self) -> None:
        """Discard all messages; they are not counted as dropped."""
        with self._lock:
            self._messages.clear()


class LossCounter:
    """Count the messages lost in transit, from gaps in their publishers' sequence numbers."""

    def __init__(self) -> None:
        self.lost = 0
        """Number of messages sent after the first one received, and never received."""
        self._last: dict[bytes, int] = {}

    def received(self, publisher: bytes, sequence: int) -> None:
        """Note a received message: its publisher's GID and its number, which counts from 1."""
        if len(self._last) >= _MAX_PUBLISHERS:  # a peer that invents GIDs must not fill the memory
            self._last.clear()
        last = self._last.get(publisher)
        if last is not None and 1 < sequence - last < _MAX_GAP:
            self.lost += sequence - last - 1
        self._last[publisher] = sequence
