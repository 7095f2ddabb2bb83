"""What the roots of a robot's machines report: how these see each other, and what is lost."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from cairn.schemas.cairn_msgs import ComponentStatus, MachineLink, MachineStatus


def described_links(statuses: Iterable[MachineStatus]) -> list[dict[str, Any]]:
    """Return how each machine of a robot sees each other one, in values that JSON can hold.

    `silent_s` is since when nothing of it has arrived [s]; `clock_offset_ms` is how far its clock
    is ahead of that of the machine that sees it, within `clock_error_ms` [ms], None if not known;
    `missing` are the topics that do not arrive from it.
    """
    return [
        _described(status.machine, link)
        for status in sorted(statuses, key=lambda one: one.machine)
        for link in status.links
    ]


def components_of_lost(statuses: Iterable[MachineStatus]) -> dict[str, str]:
    """Return the machine of each component that is on one that another one has lost, by name."""
    return {
        name: link.machine
        for status in statuses
        for link in status.links
        if not link.is_up
        for name in link.components
    }


def machine_of_router(statuses: Iterable[ComponentStatus], router: int | None) -> str | None:
    """Return the machine of a robot whose root has the process id of a router on this computer.

    None if it has none: the process ids in statuses are those of other computers. The machine of a
    robot with only one is "".
    """
    if router is None:
        return None
    return next((one.machine for one in statuses if not one.parent and one.pid == router), None)


def _described(seen_from: str, link: MachineLink) -> dict[str, Any]:
    return {
        "machine": link.machine,
        "seen_from": seen_from,
        "state": "up" if link.is_up else "lost",
        "silent_s": round(link.silent_s, 2),
        "clock_offset_ms": _milliseconds(link.clock_offset),
        "clock_error_ms": _milliseconds(link.clock_error),
        "missing": list(link.inputs),
    }


def _milliseconds(seconds: float) -> float | None:
    return None if math.isnan(seconds) else round(1000 * seconds, 3)
