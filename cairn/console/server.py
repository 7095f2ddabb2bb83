"""The web server of the console: static page and WebSocket, and who may connect to them.

Whoever has the token may do what the console may. The checks of `Host` and `Origin` keep the pages
of other sites, which run in the same browser, from using it.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import os
import secrets
import socket
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.routing import Mount, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame

from cairn.bus.credentials import check_pair, check_secret, read_password
from cairn.console.hub import Hub, TooManyBrowsers
from cairn.console.protocol import LONGEST_FRAME, SUBPROTOCOLS
from cairn.errors import CairnError
from cairn.system.files import explain_os_error
from cairn.system.http_server import Http, HttpServer

TOKEN_REFUSED: Final = 4401
"""Close code: the token is missing or wrong."""
TRY_LATER: Final = 1013
"""Close code: too many browsers, or one that does not read its answers."""
USUAL_PORT: Final = 8765

_SHORTEST_TOKEN: Final = 16  # characters
_STATIC: Final = Path(__file__).with_name("static")
_CLOSE_LIMIT_S: Final = 2
_LONGEST_HEADERS: Final = 32 << 10
_UNSENT_BYTES: Final = 128 << 10
"""The kernel takes so much [bytes] in advance: what it has is not replaced by newer messages."""
_SEND_BUFFER: Final = 512 << 10
_FRAME_FACTOR: Final = 4
"""Up to so many times the longest message, a client receives the reason; beyond, TCP's reset."""
_RECEIVE_BUFFER: Final = 32 << 10  # what a connection sends at once delays the others
_READ_BYTES: Final = 4 << 10  # after which frames are counted: an empty one has 6 bytes
_MOST_FRAMES: Final = 100
"""Pings, pongs, and messages after the end, of a client between two pings of the server."""
_MOST_FRAGMENTS: Final = 1_000  # of one message
_DEAD_AFTER_MS: Final = 60_000
_LOOPBACK_NAMES: Final = frozenset({"localhost", "127.0.0.1", "::1"})
_HEADERS: Final = (
    (
        b"content-security-policy",
        b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
        b"connect-src 'self'; font-src 'self'; manifest-src 'self'; base-uri 'none'; "
        b"form-action 'none'; frame-ancestors 'none'",
    ),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"permissions-policy", b"camera=(), microphone=(), geolocation=()"),
    (b"cache-control", b"no-cache"),
)

_log = logging.getLogger("cairn.console")


@dataclass(frozen=True)
class Address:
    """Where the console listens.

    Attributes:
        host: an IP address, or a name such as localhost.
        port: 0 for any that is free; None for `USUAL_PORT` or, on loopback if that is taken, any.
        certificate, key: files (PEM) of TLS.
        origins: of pages on other sites that may connect, `https://app.foxglove.dev`.
    """

    host: str = "127.0.0.1"
    port: int | None = 0
    certificate: Path | None = None
    key: Path | None = None
    origins: tuple[str, ...] = ()

    def check(self) -> None:
        """Raise `CairnError` if others could listen to it, or could connect without TLS."""
        if (self.certificate is None) != (self.key is None):
            raise CairnError("console: --certificate and --key belong together; give both or none")
        if self.certificate is not None and self.key is not None:
            check_pair(self.certificate, self.key)
        elif not _is_loopback(self.host):
            raise CairnError(
                f"console: {self.host} is reached from other computers, which needs TLS; give "
                "--certificate and --key, or listen on 127.0.0.1 and use `ssh -L`"
            )

    @property
    def scheme(self) -> str:
        """`http`, or `https` with a certificate."""
        return "http" if self.certificate is None else "https"


def new_token() -> str:
    """Return a random token."""
    return secrets.token_urlsafe(24)


def token_in(path: Path) -> str:
    """Return the token in a file, which is created with a new one, for its owner, if it is missing.

    Raises `CairnError` if it cannot be read or created, or if others may read it.
    """
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
    try:
        with os.fdopen(os.open(path, flags, 0o600), "w", encoding="ascii") as file:
            file.write(new_token() + "\n")
    except FileExistsError:
        check_secret(path)
    except OSError as error:
        raise CairnError(
            f"{path}: no token can be kept there: {explain_os_error(error)}"
        ) from error
    token = read_password(path)
    if len(token) < _SHORTEST_TOKEN or not token.isascii():
        raise CairnError(
            f"{path}: a token has at least {_SHORTEST_TOKEN} ASCII characters, this one has "
            f"{len(token)}; remove the file, and the console writes a new one"
        )
    return token


class Console:
    """A hub behind a web server."""

    def __init__(self, hub: Hub, address: Address, token: str) -> None:
        """Raise `CairnError` if the address is not allowed or cannot be opened."""
        address.check()
        self._hub = hub
        self._address = address
        self._token = token
        self._socket = _listening(address)
        self._server = HttpServer(self._config())

    @property
    def is_serving(self) -> bool:
        """Whether it accepts connections."""
        return self._server.started

    @property
    def port(self) -> int:
        """The port on which it listens."""
        return int(self._socket.getsockname()[1])

    @property
    def origin(self) -> str:
        """The address without the token."""
        host = self._address.host
        if host in ("0.0.0.0", "::"):
            host = socket.gethostname()
        name = f"[{host}]" if ":" in host else host
        return f"{self._address.scheme}://{name}:{self.port}"

    @property
    def url(self) -> str:
        """The address for a browser, with the token in its fragment, which is not sent."""
        return f"{self.origin}/#token={self._token}"

    @property
    def websocket_url(self) -> str:
        """The address for clients of Foxglove."""
        return f"{self.origin.replace('http', 'ws', 1)}/?token={self._token}"

    async def run(self) -> None:
        """Serve until `stop` is called or a signal ends the process."""
        serving = asyncio.create_task(self._server.serve(sockets=[self._socket]))
        running = asyncio.create_task(self._hub.run())
        try:
            await asyncio.wait((serving, running), return_when=asyncio.FIRST_COMPLETED)
        finally:
            self.stop()
            running.cancel()
            results = await asyncio.gather(serving, running, return_exceptions=True)
        for result in results:
            if isinstance(result, Exception):
                raise result

    def stop(self) -> None:
        """End `run`."""
        self._server.should_exit = True

    def _config(self) -> uvicorn.Config:
        app = Starlette(
            routes=[
                WebSocketRoute("/ws", self._serve),
                WebSocketRoute("/", self._serve),
                Mount("/", StaticFiles(directory=_STATIC, html=True)),
            ]
        )
        names = None  # with TLS, the browser checks the name
        if self._address.certificate is None:
            names = _LOOPBACK_NAMES | {self._address.host}
        return uvicorn.Config(
            _Guard(app, self._address.scheme, names, self._address.origins),
            http=Http,
            ws=_WebSocket,
            ws_max_size=_FRAME_FACTOR * LONGEST_FRAME,
            ws_ping_interval=10.0,
            ws_ping_timeout=60.0,  # a map may take that long over a slow link
            ws_per_message_deflate=False,  # it would take more time than all else
            h11_max_incomplete_event_size=_LONGEST_HEADERS,
            ssl_certfile=self._address.certificate,
            ssl_keyfile=self._address.key,
            log_config=None,
            access_log=False,
            log_level=logging.ERROR,  # of garbage, without end, there is no record
            server_header=False,
            lifespan="off",
            timeout_graceful_shutdown=_CLOSE_LIMIT_S,
        )

    async def _serve(self, websocket: WebSocket) -> None:
        offered = websocket.scope["subprotocols"]
        chosen = next((one for one in offered if one in SUBPROTOCOLS), None)
        if chosen is None:
            known = ", ".join(SUBPROTOCOLS)
            text = f"the console needs one of these WebSocket subprotocols: {known}"
            await websocket.send_denial_response(PlainTextResponse(text, 400))
            return
        await websocket.accept(chosen)
        token = parse_qs(websocket.scope["query_string"].decode("latin-1")).get("token", [""])[0]
        if not secrets.compare_digest(token.encode(), self._token.encode()):
            reason = "the token is missing or wrong; open the address that `cairn console` prints"
            await websocket.close(TOKEN_REFUSED, reason)
            return

        async def receive() -> str | bytes | None:
            message = await websocket.receive()
            if message["type"] == "websocket.disconnect":
                return None
            text: str | None = message.get("text")
            return message["bytes"] if text is None else text

        async def send(frame: str | bytes) -> None:
            key = "text" if isinstance(frame, str) else "bytes"
            await websocket.send({"type": "websocket.send", key: frame})

        with contextlib.suppress(WebSocketDisconnect):
            try:
                code, reason = await self._hub.serve(chosen, receive, send)
            except TooManyBrowsers as error:
                code, reason = TRY_LATER, str(error)
            if reason:
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(_CLOSE_LIMIT_S):
                        await websocket.close(code, _short(reason))


class _WebSocket(WebSocketsSansIOProtocol):
    """A WebSocket that limits the number of frames: each takes time, and a pong takes memory."""

    _frames = 0  # of those that the console does not need

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self.close_timeout = _CLOSE_LIMIT_S

    def shutdown(self) -> None:
        if self.transport.is_closing():  # its browser has just closed it: uvicorn raises an error
            self.stop_keepalive()
        else:
            super().shutdown()

    def data_received(self, data: bytes) -> None:
        for begin in range(0, len(data), _READ_BYTES):
            if not self.transport.is_closing():
                super().data_received(data[begin : begin + _READ_BYTES])

    def handle_cont(self, event: Frame) -> None:
        super().handle_cont(event)
        if len(self.frames) > _MOST_FRAGMENTS:
            self.transport.abort()

    def handle_ping(self) -> None:
        super().handle_ping()
        self._count()

    def handle_pong(self, event: Frame) -> None:
        super().handle_pong(event)
        self._count()

    def send_receive_event_to_app(self) -> None:
        super().send_receive_event_to_app()
        if self.close_sent:
            self._count()

    async def send(self, message: Any) -> None:
        await super().send(message)
        # A refusal ends the handshake, too: uvicorn (0.54) logs each one as an error otherwise.
        self.handshake_complete = self.handshake_complete or self.close_sent

    def send_keepalive_ping(self) -> None:
        super().send_keepalive_ping()
        self._frames = 0

    def _count(self) -> None:
        self._frames += 1
        if self._frames > _MOST_FRAMES:
            self.transport.abort()


class _Guard:
    """Refuses requests of other sites, and adds the security headers to all answers.

    A site could have its own name resolved to this address (DNS rebinding): so without TLS the
    `Host` must be a name of this computer. `Origin`, which a browser sends and a page cannot
    change, must be the console itself or one of `origins`; native clients send none.
    """

    def __init__(
        self, app: ASGIApp, scheme: str, hosts: Collection[str] | None, origins: Sequence[str]
    ) -> None:
        self._app, self._scheme, self._hosts, self._origins = app, scheme, hosts, origins

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        reason = self._refusal(Headers(scope=scope))
        if not reason:
            await self._app(scope, receive, _with_headers(send))
            return
        response = PlainTextResponse(reason, 403)
        if scope["type"] == "websocket":
            await WebSocket(scope, receive, send).send_denial_response(response)
        else:
            await response(scope, receive, _with_headers(send))

    def _refusal(self, headers: Headers) -> str:
        host = headers.get("host", "")
        if self._hosts is not None and _host_name(f"//{host}") not in self._hosts:
            return (
                f"Host {host[:100]!r} is not a name of this console; use {', '.join(self._hosts)}, "
                "or start it with --certificate and --key"
            )
        origin = headers.get("origin")
        if origin is None or origin in (f"{self._scheme}://{host}", *self._origins):
            return ""
        return (
            f"pages of {origin[:100]!r} may not use this console; if you trust that site, start "
            f"the console with --allow-origin {origin[:100]}"
        )


def _with_headers(send: Send) -> Send:
    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message["headers"], *_HEADERS]
        await send(message)

    return send_with_headers


def _host_name(url: str) -> str:
    try:
        return urlsplit(url).hostname or ""
    except ValueError:
        return ""


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _listening(address: Address) -> socket.socket:
    """Return the listening socket, whose connections have little room for what is unsent."""
    if address.port is not None:
        return _listening_on(address.host, address.port)
    try:
        return _listening_on(address.host, USUAL_PORT)
    except CairnError as error:
        cause = error.__cause__
        is_taken = isinstance(cause, OSError) and cause.errno == errno.EADDRINUSE
        if not is_taken or not _is_loopback(address.host):
            raise  # from other computers, it is looked for on the usual port
        return _listening_on(address.host, 0)


def _listening_on(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, _UNSENT_BYTES)
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _DEAD_AFTER_MS)
        listening.bind((host, port))
        listening.listen()  # who connects at once waits until it is served
    except (OSError, UnicodeError) as error:
        listening.close()
        reason = error.strerror if isinstance(error, OSError) else error
        raise CairnError(
            f"console: cannot listen on {host}, port {port}: {reason}; give "
            "another one by --port, or another address by --host"
        ) from error
    return listening


def _short(reason: str) -> str:
    """Return a reason that fits into a close frame: 123 bytes."""
    return reason.encode()[:120].decode(errors="ignore")
