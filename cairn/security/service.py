"""The authority's service: enrollment with a token; roster and renewal for proven identities.

HTTPS with TLS 1.3 only. What it accepts, and from which sender:

| request | sender | answer |
|---|---|---|
| `GET /ca` | anyone | certificate of the authority, which is public |
| `POST /enroll` | has a token | certificate and roster |
| `GET /roster` | has a certificate in force | roster |
| `POST /renew` | has a certificate in force | certificate and roster |
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
import time
from collections.abc import Awaitable, Callable
from typing import Annotated, Any, Final, TypeVar

import uvicorn
from cryptography import x509
from pydantic import BaseModel, Field, ValidationError
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

from cairn.errors import CairnError
from cairn.security import certificates
from cairn.security.authority import (
    GRACE_S,
    VALID_DAYS,
    Authority,
    RenewalRefused,
    check_addresses,
)
from cairn.security.enrollment import write_url
from cairn.security.folder import Name, write_secret
from cairn.security.identity import entry_of
from cairn.security.roster import Entry, StrictModel
from cairn.security.tokens import Digest, TokenRefused
from cairn.system.http_server import Http, HttpServer

DEFAULT_PORT: Final = 7449

_REQUEST_BYTES: Final = 16 << 10
_REQUEST_LIMIT_S: Final = 10.0
_LONGEST_HEADERS: Final = 16 << 10
_CLOSE_LIMIT_S: Final = 2
_OWN_DAYS: Final = 7
"""The service's own certificate is valid for so long, and made again every day."""
_DAY_S: Final = 86_400.0
_CHECK_S: Final = 60.0
"""How often it looks whether a day has passed: a timer stops while a laptop is suspended."""
_WRONG_ATTEMPTS: Final = 5
"""So many tokens of an address may be wrong, and so many of its refusals are reported, in
`_WINDOW_S`. Only enrollment is limited: otherwise one program could keep others of its address from
the roster."""
_WINDOW_S: Final = 60.0
_MOST_ADDRESSES: Final = 1_000

Text = Annotated[str, Field(max_length=8_192)]
Report = Callable[[str], None]
_ModelT = TypeVar("_ModelT", bound=BaseModel)


class EnrollRequest(StrictModel):
    """What a computer sends that has a token."""

    name: Name
    secret: Digest
    request: Text


class RenewRequest(StrictModel):
    """What a computer sends that has a certificate in force."""

    request: Text


class _Refused(Exception):
    """A request is refused, with the status of HTTP and the reason."""

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status = status


class WrongAttempts:
    """Counts wrong attempts of each address within a minute, in bounded memory."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._begin = clock()
        self._counts: dict[str, int] = {}

    def is_blocked(self, address: str) -> bool:
        """Return whether an address has to wait."""
        if self._clock() - self._begin >= _WINDOW_S:
            self._begin = self._clock()
            self._counts.clear()
        if address not in self._counts:
            return len(self._counts) >= _MOST_ADDRESSES
        return self._counts[address] >= _WRONG_ATTEMPTS

    def add(self, address: str) -> None:
        """Count a wrong attempt."""
        self._counts[address] = self._counts.get(address, 0) + 1


class AuthorityService:
    """The service of an authority at one address."""

    def __init__(
        self,
        authority: Authority,
        host: str,
        port: int,
        names: tuple[str, ...] = (),
        days: int = VALID_DAYS,
        grace_s: float = GRACE_S,
        report: Report = lambda _: None,
    ) -> None:
        """Open the socket and write the address beside the authority, for tokens.

        Args:
            authority: whose certificates it issues.
            host: the IP address or name to listen on; port: 0 for any that is free.
            names: addresses at which machines reach it, by default `host`.
            days: validity of the certificates it issues.
            grace_s: for which a renewed certificate remains in force [s].
            report: receives a line for each enrollment, renewal and refusal.

        Raises:
            CairnError: it cannot listen, or no name is given for an address that stands for all.
        """
        if not names and host in ("0.0.0.0", "::"):
            raise CairnError(
                f"--listen {host}: it stands for all addresses of this computer; give the one that "
                "the machines use by --name ADDRESS"
            )
        self._names = check_addresses("authority", names or (host,))
        self._authority, self._days, self._grace_s = authority, days, grace_s
        self._report = report
        self._wrong = WrongAttempts()
        self._reported = WrongAttempts()
        self._context = _server_context(authority.ca_pem)
        self._renew_certificate()
        self._socket = _listening(host, port)
        name, opened = self._names[0], self._socket.getsockname()[1]
        self.url = f"https://[{name}]:{opened}" if ":" in name else f"https://{name}:{opened}"
        """The address for machines."""
        with authority.folder.locked():
            write_url(authority.folder, self.url)
        self._server = HttpServer(self._config())

    @property
    def is_serving(self) -> bool:
        """Whether it accepts connections."""
        return self._server.started

    async def run(self) -> None:
        """Serve until `stop` is called."""
        renewing = asyncio.create_task(self._keep_renewed())
        try:
            await self._server.serve(sockets=[self._socket])
        finally:
            renewing.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await renewing
            self._socket.close()

    def stop(self) -> None:
        """End `run`."""
        self._server.should_exit = True

    async def _keep_renewed(self) -> None:
        while True:
            await asyncio.sleep(_CHECK_S)
            self.renew_if_due(time.time())

    def renew_if_due(self, now: float) -> None:
        """Renew the service's own certificate if it was made a day ago; `now` [s since 1970]."""
        if abs(now - self._renewed_at) < _DAY_S:  # the clock may have been set back
            return
        try:
            self._renew_certificate()
        except CairnError as error:
            self._report(f"the service's certificate cannot be renewed: {error}")

    def _renew_certificate(self) -> None:
        """Present a new certificate on the connections that follow."""
        certificate, key = self._authority.service_certificate(self._names, _OWN_DAYS)
        path = self._authority.folder.path / "service.pem"  # `ssl` takes files only
        write_secret(path, certificate + key)
        self._context.load_cert_chain(path)
        self._renewed_at = time.time()

    def _config(self) -> uvicorn.Config:
        app = Starlette(
            routes=[
                Route("/ca", self._guarded(self._ca)),
                Route("/roster", self._guarded(self._roster)),
                Route("/enroll", self._guarded(self._enroll), methods=["POST"]),
                Route("/renew", self._guarded(self._renew), methods=["POST"]),
            ]
        )
        return uvicorn.Config(
            app,
            http=_TlsHttp,
            ws="none",
            ssl_context_factory=lambda *_: self._context,
            h11_max_incomplete_event_size=_LONGEST_HEADERS,
            proxy_headers=False,
            log_config=None,
            access_log=False,
            log_level=logging.ERROR,
            server_header=False,
            lifespan="off",
            timeout_graceful_shutdown=_CLOSE_LIMIT_S,
        )

    def _guarded(
        self, handler: Callable[[Request], Awaitable[Response]]
    ) -> Callable[[Request], Awaitable[Response]]:
        """Answer refusals with their reason, and report some of each address."""

        async def handle(request: Request) -> Response:
            address = request.client.host if request.client else ""
            try:
                return await handler(request)
            except _Refused as refused:
                if not self._reported.is_blocked(address):
                    self._reported.add(address)
                    self._report(f"refused {request.url.path} of {address}: {refused}")
                return PlainTextResponse(str(refused), refused.status)
            except CairnError as error:  # of the authority's files: the operator has to act
                self._report(f"failed {request.url.path} of {address}: {error}")
                return PlainTextResponse("the authority cannot answer; see its output", 500)

        return handle

    async def _ca(self, _request: Request) -> Response:
        return PlainTextResponse(self._authority.ca_pem)

    async def _roster(self, request: Request) -> Response:
        await self._holder(request)
        return PlainTextResponse(await asyncio.to_thread(self._authority.roster_file))

    async def _enroll(self, request: Request) -> Response:
        address = request.client.host if request.client else ""
        if self._wrong.is_blocked(address):
            raise _Refused(429, "too many wrong tokens came from this address; wait a minute")
        sent = await _body(request, EnrollRequest)
        key = _public_key(sent.request)
        try:
            made = await asyncio.to_thread(
                self._authority.enroll, sent.name, sent.secret, key, self._days
            )
        except TokenRefused as error:
            self._wrong.add(address)
            raise _Refused(403, str(error)) from error
        self._report(f"enrolled {sent.name}")
        return await self._issued(sent.name, *made)

    async def _renew(self, request: Request) -> Response:
        holder = await self._holder(request)
        key = _public_key((await _body(request, RenewRequest)).request)
        try:
            made = await asyncio.to_thread(
                self._authority.renew_for, holder, key, self._days, self._grace_s
            )
        except RenewalRefused as error:
            raise _Refused(409, str(error)) from error
        self._report(f"renewed {holder.name}")
        return await self._issued(holder.name, *made)

    async def _issued(self, name: str, certificate: bytes, roster: bytes) -> Response:
        answer = {"certificate": certificate.decode(), "roster": roster.decode()}
        key = await asyncio.to_thread(self._authority.machines_key, name)
        return JSONResponse(answer if key is None else {**answer, "machines_key": key})

    async def _holder(self, request: Request) -> Entry:
        """Return the identity that the sender has proven; refuse one that is not in force."""
        data: bytes | None = request.scope["state"]["certificate"]
        if data is None:
            raise _Refused(401, "this request needs the certificate of an identity")
        certificate = x509.load_der_x509_certificate(data)  # TLS has verified it
        roster = await asyncio.to_thread(self._authority.roster)
        entry = entry_of(roster.in_force(), certificate)
        if entry is None:
            name = certificates.common_name(certificate)
            raise _Refused(403, f"the certificate {name} is not in force: revoked or replaced")
        return entry


class _TlsHttp(Http):
    """HTTP whose requests have the certificate (DER) that their sender has proven, or None."""

    def connection_made(self, transport: Any) -> None:
        connection = transport.get_extra_info("ssl_object")
        self.app_state = {**self.app_state, "certificate": connection.getpeercert(True)}
        super().connection_made(transport)


async def _body(request: Request, model: type[_ModelT]) -> _ModelT:
    """Return the body of a request; refuse one that is too large or not valid."""
    if request.headers.get("content-type") != "application/json":  # a page of a browser may not
        raise _Refused(415, "the request is not application/json")
    data = b""
    try:
        async with asyncio.timeout(_REQUEST_LIMIT_S):
            async for part in request.stream():
                data += part
                if len(data) > _REQUEST_BYTES:
                    raise _Refused(413, f"the request has more than {_REQUEST_BYTES} bytes")
    except TimeoutError:
        raise _Refused(408, "the request did not arrive in time") from None
    try:
        return model.model_validate_json(data)
    except ValidationError as error:
        fields = ", ".join(".".join(map(str, one["loc"])) or "text" for one in error.errors()[:5])
        raise _Refused(400, f"the request is not valid: {fields}") from None


def _public_key(request: str) -> Any:
    try:
        return certificates.requested_key(request.encode())
    except ValueError as error:
        raise _Refused(400, f"request for a certificate: {error}") from None


def _server_context(ca: bytes) -> ssl.SSLContext:
    """Return the settings of TLS: a client needs no certificate, but a wrong one is refused."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    context.verify_mode = ssl.CERT_OPTIONAL
    context.load_verify_locations(cadata=ca.decode("ascii"))
    return context


def _listening(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise CairnError(
            f"authority: cannot listen on {host}, port {port}: {error.strerror}; give another "
            "address by --listen HOST:PORT"
        ) from error
