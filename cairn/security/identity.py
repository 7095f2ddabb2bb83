"""The identities of this computer: certificate and private key, and whether they are in force."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from cairn.errors import CairnError
from cairn.security import certificates
from cairn.security.folder import PEM_BYTES, RobotFolder, check_name, read_secret, write_secret
from cairn.security.roster import Entry, Roster, read_ca, read_roster
from cairn.system.files import explain_os_error

_NEXT: Final = ".next"
_KEY_BEGINS: Final = b"-----BEGIN PRIVATE KEY-----"


@dataclass(frozen=True)
class Identity:
    """An identity in force, with the files (PEM) that prove it.

    Attributes:
        entry: its certificate in the roster.
        certificate, key, ca: paths, as Zenoh and `ssl` take them.
    """

    entry: Entry
    certificate: Path
    key: Path
    ca: Path


def own_names(folder: RobotFolder) -> list[str]:
    """Return the names of the identities whose keys are on this computer."""
    folder.check()
    return sorted(path.stem for path in folder.identities.glob("*.key"))


def own_identity(folder: RobotFolder, name: str) -> Identity:
    """Return an identity of this computer, which a session can present now.

    Raises `CairnError` with the reason if it is missing, readable by others, expired, revoked,
    replaced, or not of this robot's authority.
    """
    check_name(name, "identity")
    remedy = f"enroll {name} on this computer: cairn security enroll TOKEN"
    path, key_path = folder.certificate(name), folder.key(name)
    with folder.locked():
        finish_writing(folder, name)
        certificate = certificates.read_certificate(folder.read(path, PEM_BYTES, remedy), str(path))
        key = certificates.read_key(folder.read(key_path, PEM_BYTES, remedy), str(key_path))
        ca = certificates.read_certificate(read_ca(folder), str(folder.ca))
        roster = read_roster(folder)
    check_pair(certificate, key, ca, str(path))
    entry = check_in_force(roster, name, certificate, str(path))
    return Identity(entry, path, key_path, folder.ca)


def is_renewal_due(identity: Identity, at: float) -> bool:
    """Return whether less than a third of a certificate's validity is left at a time [s]."""
    data = read_secret(identity.certificate, PEM_BYTES)
    certificate = certificates.read_certificate(data, str(identity.certificate))
    begin = certificate.not_valid_before_utc.timestamp()
    end = certificate.not_valid_after_utc.timestamp()
    return end - at < (end - begin) / 3


def check_in_force(roster: Roster, name: str, certificate: x509.Certificate, path: str) -> Entry:
    """Return the entry of a certificate; `CairnError` with the reason unless it is in force."""
    token = f"make a token on the authority's computer (cairn security token {name}) and enroll"
    certificates.check_valid(certificate, f"{path}: certificate of {name}", token)
    entry = entry_of(roster.entries, certificate)
    if entry is None or entry.name != name:
        raise CairnError(
            f"{path}: the roster does not have the certificate "
            f"{certificates.common_name(certificate)} of {name}, so it was replaced or is of "
            f"another authority; {token}"
        )
    if entry.revoked is not None:
        when = time.strftime("%Y-%m-%d %H:%M", time.gmtime(entry.revoked))
        raise CairnError(f"{path}: {name} was revoked on {when} UTC; ask its administrator")
    if not entry.is_in_force(time.time()):
        raise CairnError(f"{path}: another certificate has replaced this one of {name}; {token}")
    return entry


def entry_of(entries: tuple[Entry, ...], certificate: x509.Certificate) -> Entry | None:
    """Return the entry of a certificate, by common name and serial number."""
    name, number = certificates.common_name(certificate), certificates.serial(certificate)
    return next((one for one in entries if (one.common_name, one.serial) == (name, number)), None)


def check_pair(
    certificate: x509.Certificate,
    key: ec.EllipticCurvePrivateKey,
    ca: x509.Certificate,
    what: str,
) -> None:
    """Raise `CairnError` unless certificate and key belong together and are of the authority."""
    certificates.check_issued(certificate, ca, what)
    if not certificates.has_key(certificate, key):
        raise CairnError(
            f"{what}: the private key beside it is not of this certificate; restore it"
        )


def write_identity(
    folder: RobotFolder, name: str, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey
) -> None:
    """Replace certificate and key of an identity; the caller holds the folder's lock.

    If the process is killed meanwhile, `own_identity` completes the replacement.
    """
    content = certificates.certificate_pem(certificate) + certificates.key_pem(key)
    write_secret(_next(folder, name), content)
    finish_writing(folder, name)


def finish_writing(folder: RobotFolder, name: str) -> None:
    """Complete a replacement of certificate and key; the caller holds the folder's lock."""
    path = _next(folder, name)
    if not path.exists():
        return
    text = folder.read(path, 2 * PEM_BYTES, "enroll again")
    certificate, begin, key = text.partition(_KEY_BEGINS)
    write_secret(folder.key(name), begin + key)
    write_secret(folder.certificate(name), certificate)
    path.unlink()


def remove_identity(folder: RobotFolder, name: str) -> None:
    """Remove certificate and key of an identity from this computer, if they are there."""
    try:
        for path in (_next(folder, name), folder.key(name), folder.certificate(name)):
            path.unlink(missing_ok=True)
    except OSError as error:
        raise CairnError(f"{path}: it cannot be removed: {explain_os_error(error)}") from error


def _next(folder: RobotFolder, name: str) -> Path:
    return folder.identities / (name + _NEXT)
