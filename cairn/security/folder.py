"""The security folder: where the certificates, keys and roster of each robot are."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

import platformdirs
from pydantic import Field, TypeAdapter, ValidationError

from cairn.bus.credentials import check_secret
from cairn.errors import CairnError
from cairn.limits.files import read_bounded
from cairn.system.files import explained, replacing
from cairn.system.runtime_folder import check_private, locked, private_folder

VARIABLE: Final = "CAIRN_SECURITY_DIR"
"""The environment variable that names the security folder."""

Kind = Literal["machine", "operator"]
"""What an identity is for: a computer of the robot, or a user on the network."""
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$", max_length=40)]
"""Name of a robot, machine or operator."""

MACHINES_KEY_BYTES: Final = 32
PEM_BYTES: Final = 64 << 10
"""Largest file with a certificate or key that is read."""

_CONTENT: Final = "certificates and keys"
_NAME: Final = TypeAdapter(Name)


def security_folder() -> Path:
    """Return the security folder of this user: its path only, nothing is created.

    `$CAIRN_SECURITY_DIR`, else `cairn/security` in the user's folder for configuration.
    """
    if named := os.environ.get(VARIABLE):
        return Path(named).absolute()
    return platformdirs.user_config_path("cairn") / "security"


def check_name(name: str, what: str) -> str:
    """Return the name of a robot or identity; `CairnError` if it is not valid."""
    try:
        return _NAME.validate_python(name)
    except ValidationError:
        raise CairnError(
            f"{what} {name[:100]!r}: it is not a valid name; use up to 40 lower-case letters, "
            "digits and underscores, the first one a letter"
        ) from None


def known_robots() -> list[str]:
    """Return the names of the robots in the security folder."""
    with explained(str(security_folder())):
        return sorted(path.parent.name for path in security_folder().glob("*/ca.pem"))


@dataclass(frozen=True)
class RobotFolder:
    """The files of one robot in the security folder, each of which only its owner may read.

    Attributes:
        robot: name of the robot.
        path: the folder.
    """

    robot: str
    path: Path

    @classmethod
    def of(cls, robot: str) -> RobotFolder:
        """Return the folder of a robot; nothing is created. `CairnError` if the name is invalid."""
        return cls(check_name(robot, "robot"), security_folder() / robot)

    @property
    def ca(self) -> Path:
        """Certificate of the robot's authority."""
        return self.path / "ca.pem"

    @property
    def ca_key(self) -> Path:
        """Private key of the authority, on its computer only."""
        return self.path / "ca.key"

    @property
    def roster(self) -> Path:
        """The signed list of identities."""
        return self.path / "roster.json"

    @property
    def tokens(self) -> Path:
        """Hashes of the tokens for enrollment, on the authority's computer only."""
        return self.path / "tokens.json"

    @property
    def authority(self) -> Path:
        """Where the authority's service is."""
        return self.path / "authority.json"

    @property
    def machines_key(self) -> Path:
        """The secret that the robot's machines share, on their computers only."""
        return self.path / "machines.key"

    @property
    def identities(self) -> Path:
        """The folder with the certificates and keys of this computer."""
        return self.path / "identities"

    def certificate(self, name: str) -> Path:
        """Certificate of an identity; `CairnError` if the name is not valid."""
        check_name(name, "identity")
        return self.identities / f"{name}.pem"

    def key(self, name: str) -> Path:
        """Private key of an identity; `CairnError` if the name is not valid."""
        check_name(name, "identity")
        return self.identities / f"{name}.key"

    def create(self) -> None:
        """Create the folder, or check that it is private; `CairnError` if it cannot be."""
        for path in (self.path.parent, self.path, self.identities):
            private_folder(path, content=_CONTENT, variable=VARIABLE)

    def check(self) -> None:
        """Raise `CairnError` unless the folder exists and other users cannot change it."""
        try:
            for path in (self.path.parent, self.path, self.identities):
                check_private(path, content=_CONTENT, variable=VARIABLE)
        except OSError as error:
            raise CairnError(
                f"{self.path}: there are no certificates of the robot {self.robot}; make them with "
                "`cairn security init`, get them with `cairn security enroll` or `import`, or set "
                f"{VARIABLE}"
            ) from error

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Check the folder and hold its lock: one process or thread at a time changes it."""
        self.check()
        with locked(self.path):
            yield

    def read(self, path: Path, limit: int, remedy: str) -> bytes:
        """Return the content of a file of the folder, which may be secret.

        Raises `CairnError` if it is missing, larger than `limit` bytes, or other users may change
        or read it.
        """
        self.check()
        if not path.exists():
            raise CairnError(f"{path}: no such file; {remedy}")
        return read_secret(path, limit)


def read_machines_key(folder: RobotFolder) -> bytes:
    """Return the secret that the machines of a robot share; `CairnError` if it is not valid."""
    remedy = "enroll this computer as a machine: cairn security enroll TOKEN"
    data = folder.read(folder.machines_key, 2 * MACHINES_KEY_BYTES + 1, remedy)
    try:
        key = bytes.fromhex(data.decode("ascii"))
    except ValueError:
        key = b""
    if len(key) != MACHINES_KEY_BYTES:
        raise CairnError(f"{folder.machines_key}: it is damaged; {remedy}")
    return key


def write_machines_key(folder: RobotFolder, key: bytes) -> None:
    """Keep the secret that the machines of a robot share; the caller holds the folder's lock."""
    write_secret(folder.machines_key, key.hex().encode() + b"\n")


def read_secret(path: Path, limit: int) -> bytes:
    """Return the content of a file that other users may not read; `CairnError` if they may."""
    check_secret(path)
    with explained(f"{path}: it cannot be read"):
        return read_bounded(path, limit)


def write_secret(path: Path, data: bytes) -> None:
    """Replace a file atomically, or create it; only its owner may read it."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW
    with (
        explained(f"{path}: it cannot be written"),
        replacing(path) as part,
        open(os.open(part, flags, 0o600), "wb") as file,
    ):
        file.write(data)
