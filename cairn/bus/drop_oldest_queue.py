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
    """Hold the newest messages; each of them has a wake-up of the subscriber pending.

    At most `depth` of them, and at most `max_bytes` together; the newest one is held in any case.

    `put` and `take` are atomic, for two threads: if a take came between the removal of the oldest
    message and the arrival of the newest, it would use up the last wake-up, and the topic would
    stall forever.
    """

    def __init__(self, depth: int, max_bytes: int) -> None:
        self.dropped = 0
        """Number of messages dropped in favor of newer ones."""
        self._depth = depth
        self._max_bytes = max_bytes
        self._messages: deque[tuple[T, int]] = deque()
        self._bytes = 0
        self._lock = threading.Lock()

    def put(self, message: T, size: int) -> bool:
        """Add a message of that size [bytes]; return whether the subscriber must be woken for it.

        A message that replaces older ones inherits their wake-ups.
        """
        with self._lock:
            replaces = False
            while self._messages and (
                len(self._messages) >= self._depth or self._bytes + size > self._max_bytes
            ):
                self._bytes -= self._messages.popleft()[1]
                self.dropped += 1
                replaces = True
            self._messages.append((message, size))
            self._bytes += size
            return not replaces

    def take(self) -> T | None:
        """Remove and return the oldest message; None if there is none."""
        with self._lock:
            if not self._messages:
                return None
            message, size = self._messages.popleft()
            self._bytes -= size
            return message

    def clear(self) -> None:
        """Discard all messages; they are not counted as dropped."""
        with self._lock:
            self._messages.clear()
            self._bytes = 0


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
