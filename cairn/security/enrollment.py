"""What a machine or operator asks of the authority: enroll, fetch the roster, renew a certificate.

The private key is made on the computer that uses it and never leaves it.
"""

from __future__ import annotations

import json
import ssl
from contextlib import closing
from http.client import HTTPException, HTTPSConnection
from typing import Annotated, Any, Final
from urllib.parse import urlsplit

from cryptography.hazmat.primitives.asymmetric import ec
from pydantic import Field, ValidationError

from cairn.errors import CairnError
from cairn.security import certificates
from cairn.security.folder import (
    MACHINES_KEY_BYTES,
    PEM_BYTES,
    RobotFolder,
    write_machines_key,
    write_secret,
)
from cairn.security.identity import Identity, entry_of, own_identity, write_identity
from cairn.security.roster import (
    ROSTER_BYTES,
    Roster,
    StrictModel,
    accept_roster,
    accept_roster_locked,
    parse_roster,
    read_ca,
)
from cairn.security.tokens import ServiceUrl, Token, decode_token

_LIMIT_S: Final = 10.0
_ANSWER_BYTES: Final = 2 * ROSTER_BYTES + PEM_BYTES  # a roster in JSON has its quotes escaped
_REASON_BYTES: Final = 1_000
_URL_BYTES: Final = 4_096


class AuthorityUnreachable(CairnError):
    """The authority's service does not answer: the roster that a machine has remains in force."""


class AuthorityRefused(CairnError):
    """The authority refuses a request, as from an identity that it has revoked.

    Attributes:
        status: of HTTP; 401 and 403: the identity or token is not accepted.
    """

    def __init__(self, message: str, status: int) -> None:
        super().__init__(message)
        self.status = status


MachinesKey = Annotated[str, Field(pattern=rf"^[0-9a-f]{{{2 * MACHINES_KEY_BYTES}}}$")]
"""The secret that the robot's machines share [hexadecimal]."""


class _AuthorityFile(StrictModel):
    url: ServiceUrl


class _Issued(StrictModel):
    certificate: Annotated[str, Field(max_length=PEM_BYTES)]
    roster: Annotated[str, Field(max_length=ROSTER_BYTES)]
    machines_key: MachinesKey | None = None


def write_url(folder: RobotFolder, url: str) -> None:
    """Keep the address of the authority's service; the caller holds the folder's lock."""
    write_secret(folder.authority, _AuthorityFile(url=url).model_dump_json().encode() + b"\n")


def read_url(folder: RobotFolder, remedy: str) -> str:
    """Return the address of the authority's service; `CairnError` with a remedy if unknown."""
    data = folder.read(folder.authority, _URL_BYTES, remedy)
    try:
        return _AuthorityFile.model_validate_json(data).url
    except ValidationError as error:
        raise CairnError(f"{folder.authority}: {error.errors()[0]['msg']}; {remedy}") from None


def enroll(text: str) -> Identity:
    """Get an identity for this computer with a token; return it.

    Raises `CairnError` if the token is refused, or the service does not prove to be the authority
    that the token names; nothing is written then.
    """
    token = decode_token(text)
    folder = RobotFolder.of(token.robot)
    folder.create()
    ca_pem = _ca_of(token)
    if folder.ca.exists() and read_ca(folder) != ca_pem:
        raise CairnError(
            f"{folder.ca}: this computer knows another authority of the robot {token.robot}; if "
            f"that one is no longer used, remove the folder {folder.path} and enroll again"
        )
    key = certificates.new_key()
    body = {
        "name": token.name,
        "secret": token.secret,
        "request": certificates.new_request(key, token.name).decode(),
    }
    data = _exchange(token.url, "/enroll", _client_context(ca_pem), body)
    _keep(folder, token.name, key, ca_pem, data, token.url)
    return own_identity(folder, token.name)


def fetch_roster(folder: RobotFolder, name: str, url: str) -> Roster:
    """Fetch the newest roster with an identity of this computer, keep it, and return it.

    Raises `AuthorityUnreachable`, `AuthorityRefused`, and `CairnError` if the identity is not in
    force or the roster is not accepted. The roster in the folder then remains.
    """
    data = _exchange(url, "/roster", _proving_context(folder, name))
    return accept_roster(folder, data, f"roster from {url}")


def renew_own(folder: RobotFolder, name: str, url: str) -> Identity:
    """Replace key and certificate of an identity of this computer, and return the new one.

    The earlier certificate remains in force for a while. Raises as `fetch_roster`.
    """
    context = _proving_context(folder, name)
    key = certificates.new_key()
    body = {"request": certificates.new_request(key, name).decode()}
    data = _exchange(url, "/renew", context, body)
    _keep(folder, name, key, read_ca(folder), data, url)
    return own_identity(folder, name)


def _keep(
    folder: RobotFolder,
    name: str,
    key: ec.EllipticCurvePrivateKey,
    ca_pem: bytes,
    data: bytes,
    url: str,
) -> None:
    """Check what the authority has issued, and write it; first the roster that has it in force."""
    try:
        issued = _Issued.model_validate_json(data)
    except ValidationError as error:
        raise CairnError(f"{url}: the answer is not valid: {error.errors()[0]['msg']}") from None
    source = f"certificate from {url}"
    roster_data = issued.roster.encode()
    roster = parse_roster(roster_data, ca_pem, folder.robot, f"roster from {url}")
    certificate = certificates.read_certificate(issued.certificate.encode(), source)
    ca = certificates.read_certificate(ca_pem, source)
    certificates.check_issued(certificate, ca, source)
    entry = entry_of(roster.entries, certificate)
    if not certificates.has_key(certificate, key) or entry is None or entry.name != name:
        raise CairnError(f"{source}: it is not the certificate that was requested for {name}")
    with folder.locked():
        if not folder.ca.exists():
            write_secret(folder.ca, ca_pem)
        accept_roster_locked(folder, roster_data, f"roster from {url}")
        write_identity(folder, name, certificate, key)
        if issued.machines_key is not None:
            write_machines_key(folder, bytes.fromhex(issued.machines_key))
        write_url(folder, url)


def _ca_of(token: Token) -> bytes:
    """Return the authority's certificate (PEM), which must have the token's fingerprint.

    This connection is not verified, and carries nothing secret.
    """
    context = _tls()
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    data = _exchange(token.url, "/ca", context)
    source = f"certificate from {token.url}"
    certificate = certificates.read_certificate(data, source)
    if certificates.fingerprint(certificate) != token.ca:
        raise CairnError(
            f"{source}: it is not the authority that the token names (its fingerprint is "
            f"{certificates.fingerprint(certificate)[:16]}..., the token has {token.ca[:16]}...); "
            "another computer may answer in its place. Nothing was sent to it; check the address"
        )
    return certificates.certificate_pem(certificate)


def _tls() -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_3
    return context


def _client_context(ca: bytes) -> ssl.SSLContext:
    """Return settings of TLS that accept no server but those of the authority."""
    context = _tls()
    context.load_verify_locations(cadata=ca.decode("ascii"))
    return context


def _proving_context(folder: RobotFolder, name: str) -> ssl.SSLContext:
    """Return settings of TLS that also present an identity of this computer."""
    identity = own_identity(folder, name)
    context = _client_context(read_ca(folder))
    with folder.locked():  # or a renewal by another process may replace one of the two files
        context.load_cert_chain(identity.certificate, identity.key)
    return context


def _exchange(
    url: str, path: str, context: ssl.SSLContext, body: dict[str, Any] | None = None
) -> bytes:
    """Return the answer to a request: a GET, or a POST with a body of JSON.

    Raises `AuthorityUnreachable`, `AuthorityRefused`, or `CairnError` if the connection cannot be
    made secure or the answer is not valid.
    """
    parts = urlsplit(url)
    assert parts.hostname is not None  # as `ServiceUrl` ensures
    connection = HTTPSConnection(parts.hostname, parts.port, timeout=_LIMIT_S, context=context)
    with closing(connection):
        try:
            if body is None:
                connection.request("GET", path)
            else:
                headers = {"Content-Type": "application/json"}
                connection.request("POST", path, json.dumps(body).encode(), headers)
            answer = connection.getresponse()
            limit = _ANSWER_BYTES if answer.status == 200 else _REASON_BYTES
            data = answer.read(limit + 1)
        except ssl.SSLCertVerificationError as error:
            raise CairnError(
                f"{url}: the service there does not prove to be the authority: "
                f"{error.verify_message}; check the address, and the clocks of both computers"
            ) from error
        except ssl.SSLError as error:
            raise CairnError(
                f"{url}: no secure connection: {error.reason or error}; the service may not accept "
                "this certificate, or be another program"
            ) from error
        except OSError as error:
            raise AuthorityUnreachable(
                f"{url}: the authority does not answer: {error.strerror or error}; does `cairn "
                "security serve` run there, and is the address right?"
            ) from error
        except HTTPException as error:
            raise CairnError(f"{url}: another program answers there: {error!r}") from error
    if answer.status != 200:
        reason = data[:_REASON_BYTES].decode("utf-8", errors="replace")
        raise AuthorityRefused(
            f"{url}: the authority refuses ({answer.status}): {reason}", answer.status
        )
    if len(data) > limit:
        raise CairnError(f"{url}: the answer has more than {limit:,} bytes")
    return data
