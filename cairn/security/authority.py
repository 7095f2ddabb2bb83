"""The certificate authority of a robot: it issues and revokes certificates and signs the roster."""

from __future__ import annotations

import re
import secrets
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from ipaddress import ip_address
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from cairn.bus.roles import Role
from cairn.errors import CairnError
from cairn.security import certificates
from cairn.security.folder import (
    MACHINES_KEY_BYTES,
    PEM_BYTES,
    Kind,
    RobotFolder,
    check_name,
    read_machines_key,
    write_machines_key,
    write_secret,
)
from cairn.security.identity import remove_identity, write_identity
from cairn.security.roster import (
    MOST_ENTRIES,
    ROSTER_BYTES,
    Entry,
    Roster,
    read_ca,
    read_roster,
    sign_roster,
)
from cairn.security.tokens import TokenRefused, discard_tokens, redeem, store_token

VALID_DAYS: Final = 90
AUTHORITY_DAYS: Final = 3650
GRACE_S: Final = 86_400.0
"""A certificate that was renewed remains in force for so long, while links change to the new one.
"""
_MOST_IN_FORCE: Final = 4
"""Certificates of one identity in force: a machine that renews without end is refused."""

_HOST_NAME: Final = re.compile(r"(?!.*\.\.)[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")


@dataclass(frozen=True)
class AuthorityMember:
    """A machine or operator that gets an identity.

    Attributes:
        name: unique among both.
        role: what an operator may do; None: it is a machine.
        addresses: IP addresses and host names at which others reach a machine.
    """

    name: str
    role: Role | None = None
    addresses: tuple[str, ...] = ()

    @property
    def kind(self) -> Kind:
        """Whether it is a machine or an operator."""
        return "machine" if self.role is None else "operator"


def members_of(
    machines: Mapping[str, Sequence[str]], operators: Mapping[str, Role]
) -> list[AuthorityMember]:
    """Return machines with their addresses, and operators with their roles, as members.

    Raises `CairnError` for a name or address that is not valid, or a name of both.
    """
    if both := sorted(machines.keys() & operators.keys()):
        raise CairnError(f"{both[0]}: it is the name of a machine and an operator; rename one")
    found = [
        AuthorityMember(check_name(name, "machine"), None, check_addresses(name, addresses))
        for name, addresses in machines.items()
    ]
    found += [
        AuthorityMember(check_name(name, "operator"), role) for name, role in operators.items()
    ]
    return found


def check_addresses(name: str, addresses: Iterable[str]) -> tuple[str, ...]:
    """Return the addresses of a machine; `CairnError` if one is not an IP address or host name."""
    found = tuple(dict.fromkeys(addresses))
    if not 1 <= len(found) <= 16:
        raise CairnError(f"machine {name}: it has {len(found)} addresses; give 1 to 16")
    for text in found:
        try:
            address = ip_address(text)
        except ValueError:
            looks_numeric = not re.search("[A-Za-z]", text)
            if looks_numeric or not _HOST_NAME.fullmatch(text):
                raise CairnError(
                    f"machine {name}: {text[:100]!r} is not an IP address or host name; write one, "
                    "without port"
                ) from None
        else:
            if "%" in text:  # a scope is a name that only this computer has, and not in X.509
                raise CairnError(
                    f"machine {name}: {text[:100]!r} is an address on a link of this computer; "
                    "give a host name, or an address that is valid everywhere"
                )
            if address.is_unspecified:
                raise CairnError(
                    f"machine {name}: {text} stands for all addresses; give those at which other "
                    "machines reach it"
                )
    return found


class RenewalRefused(CairnError):
    """An identity may not renew its certificate now."""


class Authority:
    """The authority of a robot, on the computer that has its key."""

    def __init__(self, folder: RobotFolder) -> None:
        """Read its certificate and key; `CairnError` if they are missing or do not match."""
        self.folder = folder
        self.ca_pem = read_ca(folder)
        self.ca = certificates.read_certificate(self.ca_pem, str(folder.ca))
        remedy = "run this on the computer of the authority, where `cairn security init` was run"
        key = folder.read(folder.ca_key, PEM_BYTES, remedy)
        self._key = certificates.read_key(key, str(folder.ca_key))
        if not certificates.has_key(self.ca, self._key):
            raise CairnError(
                f"{folder.ca_key}: it is not the key of {folder.ca}; restore the one of the two "
                "files that was replaced"
            )

    @classmethod
    def create(
        cls,
        folder: RobotFolder,
        members: Sequence[AuthorityMember],
        days: int = VALID_DAYS,
        authority_days: int = AUTHORITY_DAYS,
    ) -> Authority:
        """Make an authority with identities; their keys are in the same folder.

        Raises `CairnError` if the folder has an authority already, or a name is too long.
        """
        ca, ca_key = certificates.new_authority(folder.robot, authority_days)
        made = [_issue((ca, ca_key), folder.robot, member, days) for member in members]
        entries = tuple(entry for entry, _, _ in made)
        roster = Roster(robot=folder.robot, version=1, issued=int(time.time()), entries=entries)
        signed = sign_roster(roster, ca_key)
        folder.create()
        with folder.locked():
            for path in (folder.ca, folder.ca_key, folder.roster):
                if path.exists():
                    raise CairnError(
                        f"{path}: the robot {folder.robot} has an authority already; add "
                        "identities to it (`cairn security add`), or remove the folder "
                        f"{folder.path}, whose certificates are then worth nothing"
                    )
            write_secret(folder.ca_key, certificates.key_pem(ca_key))
            write_secret(folder.ca, certificates.certificate_pem(ca))
            write_secret(folder.roster, signed)
            write_machines_key(folder, secrets.token_bytes(MACHINES_KEY_BYTES))
            for entry, certificate, key in made:
                write_identity(folder, entry.name, certificate, key)
        return cls(folder)

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the authority's certificate."""
        return certificates.fingerprint(self.ca)

    def roster(self) -> Roster:
        """Return the current roster."""
        return read_roster(self.folder)

    def roster_file(self) -> bytes:
        """Return the current roster with its signature."""
        return self.folder.read(self.folder.roster, ROSTER_BYTES, "restore it from a machine")

    def machines_key(self, name: str) -> str | None:
        """Return the secret that the machines share [hexadecimal]; None if `name` is an operator.

        A machine that was revoked knows it, but reaches no other one any more.
        """
        entry = self.roster().current(name)
        is_machine = entry is not None and entry.kind == "machine"
        return read_machines_key(self.folder).hex() if is_machine else None

    def add(self, member: AuthorityMember, days: int = VALID_DAYS) -> Entry:
        """Make one more identity, with its key in this folder; `CairnError` if the name is used."""
        with self.folder.locked():
            roster = self.roster()
            if roster.current(member.name) is not None:
                raise CairnError(
                    f"{member.name}: the robot {roster.robot} has this identity already; choose "
                    f"another name, or revoke it first (cairn security revoke {member.name})"
                )
            entry, certificate, key = _issue((self.ca, self._key), roster.robot, member, days)
            self._write(roster, (*roster.entries, entry))
            write_identity(self.folder, entry.name, certificate, key)
        return entry

    def renew(self, name: str, days: int = VALID_DAYS, grace_s: float = GRACE_S) -> Entry:
        """Replace certificate and key of an identity whose key is in this folder.

        The earlier certificate remains in force for `grace_s` [s].
        """
        key = certificates.new_key()
        with self.folder.locked():
            roster = self.roster()
            current = self._current(roster, name)
            if not self.folder.key(name).exists():
                raise CairnError(
                    f"{name}: its key is on its own computer; run `cairn security renew {name}` "
                    "there, or enroll it again (`cairn security token`)"
                )
            certificate, entry = self._replace(roster, current, key.public_key(), days, grace_s)
            write_identity(self.folder, name, certificate, key)
        return entry

    def revoke(self, name: str) -> int:
        """Revoke all certificates of an identity, and its tokens; return their number."""
        now = int(time.time())
        with self.folder.locked():
            roster = self.roster()
            found = [one for one in roster.entries if one.name == name and one.revoked is None]
            if not found:
                raise CairnError(
                    f"{name}: the robot {roster.robot} has no identity of this name to revoke; "
                    "`cairn security list` lists them"
                )
            revoked = (
                one.model_copy(update={"revoked": now}) if one in found else one
                for one in roster.entries
            )
            self._write(roster, tuple(revoked))
            discard_tokens(self.folder, name)
            remove_identity(self.folder, name)
        return len(found)

    def new_token(self, name: str, valid_s: float) -> str:
        """Return the secret of a new token with which a computer gets an identity, once."""
        now = time.time()
        with self.folder.locked():
            entry = self._current(self.roster(), name)
            return store_token(self.folder, name, entry.kind, entry.role, int(now + valid_s), now)

    def enroll(
        self, name: str, secret: str, public_key: ec.EllipticCurvePublicKey, days: int
    ) -> tuple[bytes, bytes]:
        """Use up a token; return the identity's new certificate (PEM) and the roster.

        Its other tokens count no more, and its earlier certificates are no longer in force: they
        and their keys may be elsewhere. Raises `TokenRefused`.
        """
        with self.folder.locked():
            roster = self.roster()
            entry = roster.current(name)
            if entry is None:
                raise TokenRefused
            redeem(self.folder, name, entry.kind, entry.role, secret, time.time())
            discard_tokens(self.folder, name)
            certificate, _ = self._replace(roster, entry, public_key, days, 0.0)
            remove_identity(self.folder, name)
            return certificates.certificate_pem(certificate), self.roster_file()

    def renew_for(
        self, holder: Entry, public_key: ec.EllipticCurvePublicKey, days: int, grace_s: float
    ) -> tuple[bytes, bytes]:
        """Return a new certificate (PEM) and the roster to the holder of one in force.

        Raises `RenewalRefused` if it ended meanwhile, or has been renewed too often.
        """
        with self.folder.locked():
            roster = self.roster()
            in_force = [one for one in roster.in_force() if one.name == holder.name]
            if holder.common_name not in {one.common_name for one in in_force}:
                raise RenewalRefused(
                    f"{holder.name}: this certificate is no longer in force; enroll again"
                )
            if len(in_force) >= _MOST_IN_FORCE:
                raise RenewalRefused(
                    f"{holder.name}: it has {len(in_force)} certificates in force already; wait "
                    "until the replaced ones end, or revoke it and enroll again"
                )
            current = self._current(roster, holder.name)
            certificate, _ = self._replace(roster, current, public_key, days, grace_s)
            return certificates.certificate_pem(certificate), self.roster_file()

    def service_certificate(self, addresses: Sequence[str], days: int) -> tuple[bytes, bytes]:
        """Return certificate and key (PEM) of the authority's service; the roster lacks it."""
        key = certificates.new_key()
        subject = certificates.new_common_name("authority", "service", self.folder.robot)
        made = certificates.issue(
            (self.ca, self._key), key.public_key(), None, subject, addresses, days
        )
        return certificates.certificate_pem(made), certificates.key_pem(key)

    def _current(self, roster: Roster, name: str) -> Entry:
        entry = roster.current(name)
        if entry is None:
            raise CairnError(
                f"{name}: the robot {roster.robot} has no identity of this name, or it was "
                f"revoked; add it: cairn security add {name}"
            )
        return entry

    def _replace(
        self,
        roster: Roster,
        entry: Entry,
        public_key: ec.EllipticCurvePublicKey,
        days: int,
        grace_s: float,
    ) -> tuple[x509.Certificate, Entry]:
        """Issue a new certificate of an identity; earlier ones end after `grace_s`."""
        member = AuthorityMember(entry.name, entry.role, entry.addresses)
        made, new = _certify((self.ca, self._key), roster.robot, member, public_key, days)
        end = int(time.time() + grace_s)
        entries = [
            one.model_copy(update={"ends": end if one.ends is None else min(one.ends, end)})
            if one.name == entry.name and one.revoked is None
            else one
            for one in roster.entries
        ]
        self._write(roster, (*entries, new))
        return made, new

    def _write(self, roster: Roster, entries: tuple[Entry, ...]) -> None:
        """Sign and write the next version, without certificates that no longer matter."""
        now = time.time()
        kept = tuple(
            one
            for one in entries
            if one.is_current
            or one.is_in_force(now)
            or (one.revoked is not None and now < one.not_after)
        )
        if len(kept) > MOST_ENTRIES:
            raise CairnError(
                f"{self.folder.roster}: it has {MOST_ENTRIES} certificates, as many as it may "
                "have; revoked ones are removed when they expire"
            )
        changed = Roster(
            robot=roster.robot, version=roster.version + 1, issued=int(now), entries=kept
        )
        write_secret(self.folder.roster, sign_roster(changed, self._key))


_Signer = tuple[x509.Certificate, ec.EllipticCurvePrivateKey]


def _issue(
    authority: _Signer, robot: str, member: AuthorityMember, days: int
) -> tuple[Entry, x509.Certificate, ec.EllipticCurvePrivateKey]:
    key = certificates.new_key()
    made, entry = _certify(authority, robot, member, key.public_key(), days)
    return entry, made, key


def _certify(
    authority: _Signer,
    robot: str,
    member: AuthorityMember,
    public_key: ec.EllipticCurvePublicKey,
    days: int,
) -> tuple[x509.Certificate, Entry]:
    subject = certificates.new_common_name(member.kind, member.name, robot)
    made = certificates.issue(authority, public_key, member.kind, subject, member.addresses, days)
    entry = Entry(
        name=member.name,
        kind=member.kind,
        role=member.role,
        addresses=member.addresses,
        common_name=subject,
        serial=certificates.serial(made),
        not_after=certificates.not_after(made),
    )
    return made, entry
