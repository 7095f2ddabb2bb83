"""One connection to the zygote: it owns the processes spawned over it."""

import selectors
import socket
from collections.abc import Callable
from typing import Any

from cairn.supervision.zygote_protocol import Answer, Lines, answer_line


class Owner:
    """A client's connection, never waited for: what it does not take at once is sent later."""

    def __init__(
        self, connection: socket.socket, pid: int, selector: selectors.BaseSelector
    ) -> None:
        self.connection = connection
        self.pid = pid
        self.processes: set[int] = set()
        self.gone = False  # sends no more requests; its processes are being killed
        self._selector = selector
        self._lines = Lines()
        self._unsent = bytearray()
        self._readable: Callable[[], Any] = lambda: None
        self._watched = 0
        connection.setblocking(False)

    def watch(self, readable: Callable[[], Any]) -> None:
        """Register what calls `receive` as the selector's data for this connection."""
        self._readable = readable
        self._update()

    def receive(self) -> list[bytes]:
        """The lines that have come; sets `gone` at the end. Raises `ProtocolError`."""
        if self._unsent:
            self._flush()
        if self.gone:
            return []
        try:
            data = self.connection.recv(1 << 16)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self.gone = True
        return self._lines.feed(data)

    def send(self, answer: Answer) -> None:
        """Send an answer, as soon as the client takes it; a client that has ended gets nothing."""
        if self.connection.fileno() >= 0:
            self._unsent += answer_line(answer)
            self._flush()

    def settle(self) -> bool:
        """Close the connection if nothing is left to be told, and say whether it is closed."""
        if self.connection.fileno() >= 0:
            self._update()
            if not self.processes and not self._unsent:
                self._close()
        return self.connection.fileno() < 0

    def _flush(self) -> None:
        try:
            sent = self.connection.send(self._unsent)
        except BlockingIOError:
            sent = 0
        except OSError:  # the client is gone; reading tells, unless it has told already
            sent = len(self._unsent)
        del self._unsent[:sent]
        self._update()

    def _update(self) -> None:
        wanted = 0 if self.gone else selectors.EVENT_READ
        wanted |= selectors.EVENT_WRITE if self._unsent else 0
        if wanted == self._watched:
            return
        if not self._watched:
            self._selector.register(self.connection, wanted, self._readable)
        elif not wanted:
            self._selector.unregister(self.connection)
        else:
            self._selector.modify(self.connection, wanted, self._readable)
        self._watched = wanted

    def _close(self) -> None:
        if self._watched:
            self._selector.unregister(self.connection)
            self._watched = 0
        self.connection.close()
