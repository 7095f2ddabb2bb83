"""The units that run a deployment as a service of systemd: one template, and a drop-in per robot.

The template is the shipped `deploy/robot/cairn@.service`. The drop-in names the deployment, and
opens the network to what the deployment needs of it.
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cairn.bus.endpoints import is_loopback
from cairn.deployment.model import Deployment
from cairn.deployment.shipped import FOLDER
from cairn.errors import CairnError

TEMPLATE: Final = "cairn@.service"
DROP_IN: Final = "deployment.conf"
_TEMPLATE_FILE: Final = FOLDER / "robot" / TEMPLATE
_ONLY_SYSTEM: Final = "# Only as a service of the system:"
"""The rest of a section after this line needs the rights of the system's service manager."""
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_PLAIN_WORD: Final = re.compile(r"[A-Za-z0-9_./:@,=+-]+")


def unit_name(name: str) -> str:
    """Return the unit of the service of that name; raises `CairnError` if it cannot have one."""
    if not _NAME.fullmatch(name):
        raise CairnError(
            f"{name!r} cannot be the name of a systemd service; give --name with letters, digits, "
            "'_', '.' and '-' only"
        )
    return f"cairn@{name}.service"


def template_text(*, for_user: bool) -> str:
    """Return the text of the template unit, for the system's or a user's service manager.

    A user's manager cannot change the user, limit devices or filter the network: that is left out.
    """
    text = _TEMPLATE_FILE.read_text(encoding="utf-8")
    if not for_user:
        return text
    kept: list[str] = []
    left_out = False
    for line in text.splitlines():
        if line.startswith("[") and left_out:
            left_out = False
            kept.append("")
        left_out = left_out or line.startswith(_ONLY_SYSTEM)
        if not left_out:
            kept.append(line.replace("WantedBy=multi-user.target", "WantedBy=default.target"))
    return re.sub(r"\n{3,}", "\n\n", "\n".join(kept)) + "\n"


@dataclass(frozen=True)
class RunCommand:
    """The command `cairn up` of a service, with absolute paths."""

    program: Path
    file: Path
    report: Path
    machine: str = ""
    overlays: Sequence[Path] = ()
    sets: Sequence[str] = ()

    def words(self) -> list[str]:
        """Return the command's words."""
        words = [str(self.program), "up", str(self.file), "--plain", "--report", str(self.report)]
        words += ["--machine", self.machine] if self.machine else []
        words += [word for one in self.overlays for word in ("--overlay", str(one))]
        return words + [word for one in self.sets for word in ("--set", one)]


def drop_in_text(command: RunCommand, deployment: Deployment, *, for_user: bool) -> str:
    """Return the drop-in of the template for one robot; raises `CairnError`."""
    start = " ".join(map(_word, command.words()))
    lines = [
        "# Written by `cairn service install`, which replaces it. Your own changes: systemctl edit",
        "[Unit]",
        f"Description=Cairn robot {deployment.robot.name}"
        + (f", machine {command.machine}" if command.machine else ""),
        "[Service]",
        "ExecStart=",
        f"ExecStart={start}",
    ]
    if deployment.stop_limit_s > 10:  # the template's limits fit the default
        lines.append(f"TimeoutStopSec={deployment.stop_limit_s + 5:g}")
    if not for_user and (addresses := _network(deployment, command.machine)):
        lines.append(f"IPAddressAllow={' '.join(addresses)}")
    return "\n".join(lines) + "\n"


def _network(deployment: Deployment, machine: str) -> list[str]:
    """Return the addresses outside this computer that a robot needs, as `IPAddressAllow` does."""
    if any(not is_loopback(endpoint) for endpoint in deployment.bus.listen):
        return ["any"]  # clients have any address; the bus asks them who they are
    found = []
    for name, other in deployment.machines.items():
        if name == machine:
            continue
        try:
            found.append(str(ipaddress.ip_address(other.address)))
        except ValueError:
            return ["any"]  # a host name, whose address may change
    return list(dict.fromkeys(found))


def _word(text: str) -> str:
    """Return an argument as systemd.service(5) reads it; raises `CairnError`."""
    if not text.isprintable():
        raise CairnError(f"{text!r}: a systemd unit cannot hold this; use printable characters")
    text = text.replace("%", "%%").replace("$", "$$")
    if _PLAIN_WORD.fullmatch(text):
        return text
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
