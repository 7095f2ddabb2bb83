"""What proves that a computer is one of a robot's machines: its certificate, and a common secret."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path

from cairn.bus.exclusive import KEY_BYTES


@dataclass(frozen=True)
class MachineIdentity:
    """The files of one machine, and the common names by which it knows the others."""

    ca: Path
    certificate: Path
    key: Path
    common_names: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True)
class MachineSecrets:
    """The secret that all machines of a robot have, and no operator."""

    key: bytes = field(repr=False)

    def of_sessions(self) -> str:
        """Return the secret that proves which sessions are of the robot."""
        return self._derived("sessions")[:32]

    def of_topic(self, topic: str) -> str:
        """Return the secret of an exclusive topic that crosses between machines."""
        return self._derived(f"topic {topic}")

    def _derived(self, purpose: str) -> str:
        return blake2b(purpose.encode(), key=self.key, digest_size=KEY_BYTES).hexdigest()


def machine_identity(robot: str, machine: str) -> MachineIdentity:
    folder = Path(os.environ["CAIRN_SECURITY_DIR"]) / robot
    names = json.loads((folder / "names.json").read_text())
    own = folder / "identities"
    return MachineIdentity(
        folder / "ca.pem",
        own / f"{machine}.pem",
        own / f"{machine}.key",
        {k: tuple(v) for k, v in names.items()},
    )


def machine_secrets(robot: str) -> MachineSecrets:
    return MachineSecrets(
        (Path(os.environ["CAIRN_SECURITY_DIR"]) / robot / "link.key").read_bytes()
    )
