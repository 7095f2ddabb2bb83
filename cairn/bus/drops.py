"""Messages of a topic that wait for their reader."""

import threading
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class DropOldestQueue(Generic[T]):
    """The newest `depth` messages, with as many wake-ups of the reader on their way, or more.

    Putting and taking are whole steps, for two threads: a message put in the place of one that
    was taken meanwhile would wait without a wake-up, and its topic would stand still for ever.
    """

    def __init__(self, depth: int) -> None:
        self.dropped = 0
        """How many gave way to newer ones."""
        self._depth = depth
        self._messages: deque[T] = deque()
        self._step = threading.Lock()

    def put(self, message: T) -> bool:
        """Let a message wait; whether the reader has to be woken for it.

        It has not if the message took the place of the oldest, whose wake-up is left for it.
        """
        with self._step:
            full = len(self._messages) >= self._depth
            if full:
                self._messages.popleft()
                self.dropped += 1
            self._messages.append(message)
            return not full

    def take(self) -> T | None:
        """The oldest message, None if none waits."""
        with self._step:
            return self._messages.popleft() if self._messages else None

    def clear(self) -> None:
        """Discard what waits."""
        with self._step:
            self._messages.clear()
