"""Identities of `cairn security` on this computer, and the links of a robot that runs."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from cairn.cli.doctor import Finding
from cairn.client.machines import described_links
from cairn.deployment.model import Deployment
from cairn.errors import CairnError
from cairn.schemas.cairn_msgs import MachineStatus
from cairn.security.folder import RobotFolder

_CLOCK_MS: Final = 100.0  # the default of `clock_tolerance_s`
_DAY_S: Final = 86_400
_FEW_DAYS: Final = 14  # a machine renews its certificate by itself long before


def machines(file: Path, deployment: Deployment) -> Iterator[Finding]:
    """Check the identities that a deployment's machines and gateway need on this computer."""
    tls = deployment.bus.tls
    gateway = tls and tls.identity
    names = [*deployment.machines, *([gateway] if gateway else [])]
    if not names:
        return
    from cairn.security.identity import own_names

    topic, folder = f"machines of {file.name}", RobotFolder.of(deployment.robot.name)
    try:
        here = [name for name in own_names(folder) if name in names]
    except CairnError as error:
        found, _, remedy = str(error).partition("; ")
        yield Finding(topic, str(folder.path), "fail", found, remedy)
        return
    if not here:
        found = f"no identity of {', '.join(dict.fromkeys(names))} is on this computer"
        remedy = "enroll it: cairn security enroll TOKEN (docs/how-to/security.md)"
        yield Finding(topic, str(folder.path), "fail", found, remedy)
    for name in here:
        yield _identity(topic, folder, name)


def links(robot: str, statuses: Iterable[MachineStatus]) -> Iterator[Finding]:
    """Report how the machines of a running robot see each other, and their clocks."""
    for link in described_links(statuses):
        machine, subject = link["machine"], f"{link['machine']} seen from {link['seen_from']}"
        topic = f"machines of {robot}"
        if link["state"] == "lost":
            found = f"lost: nothing of it has arrived for {link['silent_s']:.0f} s"
            remedy = (
                f"start `cairn up ... --machine {machine}` there, and check the cable and that "
                f"its port and certificate are accepted: see its log"
            )
            yield Finding(topic, subject, "fail", found, remedy)
            continue
        offset, error = link["clock_offset_ms"], link["clock_error_ms"]
        if offset is None:
            yield Finding(topic, subject, "ok", "up; how far its clock differs is not known yet")
            continue
        found = f"up; its clock is {offset:.1f} ms ahead, within {error:.1f} ms"
        if abs(offset) - error > _CLOCK_MS:
            remedy = "synchronize the clocks with chrony: docs/how-to/machines.md has its settings"
            yield Finding(topic, subject, "warn", found, remedy)
        else:
            yield Finding(topic, subject, "ok", found)


def _identity(topic: str, folder: RobotFolder, name: str) -> Finding:
    from cairn.security.identity import own_identity

    try:
        entry = own_identity(folder, name).entry
    except CairnError as error:
        found, _, remedy = str(error).rpartition("; ")
        return Finding(topic, name, "fail", found or str(error), remedy if found else "")
    days = int((entry.not_after - time.time()) // _DAY_S)
    until = time.strftime("%Y-%m-%d", time.gmtime(entry.not_after))
    found = f"its certificate is valid until {until}, for {days} days"
    if days < _FEW_DAYS:
        remedy = f"renew it: cairn security renew {name}"
        return Finding(topic, name, "warn", found, remedy)
    return Finding(topic, name, "ok", found)
