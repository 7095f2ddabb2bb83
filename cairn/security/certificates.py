"""Certificates and keys: X.509 (RFC 5280) with keys on the curve P-256."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from typing import Final

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from cairn.errors import CairnError
from cairn.security.folder import PEM_BYTES, Kind

BACKDATED: Final = timedelta(hours=1)
"""Certificates are valid from so long before they are made: clocks of machines differ."""

_LONGEST_COMMON_NAME: Final = 64  # RFC 5280, upper bounds
_USAGES: Final = {
    "machine": (ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH),
    "operator": (ExtendedKeyUsageOID.CLIENT_AUTH,),
    "authority": (ExtendedKeyUsageOID.SERVER_AUTH,),
}
_PURPOSE: Final = ec.ECDSA(hashes.SHA256())
_UNREADABLE: Final = (
    ValueError, TypeError, UnsupportedAlgorithm, x509.DuplicateExtension, x509.InvalidVersion,
    x509.UnsupportedGeneralNameType,
)  # fmt: skip


def new_key() -> ec.EllipticCurvePrivateKey:
    """Return a new private key."""
    return ec.generate_private_key(ec.SECP256R1())


def key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    """Return a private key as PEM, not encrypted."""
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def certificate_pem(certificate: x509.Certificate) -> bytes:
    """Return a certificate as PEM."""
    return certificate.public_bytes(serialization.Encoding.PEM)


def read_key(data: bytes, source: str) -> ec.EllipticCurvePrivateKey:
    """Return the private key in a PEM text; `CairnError` if it has none on the curve P-256."""
    try:
        if len(data) > PEM_BYTES:
            raise ValueError("it is too large")
        key = serialization.load_pem_private_key(data, password=None)
    except _UNREADABLE as error:
        raise CairnError(
            f"{source}: it is not a private key (PEM, without password): {error}; restore it"
        ) from None
    if not isinstance(key, ec.EllipticCurvePrivateKey) or not isinstance(key.curve, ec.SECP256R1):
        raise CairnError(f"{source}: the key is not on the curve P-256; make a new identity")
    return key


def read_certificate(data: bytes, source: str) -> x509.Certificate:
    """Return the certificate in a PEM text; `CairnError` if it is not one on the curve P-256."""
    try:
        if len(data) > PEM_BYTES:
            raise ValueError("it is too large")
        certificate = x509.load_pem_x509_certificate(data)
        key = certificate.public_key()
        # Each part is parsed when it is read: here, where an error names the file.
        parts = ("subject", "issuer", "not_valid_before_utc", "not_valid_after_utc", "extensions")
        for part in parts:
            getattr(certificate, part)
    except _UNREADABLE as error:
        raise CairnError(f"{source}: it is not a certificate (PEM): {error}; restore it") from None
    if not isinstance(key, ec.EllipticCurvePublicKey) or not isinstance(key.curve, ec.SECP256R1):
        raise CairnError(f"{source}: the certificate's key is not on the curve P-256")
    return certificate


def fingerprint(certificate: x509.Certificate) -> str:
    """Return the SHA-256 of a certificate, in hexadecimal digits."""
    return certificate.fingerprint(hashes.SHA256()).hex()


def common_name(certificate: x509.Certificate) -> str:
    """Return the common name of a certificate, empty if it has not exactly one."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if len(names) == 1 else ""


def not_after(certificate: x509.Certificate) -> int:
    """Return when a certificate expires [s since 1970]."""
    return int(certificate.not_valid_after_utc.timestamp())


def serial(certificate: x509.Certificate) -> str:
    """Return the serial number of a certificate, in hexadecimal digits."""
    return f"{certificate.serial_number:x}"


def new_common_name(kind: str, name: str, robot: str) -> str:
    """Return a common name that no other certificate of an authority has.

    Zenoh's access control knows a certificate by it alone.
    """
    text = f"{kind}.{name}.{robot}.{secrets.token_hex(4)}"
    if len(text) > _LONGEST_COMMON_NAME:
        longest = _LONGEST_COMMON_NAME - (len(text) - len(name) - len(robot))
        raise CairnError(
            f"{kind} {name}: this name and that of the robot {robot} have together "
            f"{len(name) + len(robot)} characters, and may have {longest}; shorten one"
        )
    return text


def new_authority(robot: str, days: int) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    """Return certificate and key of a new authority for a robot."""
    key = new_key()
    now = datetime.now(UTC)
    name = x509.Name(
        [x509.NameAttribute(NameOID.COMMON_NAME, new_common_name("ca", "cairn", robot))]
    )
    public = key.public_key()
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - BACKDATED)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_key_usage(signs_certificates=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public), critical=False)
        .sign(key, hashes.SHA256())
    )
    return certificate, key


def issue(
    authority: tuple[x509.Certificate, ec.EllipticCurvePrivateKey],
    public_key: ec.EllipticCurvePublicKey,
    kind: Kind | None,
    subject: str,
    addresses: Sequence[str],
    days: int,
) -> x509.Certificate:
    """Return a new certificate.

    Args:
        authority: certificate and key of the authority.
        public_key: whose certificate it is.
        kind: a machine may be server and client, an operator client only; None: the authority's
            own service, which is a server only.
        subject: its common name.
        addresses: IP addresses and host names at which the server is reached.
        days: for which it is valid, but not longer than the authority.

    Raises:
        CairnError: the authority has expired.
    """
    ca, ca_key = authority
    now = datetime.now(UTC)
    check_valid(ca, "certificate of the authority", "make a new authority: cairn security init")
    builder = (
        x509.CertificateBuilder()
        .subject_name(x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, subject)]))
        .issuer_name(ca.subject)
        .public_key(public_key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(max(now - BACKDATED, ca.not_valid_before_utc))
        .not_valid_after(min(now + timedelta(days=days), ca.not_valid_after_utc))
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(_USAGES[kind or "authority"]), critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public_key), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(ca_key.public_key()), critical=False
        )
    )
    if addresses:
        names = x509.SubjectAlternativeName([_general_name(text) for text in addresses])
        builder = builder.add_extension(names, critical=False)
    return builder.sign(ca_key, hashes.SHA256())


def _general_name(address: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(address))
    except ValueError:
        return x509.DNSName(address)


def _key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=True,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def check_valid(certificate: x509.Certificate, what: str, remedy: str) -> None:
    """Raise `CairnError` unless a certificate is valid now."""
    now = datetime.now(UTC)
    if now >= certificate.not_valid_after_utc:
        when = certificate.not_valid_after_utc
        raise CairnError(f"{what}: it expired on {when:%Y-%m-%d %H:%M} UTC; {remedy}")
    if now < certificate.not_valid_before_utc:
        when = certificate.not_valid_before_utc
        raise CairnError(
            f"{what}: it is valid from {when:%Y-%m-%d %H:%M} UTC, and the clock of this computer "
            f"shows {now:%Y-%m-%d %H:%M}; set the clock"
        )


def check_issued(certificate: x509.Certificate, ca: x509.Certificate, what: str) -> None:
    """Raise `CairnError` unless the authority has issued a certificate."""
    try:
        certificate.verify_directly_issued_by(ca)
    except (InvalidSignature, *_UNREADABLE):
        raise CairnError(
            f"{what}: the authority {common_name(ca)} has not issued this certificate; enroll again"
        ) from None


def has_key(certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> bool:
    """Return whether a private key belongs to a certificate."""
    return certificate.public_key() == key.public_key()


def new_request(key: ec.EllipticCurvePrivateKey, name: str) -> bytes:
    """Return a request (PKCS #10, PEM) for a certificate of a key."""
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    request = x509.CertificateSigningRequestBuilder().subject_name(subject)
    return request.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)


def requested_key(request: bytes) -> ec.EllipticCurvePublicKey:
    """Return the public key in a request, whose sender has proven to have the private one.

    The authority ignores all else in it. Raises `ValueError` if it is not valid.
    """
    try:
        parsed = x509.load_pem_x509_csr(request)
        key = parsed.public_key()
        is_proven = parsed.is_signature_valid
    except (InvalidSignature, *_UNREADABLE) as error:
        raise ValueError("it is not a certificate request (PEM)") from error
    if not isinstance(key, ec.EllipticCurvePublicKey) or not isinstance(key.curve, ec.SECP256R1):
        raise ValueError("its key is not on the curve P-256")
    if not is_proven:
        raise ValueError("its signature is wrong")
    return key


def sign(key: ec.EllipticCurvePrivateKey, data: bytes) -> bytes:
    """Return the signature (ECDSA, SHA-256) of data."""
    return key.sign(data, _PURPOSE)


def is_signed(certificate: x509.Certificate, signature: bytes, data: bytes) -> bool:
    """Return whether the key of a certificate has signed data."""
    key = certificate.public_key()
    assert isinstance(key, ec.EllipticCurvePublicKey)  # as `read_certificate` ensures
    try:
        key.verify(signature, data, _PURPOSE)
    except InvalidSignature:
        return False
    return True
