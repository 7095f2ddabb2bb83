"""Replies that are sent apart from the thread that has made them."""

import threading
from collections import deque
from collections.abc import Callable

from cairn.bus.message_limits import PENDING_BYTES
from cairn.system.bell import Bell

_LONGEST_SLEEP_S = 3600.0
_CLOSE_LIMIT_S = 1.0


class ReplyThread:
    """Sends replies on a thread of its own, which is started with the first one.

    Zenoh sends replies reliably: the sender waits for a requester that does not read,
    until Zenoh closes the connection to it. That must not be the thread of a component.
    """

    def __init__(self, name: str) -> None:
        """`name` is that of the thread."""
        self._name = name
        self._lock = threading.Lock()
        self._replies: deque[tuple[Callable[[], None], int]] = deque()
        self._bytes = 0
        self.unsent = 0
        """Replies that are not sent yet; read by other threads."""
        self._bell = Bell()
        self._thread: threading.Thread | None = None
        self._closed = False

    def send(self, reply: Callable[[], None], size: int) -> bool:
        """Have `reply` called, which sends so many bytes; return False if too many wait already.

        One of 0 bytes is always sent. After `close` it is called at once.
        """
        with self._lock:
            if size and self._bytes + size > PENDING_BYTES:
                return False
            closed = self._closed
            if not closed:
                self._bytes += size
                self.unsent += 1
                self._replies.append((reply, size))
                if self._thread is None:
                    self._thread = threading.Thread(target=self._run, name=self._name, daemon=True)
                    self._thread.start()
        if closed:
            reply()
        else:
            self._bell.ring()
        return True

    def close(self) -> None:
        """Send what waits, and end the thread; wait a second at most."""
        with self._lock:
            self._closed = True
            thread = self._thread
        if thread is not None:
            self._bell.ring()
            thread.join(_CLOSE_LIMIT_S)

    def _run(self) -> None:
        while True:
            with self._lock:
                waiting = self._replies.popleft() if self._replies else None
                closed = self._closed
            if waiting is not None:
                reply, size = waiting
                reply()
                with self._lock:
                    self._bytes -= size
                    self.unsent -= 1
                del waiting, reply  # a requester learns of this process's end then
            elif closed:
                return
            else:
                self._bell.wait(_LONGEST_SLEEP_S)
