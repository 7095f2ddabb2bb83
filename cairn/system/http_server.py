"""What the web servers of Cairn have in common: uvicorn with limits on its connections."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator
from typing import Any, Final

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

_MAX_CONNECTIONS: Final = 128  # of TCP
_REQUEST_LIMIT_S: Final = 10.0  # for the headers of a request to arrive


class HttpServer(uvicorn.Server):
    """Leaves the handling of signals to its caller."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Change no handler."""
        yield


class Http(H11Protocol):
    """HTTP that closes connections on which no request arrives, and refuses too many."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        """Close a connection beyond the limit; wait for a request on others."""
        super().connection_made(transport)
        if len(self.connections) > _MAX_CONNECTIONS:
            transport.abort()
        self._await_request()

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        super().on_response_complete()
        self._await_request()

    def connection_lost(self, exc: Exception | None) -> None:
        """Wait no longer."""
        if self._deadline is not None:
            self._deadline.cancel()
        super().connection_lost(exc)

    def _await_request(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
        self._deadline = self.loop.call_later(_REQUEST_LIMIT_S, self._end_idle)

    def _end_idle(self) -> None:
        is_mine = self.transport.get_protocol() is self  # not a WebSocket meanwhile
        if is_mine and (self.cycle is None or self.cycle.response_complete):
            self.transport.close()
