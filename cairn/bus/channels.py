"""What Zenoh's channels receive, read on threads."""

import threading
from collections.abc import Callable
from typing import Any

import zenoh

_JOIN_LIMIT_S = 2.0


class ChannelReader:
    """Hands what arrives in a channel to a function, on a thread of its own."""

    def __init__(self, source: Any, receive: Callable[[Any], None], name: str) -> None:
        """Read the channel of `source`, a subscriber or queryable; `name` is the thread's."""
        self._source = source
        self.thread = threading.Thread(
            target=_read, args=(source.handler, receive), name=name, daemon=True
        )
        self.thread.start()

    def close(self) -> None:
        """Undeclare the source; wait for the thread, unless it is the one that closes."""
        self._source.undeclare()
        if threading.current_thread() is not self.thread:
            self.thread.join(_JOIN_LIMIT_S)


def _read(channel: Any, receive: Callable[[Any], None]) -> None:
    while True:
        try:
            received = channel.recv()
        except zenoh.ZError:  # the source is undeclared
            return
        receive(received)
        del received  # who has sent a query learns of this process's end when nothing holds it
