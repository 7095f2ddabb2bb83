"""`cairn emulate`: devices in software, for trying drivers without hardware."""

from __future__ import annotations

from cairn.cli.installed import installed_commands

EMULATORS_GROUP = "cairn.emulators"
"""Entry points of this group add devices: each a function as typer takes it."""

app = installed_commands(
    EMULATORS_GROUP,
    "emulator",
    "Emulate a device on a serial port in software, or a TCP port, with faults to order.",
)
