"""Certificates in real handshakes of TLS: whom each side accepts, as Python's ssl judges."""

import dataclasses
import ssl
from pathlib import Path

import pytest

from cairn.security import certificates
from cairn.security.authority import Authority
from cairn.security.folder import write_secret
from cairn.security.identity import Identity, own_identity
from tests.cairn.security.computers import (
    client_context,
    days_ago,
    new_authority,
    server_context,
    shake_hands,
)


def identity(authority: Authority, name: str) -> Identity:
    return own_identity(authority.folder, name)


def self_signed(like: Identity, folder: Path) -> Identity:
    """Return an identity with the names of another one that its own key has signed."""
    certificate, key = certificates.new_authority("rover", 90)
    paths = folder / "self.pem", folder / "self.key"
    write_secret(paths[0], certificates.certificate_pem(certificate))
    write_secret(paths[1], certificates.key_pem(key))
    return dataclasses.replace(like, certificate=paths[0], key=paths[1])


@pytest.mark.parametrize("client", ["brain", "alice"])
@pytest.mark.parametrize("host", ["127.0.0.1", "brain.local"])
def test_machine_accepts_machines_and_operators(
    authority: Authority, client: str, host: str
) -> None:
    server = identity(authority, "brain")

    shake_hands(
        server_context(server), client_context(server.ca, identity(authority, client)), host
    )


def test_server_at_another_address_is_refused(authority: Authority) -> None:
    server = identity(authority, "base")

    with pytest.raises(ssl.SSLCertVerificationError, match="Hostname mismatch"):
        shake_hands(server_context(server), client_context(server.ca, server), "brain.local")


def test_operator_is_no_server(authority: Authority) -> None:
    server = identity(authority, "alice")

    with pytest.raises(ssl.SSLCertVerificationError, match=r"(?i)purpose"):
        shake_hands(server_context(server), client_context(server.ca))


def test_client_without_certificate_is_refused(authority: Authority) -> None:
    server = identity(authority, "base")

    with pytest.raises(ssl.SSLError, match=r"(?i)did not return a certificate"):
        shake_hands(server_context(server), client_context(server.ca))


@pytest.mark.parametrize("refused", ["other authority", "self-signed", "expired"])
@pytest.mark.parametrize("side", ["client", "server"])
def test_strangers_and_the_expired_are_refused(tmp_path: Path, refused: str, side: str) -> None:
    with days_ago(10):
        authority = new_authority(tmp_path / "authority", days=1)
    expired = Identity(
        authority.roster().entries[0],
        authority.folder.certificate("brain"),
        authority.folder.key("brain"),
        authority.folder.ca,
    )
    authority.renew("base")
    right = identity(authority, "base")
    if refused == "other authority":
        wrong = identity(new_authority(tmp_path / "other"), "brain")
        wrong = dataclasses.replace(wrong, ca=right.ca)
    else:
        wrong = expired if refused == "expired" else self_signed(right, tmp_path)
    server, client = (right, wrong) if side == "client" else (wrong, right)

    with pytest.raises(ssl.SSLCertVerificationError, match=r"expired|self.signed|local issuer|CA"):
        shake_hands(server_context(server), client_context(right.ca, client))
