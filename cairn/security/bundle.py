"""A file with which an identity is copied by hand to a computer that cannot enroll."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, ValidationError

from cairn.errors import CairnError
from cairn.security import certificates
from cairn.security.enrollment import MachinesKey, read_url, write_url
from cairn.security.folder import (
    PEM_BYTES,
    Name,
    RobotFolder,
    read_machines_key,
    read_secret,
    write_machines_key,
    write_secret,
)
from cairn.security.identity import (
    Identity,
    check_in_force,
    check_pair,
    own_identity,
    write_identity,
)
from cairn.security.roster import (
    ROSTER_BYTES,
    StrictModel,
    accept_roster_locked,
    parse_roster,
    read_ca,
    read_roster,
)
from cairn.security.tokens import ServiceUrl
from cairn.system.files import explained

_BUNDLE_BYTES: Final = 2 * ROSTER_BYTES + 4 * PEM_BYTES

Pem = Annotated[str, Field(max_length=PEM_BYTES)]


class _Bundle(StrictModel):
    cairn_identity: Literal[1] = 1
    robot: Name
    name: Name
    ca: Pem
    certificate: Pem
    key: Pem
    roster: Annotated[str, Field(max_length=ROSTER_BYTES)]
    authority: ServiceUrl | None = None
    machines_key: MachinesKey | None = None


def export_identity(folder: RobotFolder, name: str, path: Path) -> Identity:
    """Write an identity of this computer with its private key to a new file for its owner alone.

    Raises `CairnError` if the identity is not in force, or the file exists.
    """
    if not folder.key(name).exists():
        raise CairnError(
            f"{name}: its key is not on this computer: it has enrolled on its own, or has no "
            "identity; `cairn security list` lists those in force"
        )
    identity = own_identity(folder, name)
    roster = folder.read(folder.roster, ROSTER_BYTES, "run: cairn security fetch")
    is_machine = identity.entry.kind == "machine"
    bundle = _Bundle(
        robot=folder.robot,
        name=name,
        ca=read_ca(folder).decode("ascii"),
        certificate=identity.certificate.read_text("ascii"),
        key=identity.key.read_text("ascii"),
        roster=roster.decode("ascii"),
        authority=read_url(folder, "remove it") if folder.authority.exists() else None,
        machines_key=read_machines_key(folder).hex() if is_machine else None,
    )
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
    with (
        explained(f"{path}: it cannot be created"),
        open(os.open(path, flags, 0o600), "wb") as file,
    ):
        file.write(bundle.model_dump_json(indent=2).encode() + b"\n")
    return identity


def import_identity(path: Path) -> Identity:
    """Take the identity in a file into the security folder; return it.

    Raises `CairnError` if the file is readable by others, damaged, of another authority than this
    computer knows of the robot, or its certificate is not in force.
    """
    data = read_secret(path, _BUNDLE_BYTES)
    try:
        bundle = _Bundle.model_validate_json(data)
    except ValidationError as error:
        reason = error.errors()[0]
        place = ".".join(map(str, reason["loc"])) or "text"
        raise CairnError(
            f"{path}: it is not an exported identity ({place}: {reason['msg']}); copy again what "
            "`cairn security export` has written"
        ) from None
    folder = RobotFolder.of(bundle.robot)
    ca_pem, roster_data = bundle.ca.encode(), bundle.roster.encode()
    ca = certificates.read_certificate(ca_pem, str(path))
    certificate = certificates.read_certificate(bundle.certificate.encode(), str(path))
    key = certificates.read_key(bundle.key.encode(), str(path))
    check_pair(certificate, key, ca, str(path))
    roster = parse_roster(roster_data, ca_pem, bundle.robot, str(path))
    folder.create()
    with folder.locked():
        is_new = not folder.ca.exists()
        if not is_new and read_ca(folder) != certificates.certificate_pem(ca):
            raise CairnError(
                f"{folder.ca}: this computer knows another authority of the robot {bundle.robot}; "
                f"if that one is no longer used, remove the folder {folder.path} and import again"
            )
        known = read_roster(folder) if folder.roster.exists() else None
        is_newer = known is None or roster.version > known.version
        newest = roster if known is None or is_newer else known
        check_in_force(newest, bundle.name, certificate, str(path))
        if is_new:
            write_secret(folder.ca, certificates.certificate_pem(ca))
        if is_newer:
            accept_roster_locked(folder, roster_data, str(path))
        write_identity(folder, bundle.name, certificate, key)
        if bundle.authority is not None:
            write_url(folder, bundle.authority)
        if bundle.machines_key is not None:
            write_machines_key(folder, bytes.fromhex(bundle.machines_key))
    return own_identity(folder, bundle.name)
