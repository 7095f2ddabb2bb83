"""Computers with security folders of their own, and handshakes of TLS without a network."""

from __future__ import annotations

import asyncio
import os
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime, timedelta, tzinfo
from pathlib import Path
from unittest.mock import patch

from cairn.security import certificates
from cairn.security.authority import Authority, AuthorityMember, members_of
from cairn.security.folder import VARIABLE, RobotFolder
from cairn.security.identity import Identity
from cairn.security.service import AuthorityService
from cairn.security.tokens import Token
from tests.patience import LIMIT_S

ROBOT = "rover"
MACHINES = {"base": ("127.0.0.1",), "brain": ("127.0.0.1", "brain.local")}


@contextmanager
def computer(home: Path) -> Iterator[RobotFolder]:
    """Use the security folder below `home`; yield the robot's folder there."""
    with patch.dict(os.environ, {VARIABLE: str(home / "security")}):
        yield RobotFolder.of(ROBOT)


def new_authority(home: Path, *members: AuthorityMember, days: int = 90) -> Authority:
    """Make the robot's authority on a computer, by default with two machines and two operators."""
    known = members_of(MACHINES, {"alice": "operate", "wall": "view"})
    with computer(home) as folder:
        return Authority.create(folder, members or known, days)


@contextmanager
def days_ago(days: float) -> Iterator[None]:
    """Make certificates as if it were so many days ago."""

    class Earlier(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Earlier:
            return cls.fromtimestamp(datetime.now(tz).timestamp(), tz) - timedelta(days=days)

    with patch.object(certificates, "datetime", Earlier):
        yield


@contextmanager
def serving(authority: Authority, lines: list[str] | None = None) -> Iterator[AuthorityService]:
    """Run the authority's service in a thread."""
    report = (lambda _: None) if lines is None else lines.append
    service = AuthorityService(authority, "127.0.0.1", 0, report=report)
    thread = threading.Thread(target=lambda: asyncio.run(service.run()))
    thread.start()
    try:
        yield service
    finally:
        service.stop()
        thread.join(LIMIT_S)


def token_for(
    authority: Authority, service: AuthorityService, name: str, valid_s: float = 900
) -> Token:
    """Make a token, as `cairn security token` does."""
    return Token(
        url=service.url,
        ca=authority.fingerprint,
        robot=ROBOT,
        name=name,
        secret=authority.new_token(name, valid_s),
    )


def server_context(identity: Identity) -> ssl.SSLContext:
    """Return settings of TLS for a server that demands certificates of the robot's authority."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.verify_mode = ssl.CERT_REQUIRED
    context.load_verify_locations(identity.ca)
    context.load_cert_chain(identity.certificate, identity.key)
    return context


def client_context(ca: Path, identity: Identity | None = None) -> ssl.SSLContext:
    """Return settings of TLS for a client that checks the server, and may present an identity."""
    context = ssl.create_default_context(cafile=ca)
    if identity is not None:
        context.load_cert_chain(identity.certificate, identity.key)
    return context


def shake_hands(server: ssl.SSLContext, client: ssl.SSLContext, host: str = "127.0.0.1") -> None:
    """Connect a client and a server of TLS in memory; `ssl.SSLError` if one refuses the other."""
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = [
        client.wrap_bio(to_client, to_server, server_hostname=host),
        server.wrap_bio(to_server, to_client, server_side=True),
    ]
    for _ in range(6):  # flights, of which TLS 1.3 needs three
        for end in ends:
            try:
                end.do_handshake()
            except ssl.SSLWantReadError:
                continue
    for end in ends:
        end.do_handshake()  # raises `SSLWantReadError` if it is not complete
