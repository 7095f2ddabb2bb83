"""The roster of a robot: which certificates are in force and which are revoked.

The authority signs it. A certificate counts only while the roster has it in force, so a certificate
that the roster does not have, or has as revoked, opens nothing, however long it is valid.
"""

from __future__ import annotations

import json
import time
from typing import Annotated, Any, Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from cairn.bus.roles import Role
from cairn.errors import CairnError
from cairn.security.folder import PEM_BYTES, Kind, Name, RobotFolder, write_secret

ROSTER_BYTES: Final = 1 << 20
"""Largest roster that is read [bytes]."""
MOST_ENTRIES: Final = 1_000
_SIGNED: Final = b"cairn roster 1\n"
"""Stands before what is signed, so that no signature of the authority has two meanings."""

Time = Annotated[int, Field(ge=0, le=1 << 40)]
"""Seconds since 1970 (UTC)."""
Address = Annotated[str, Field(pattern=r"^[0-9A-Za-z.:_-]+$", max_length=253)]
CommonName = Annotated[str, Field(pattern=r"^[a-z0-9_.]+$", max_length=64)]


class StrictModel(BaseModel):
    """What is read from files and requests: nothing else than it declares is accepted."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Entry(StrictModel):
    """One certificate of an identity."""

    name: Name
    kind: Kind
    role: Role | None = None
    """Of an operator."""
    addresses: Annotated[tuple[Address, ...], Field(max_length=16)] = ()
    """Of a machine: IP addresses and host names, which its certificate has."""
    common_name: CommonName
    """Unique: a certificate that is renewed or issued again has another one."""
    serial: Annotated[str, Field(pattern=r"^[0-9a-f]{1,40}$")]
    not_after: Time
    ends: Time | None = None
    """When it is no longer in force, because a newer certificate has replaced it."""
    revoked: Time | None = None

    @model_validator(mode="after")
    def _complete(self) -> Entry:
        if (self.kind == "operator") != (self.role is not None):
            raise ValueError("an operator has a role, and a machine has none")
        if (self.kind == "machine") != bool(self.addresses):
            raise ValueError("a machine has addresses, and an operator has none")
        return self

    @property
    def is_current(self) -> bool:
        """Whether it is the identity's newest certificate, and is not revoked."""
        return self.ends is None and self.revoked is None

    def is_in_force(self, at: float) -> bool:
        """Whether it is accepted at a time [s since 1970]."""
        end = self.not_after if self.ends is None else min(self.ends, self.not_after)
        return self.revoked is None and at < end

    def state(self, at: float) -> str:
        """Describe it for users."""
        if self.revoked is not None:
            return "revoked"
        if at >= self.not_after:
            return "expired"
        if self.ends is None:
            return "in force"
        return "replaced, in force for a while" if self.is_in_force(at) else "replaced"


class Roster(StrictModel):
    """All identities of a robot that its authority knows."""

    robot: Name
    version: Annotated[int, Field(ge=1, le=1 << 50)]
    """Increases with each change."""
    issued: Time
    entries: Annotated[tuple[Entry, ...], Field(max_length=MOST_ENTRIES)]

    @model_validator(mode="after")
    def _consistent(self) -> Roster:
        names = [entry.common_name for entry in self.entries]
        if len(set(names)) < len(names):
            raise ValueError("two certificates have the same common name")
        current = [entry.name for entry in self.entries if entry.is_current]
        if len(set(current)) < len(current):
            raise ValueError("two current certificates have the same name")
        for entry in self.entries:
            head, _, tail = entry.common_name.rpartition(".")
            if head != f"{entry.kind}.{entry.name}.{self.robot}" or not tail:
                raise ValueError(f"the common name {entry.common_name} is not of {entry.name}")
        return self

    def current(self, name: str) -> Entry | None:
        """Return the newest certificate of an identity, expired or not, unless it is revoked."""
        return next((one for one in self.entries if one.name == name and one.is_current), None)

    def in_force(self, at: float | None = None) -> tuple[Entry, ...]:
        """Return the certificates that are accepted at a time [s since 1970], by default now."""
        moment = time.time() if at is None else at
        return tuple(entry for entry in self.entries if entry.is_in_force(moment))

    def common_names(
        self, kind: Kind | None = None, role: Role | None = None, at: float | None = None
    ) -> tuple[str, ...]:
        """Return the sorted common names in force of all identities, or those of a kind or role.

        It changes without a new roster when a certificate expires or a replaced one ends.
        """
        found = (
            one.common_name
            for one in self.in_force(at)
            if kind in (None, one.kind) and role in (None, one.role)
        )
        return tuple(sorted(found))


class _SignedRoster(StrictModel):
    roster: Roster
    signature: Annotated[str, Field(pattern=r"^([0-9a-f]{2}){8,80}$")]


def _canonical(value: Any) -> bytes:
    return json.dumps(value, sort_keys=True, separators=(",", ":")).encode("ascii")


def _bytes_to_sign(roster: Roster) -> bytes:
    return _SIGNED + _canonical(roster.model_dump(mode="json"))


def sign_roster(roster: Roster, ca_key: Any) -> bytes:
    """Return the content of a roster's file: the roster with the authority's signature."""
    from cairn.security import certificates

    signature = certificates.sign(ca_key, _bytes_to_sign(roster)).hex()
    return _canonical({"roster": roster.model_dump(mode="json"), "signature": signature}) + b"\n"


def parse_roster(data: bytes, ca: bytes, robot: str, source: str) -> Roster:
    """Return the roster in the content of its file.

    Args:
        data: the content; anything from the network.
        ca: certificate of the authority (PEM).
        robot: whose roster it must be.
        source: where the content is from, for messages.

    Raises:
        CairnError: it is damaged, not signed by this authority, or of another robot.
    """
    from cairn.security import certificates

    if len(data) > ROSTER_BYTES:
        raise CairnError(f"{source}: it has {len(data):,} bytes, more than a roster may have")
    again = "fetch it again from the authority (`cairn security fetch`)"
    try:
        signed = _SignedRoster.model_validate_json(data)
        is_canonical = data == _canonical(signed.model_dump(mode="json")) + b"\n"
    except ValidationError as error:
        reason = error.errors()[0]
        place = ".".join(map(str, reason["loc"])) or "text"
        raise CairnError(
            f"{source}: it is not a roster ({place}: {reason['msg']}); {again}"
        ) from None
    authority = certificates.read_certificate(ca, f"authority of {robot}")
    content, signature = _bytes_to_sign(signed.roster), bytes.fromhex(signed.signature)
    if not (is_canonical and certificates.is_signed(authority, signature, content)):
        raise CairnError(
            f"{source}: the authority of {robot} has not signed this roster, or it was changed "
            f"since; {again}"
        )
    if signed.roster.robot != robot:
        raise CairnError(
            f"{source}: it is the roster of robot {signed.roster.robot}, not of {robot}; {again}"
        )
    return signed.roster


def read_roster(folder: RobotFolder) -> Roster:
    """Return the roster in a robot's folder; `CairnError` if it is missing or not valid."""
    data = folder.read(folder.roster, ROSTER_BYTES, "run: cairn security fetch")
    return parse_roster(data, read_ca(folder), folder.robot, str(folder.roster))


def read_ca(folder: RobotFolder) -> bytes:
    """Return the certificate of a robot's authority (PEM); `CairnError` if it is missing."""
    return folder.read(folder.ca, PEM_BYTES, "enroll this computer: cairn security enroll TOKEN")


def accept_roster(folder: RobotFolder, data: bytes, source: str = "received roster") -> Roster:
    """Keep a received roster if it is newer than the one in the folder; return the one kept.

    Raises `CairnError`, and keeps the one it has, if the received one is older (a replay), differs
    from it in spite of the same version, is not signed by the authority, or of another robot.
    """
    with folder.locked():
        return accept_roster_locked(folder, data, source)


def accept_roster_locked(folder: RobotFolder, data: bytes, source: str) -> Roster:
    """Do as `accept_roster`, for a caller that holds the folder's lock."""
    received = parse_roster(data, read_ca(folder), folder.robot, source)
    if folder.roster.exists():
        known = read_roster(folder)
        if received == known:
            return known
        if received.version <= known.version:
            raise CairnError(
                f"{source}: its version {received.version} is not newer than version "
                f"{known.version}, which {folder.roster} has; if the authority was restored from "
                f"a backup, copy {folder.roster} into its folder"
            )
    write_secret(folder.roster, data)
    return received
