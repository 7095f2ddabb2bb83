"""What proves that a computer is a machine of a robot: its certificate, and a common secret."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from typing import TYPE_CHECKING, Final

from cairn.bus.exclusive import KEY_BYTES
from cairn.errors import CairnError
from cairn.security.folder import RobotFolder, read_machines_key

if TYPE_CHECKING:
    from cairn.security.identity import Identity

_SECRET_DIGITS: Final = 32  # as many as `cairn up` draws for a run on one machine


@dataclass(frozen=True)
class MachineIdentity:
    """The files of one machine, and the certificates of the others that are in force.

    `common_names` has those of each machine.
    """

    ca: Path
    certificate: Path
    key: Path
    common_names: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True)
class MachineSecrets:
    """Secrets that follow from the one that all machines of a robot have, and no operator."""

    key: bytes = field(repr=False)

    def of_sessions(self) -> str:
        """Return the secret that proves which sessions are of the robot."""
        return self._derived("sessions")[:_SECRET_DIGITS]

    def of_topic(self, topic: str) -> str:
        """Return the secret of an exclusive topic that crosses between machines."""
        return self._derived(f"topic {topic}")

    def _derived(self, purpose: str) -> str:
        return blake2b(purpose.encode(), key=self.key, digest_size=KEY_BYTES).hexdigest()


def own_machine(robot: str, name: str) -> Identity:
    """Return the identity of a machine on this computer; `CairnError` if it is not in force."""
    # It needs `cryptography`, which no component of a robot with one computer should load.
    from cairn.security.identity import own_identity

    own = own_identity(RobotFolder.of(robot), name)
    if own.entry.kind != "machine":
        raise CairnError(
            f"{own.certificate}: {name} is an operator, not a machine of {robot}; give the "
            "machine an identity (cairn security add), or use another name for one of them"
        )
    return own


def machine_identity(robot: str, machine: str) -> MachineIdentity:
    """Return the identity of this machine; `CairnError` with the reason if it is not in force."""
    own = own_machine(robot, machine)
    from cairn.security.roster import read_roster

    folder = RobotFolder.of(robot)
    common_names: defaultdict[str, list[str]] = defaultdict(list)
    for entry in read_roster(folder).entries:
        if entry.kind == "machine" and entry.is_in_force(time.time()):
            common_names[entry.name].append(entry.common_name)
    names = {name: tuple(found) for name, found in common_names.items()}
    return MachineIdentity(own.ca, own.certificate, own.key, names)


def machine_secrets(robot: str) -> MachineSecrets:
    """Return the secrets of this robot's machines; `CairnError` if this computer has none."""
    return MachineSecrets(read_machines_key(RobotFolder.of(robot)))
